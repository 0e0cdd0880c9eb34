"""Writers and readers of raw CDR bytes in one domain of DDS.

A topic's type is known by its name only, as rmw_cyclonedds (to Jazzy) has it, so whoever names
the type alike is met. The bytes of a message are those of `cdr_encode`; nothing looks into them.
"""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable
from dataclasses import dataclass

from trocar.interfaces.crtk.transports.ros2 import library
from trocar.interfaces.crtk.transports.ros2.library import DdsError, Descriptor, Library
from trocar.interfaces.crtk.transports.ros2.quality import Quality, quality_of, user_data_of

#: Payloads above it are written while other threads run. Source: measured, copying takes 10 us.
LARGE = 64 * 1024
#: How many samples one call takes. Source: our own choice, the depth of a queue of commands.
TAKEN = 64
# One octet: the least that every message has, so that any bytes pass. Source: dds_opcodes.h,
# DDS_OP_ADR | DDS_OP_TYPE_1BY at offset 0, DDS_OP_RTS.
ANY_BYTES = (ct.c_uint32 * 3)(0x01010000, 0, 0)
NOTHING = library.Metadata(None, 0)


@dataclass(frozen=True)
class Taken:
    """What arrived: CDR bytes with their header, the handle of who wrote them, and when [ns]."""

    payload: bytes
    writer: int
    written_ns: int


class Writer:
    """Writes on one topic; made by `Bus.writer`."""

    def __init__(self, lib: Library, entity: int) -> None:
        self._lib = lib
        self.entity = entity
        self.guid = guid(lib, entity)
        self.matched = 0
        kind = ct.c_void_p()
        lib.checked(lib.quick.dds_get_entity_sertype(entity, ct.byref(kind)), "a writer's type")
        self._type = kind.value

    def write(self, payload: bytes) -> bool:
        """Send, without ever waiting for a subscriber; return whether there was room."""
        payload += bytes(-len(payload) % 4)
        data = library.Slice(payload, len(payload))
        make = self._lib.quick.ddsi_serdata_from_ser_iov
        sample = make(self._type, library.DATA, 1, ct.byref(data), len(payload))
        calls = self._lib.wait if len(payload) > LARGE else self._lib.quick
        return bool(sample) and calls.dds_writecdr(self.entity, sample) == 0

    def look(self) -> int:
        """Ask how many subscribers there are; kept in `matched`."""
        status = library.Matched()
        self._lib.quick.dds_get_publication_matched_status(self.entity, ct.byref(status))
        self.matched = status.current
        return self.matched

    def readers(self) -> list[int]:
        """Return the handles of the subscribers."""
        handles = (ct.c_uint64 * 256)()
        count = self._lib.quick.dds_get_matched_subscriptions(self.entity, handles, 256)
        return list(handles[: max(0, min(count, 256))])

    def user_data_of(self, reader: int) -> bytes | None:
        """Return the USER_DATA of a subscriber, None when it is gone."""
        found = self._lib.quick.dds_get_matched_subscription_data(self.entity, reader)
        return user_data_of(self._lib, found)


class Reader:
    """Reads one topic; made by `Bus.reader`."""

    def __init__(self, lib: Library, entity: int) -> None:
        self._lib = lib
        self.entity = entity
        self.guid = guid(lib, entity)
        self._samples = (ct.c_void_p * TAKEN)()
        self._infos = (library.SampleInfo * TAKEN)()

    def take(self) -> list[Taken]:
        """Take what arrived, up to TAKEN messages, oldest first."""
        quick = self._lib.quick
        count = quick.dds_takecdr(self.entity, self._samples, TAKEN, self._infos, library.ANY_STATE)
        found: list[Taken] = []
        for sample, info in zip(self._samples[: max(count, 0)], self._infos, strict=False):
            if info.valid_data:
                payload = ct.create_string_buffer(quick.ddsi_serdata_size(sample))
                quick.ddsi_serdata_to_ser(sample, 0, len(payload), payload)
                found.append(Taken(payload.raw, info.publication_handle, info.source_timestamp))
            quick.ddsi_serdata_unref(sample)
        return found

    def user_data_of(self, writer: int) -> bytes | None:
        """Return the USER_DATA of who wrote, None when it is gone."""
        found = self._lib.quick.dds_get_matched_publication_data(self.entity, writer)
        return user_data_of(self._lib, found)


class Bus:
    """A participant of a domain.

    Args:
        domain: 0 to 232
        config: Cyclone DDS's XML; None: what CYCLONEDDS_URI says
        user_data: of the participant

    Attributes:
        guid: of the participant, 16 bytes

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        DdsError: no such network, too many participants, or the process is in the domain already
    """

    def __init__(self, domain: int, config: str | None, user_data: bytes) -> None:
        self._lib = lib = library.load()
        self._topics: dict[str, int] = {}
        self._ends: dict[int, Writer | Reader] = {}
        self._domain = 0
        if config is not None:
            entity = lib.wait.dds_create_domain(domain, config.encode())
            self._domain = lib.checked(entity, f"domain {domain}")
        wish = quality_of(lib, Quality(1, user_data=user_data))
        try:
            entity = lib.wait.dds_create_participant(domain, wish, None)
            self._participant = lib.checked(entity, f"a participant of domain {domain}")
        except DdsError:
            self._leave()
            raise
        finally:
            lib.quick.dds_delete_qos(wish)
        self.guid = guid(lib, self._participant)
        waitset = lib.wait.dds_create_waitset(self._participant)
        self._waitset = lib.checked(waitset, "a waitset")
        self._woken = (ct.c_ssize_t * 64)()

    def writer(self, topic: str, kind: str, quality: Quality) -> Writer:
        """Return a writer of messages of the DDS type `kind`; `wait` tells of its subscribers."""
        create = self._lib.wait.dds_create_writer
        writer = Writer(self._lib, self._end(create, topic, kind, quality))
        self._watch(writer, library.PUBLICATION_MATCHED)
        writer.look()
        return writer

    def reader(self, topic: str, kind: str, quality: Quality) -> Reader:
        """Return a reader of messages of the DDS type `kind`; `wait` tells of what arrives."""
        create = self._lib.wait.dds_create_reader
        reader = Reader(self._lib, self._end(create, topic, kind, quality))
        self._watch(reader, library.DATA_AVAILABLE)
        return reader

    def wait(self, timeout_s: float) -> list[Writer | Reader]:
        """Wait until something arrives or a subscriber comes or goes; return where."""
        count = self._lib.wait.dds_waitset_wait(
            self._waitset, self._woken, len(self._woken), int(timeout_s * 1e9)
        )
        woken = self._woken[: max(0, min(count, len(self._woken)))]
        return [self._ends[entity] for entity in woken]

    def ends(self) -> list[Writer | Reader]:
        """Return every writer and reader."""
        return list(self._ends.values())

    def close(self) -> None:
        """Leave the domain; nothing of the bus may be used afterwards."""
        self._lib.wait.dds_delete(self._participant)
        self._leave()

    def _leave(self) -> None:
        if self._domain > 0:
            self._lib.wait.dds_delete(self._domain)

    def _end(self, create: Callable[..., int], topic: str, kind: str, quality: Quality) -> int:
        wish = quality_of(self._lib, quality)
        try:
            entity = create(self._participant, self._topic(topic, kind), wish, None)
            return self._lib.checked(entity, topic)
        finally:
            self._lib.quick.dds_delete_qos(wish)

    def _topic(self, topic: str, kind: str) -> int:
        if topic not in self._topics:
            descriptor = Descriptor(
                1, 1, 0, 0, kind.encode(), None, 2, ANY_BYTES, b"", NOTHING, NOTHING, 0
            )
            entity = self._lib.wait.dds_create_topic(
                self._participant, ct.byref(descriptor), topic.encode(), None, None
            )
            self._topics[topic] = self._lib.checked(entity, f"{topic} of {kind}")
        return self._topics[topic]

    def _watch(self, end: Writer | Reader, status: int) -> None:
        quick = self._lib.quick
        self._ends[end.entity] = end
        self._lib.checked(quick.dds_set_status_mask(end.entity, status), "what to wait for")
        attached = quick.dds_waitset_attach(self._waitset, end.entity, end.entity)
        self._lib.checked(attached, "what to wait for")


def guid(lib: Library, entity: int) -> bytes:
    """Return the GUID of an entity, 16 bytes."""
    found = ct.create_string_buffer(16)
    lib.checked(lib.quick.dds_get_guid(entity, found), "a GUID")
    return found.raw
