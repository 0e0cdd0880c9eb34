"""Writers and readers of raw CDR bytes in one domain of DDS, by Cyclone DDS's C library.

The wheel `cyclonedds` brings the library. Its Python classes serialise field by field and hold
every message against a description of its type; the bytes are here already, so its C functions are
called by ctypes. A topic's type is known by its name only, as rmw_cyclonedds (to Jazzy) has it.

Source: dds.h and ddsi_serdata.h of Cyclone DDS 11.0.
"""

from __future__ import annotations

import ctypes as ct
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from trocar.errors import InputError, MissingExtraError, TrocarError

I32, U32, I64, U64 = ct.c_int32, ct.c_uint32, ct.c_int64, ct.c_uint64
SIZE, POINTER = ct.c_size_t, ct.c_void_p
UNLIMITED = -1
ANY_STATE = 0x7F
KEEP_LAST = 0
XCDR1 = (ct.c_int16 * 1)(0)
DATA = 2
DATA_AVAILABLE = 1 << 8
PUBLICATION_MATCHED = 1 << 11

# What may wait lets other threads of Python run meanwhile: {name: (result, arguments)}.
WAITING: dict[str, tuple[Any, list[Any]]] = {
    "dds_create_domain": (I32, [U32, ct.c_char_p]),
    "dds_create_participant": (I32, [U32, POINTER, POINTER]),
    "dds_create_topic": (I32, [I32, POINTER, ct.c_char_p, POINTER, POINTER]),
    "dds_create_writer": (I32, [I32, I32, POINTER, POINTER]),
    "dds_create_reader": (I32, [I32, I32, POINTER, POINTER]),
    "dds_create_waitset": (I32, [I32]),
    "dds_waitset_wait": (I32, [I32, POINTER, SIZE, I64]),
    "dds_writecdr": (I32, [I32, POINTER]),
    "dds_delete": (I32, [I32]),
}
# What never waits keeps the others from running: to stop and begin again costs more than it.
QUICK: dict[str, tuple[Any, list[Any]]] = {
    "dds_waitset_attach": (I32, [I32, I32, ct.c_ssize_t]),
    "dds_set_status_mask": (I32, [I32, U32]),
    "dds_get_publication_matched_status": (I32, [I32, POINTER]),
    "dds_get_guid": (I32, [I32, POINTER]),
    "dds_get_entity_sertype": (I32, [I32, POINTER]),
    "dds_get_matched_subscriptions": (I32, [I32, POINTER, SIZE]),
    "dds_get_matched_subscription_data": (POINTER, [I32, U64]),
    "dds_get_matched_publication_data": (POINTER, [I32, U64]),
    "dds_builtintopic_free_endpoint": (None, [POINTER]),
    "dds_qget_userdata": (ct.c_bool, [POINTER, POINTER, POINTER]),
    "dds_free": (None, [POINTER]),
    "dds_strretcode": (ct.c_char_p, [I32]),
    "dds_writecdr": (I32, [I32, POINTER]),
    "dds_takecdr": (I32, [I32, POINTER, U32, POINTER, U32]),
    "dds_read": (I32, [I32, POINTER, POINTER, SIZE, U32]),
    "dds_return_loan": (I32, [I32, POINTER, I32]),
    "dds_qget_durability": (ct.c_bool, [POINTER, POINTER]),
    "ddsi_serdata_from_ser_iov": (POINTER, [POINTER, ct.c_int, SIZE, POINTER, SIZE]),
    "ddsi_serdata_size": (U32, [POINTER]),
    "ddsi_serdata_to_ser": (None, [POINTER, SIZE, SIZE, POINTER]),
    "ddsi_serdata_unref": (None, [POINTER]),
    "dds_create_qos": (POINTER, []),
    "dds_delete_qos": (None, [POINTER]),
    "dds_qset_durability": (None, [POINTER, ct.c_int]),
    "dds_qset_durability_service": (None, [POINTER, I64, ct.c_int, I32, I32, I32, I32]),
    "dds_qset_history": (None, [POINTER, ct.c_int, I32]),
    "dds_qset_reliability": (None, [POINTER, ct.c_int, I64]),
    "dds_qset_userdata": (None, [POINTER, ct.c_char_p, SIZE]),
    "dds_qset_data_representation": (None, [POINTER, U32, POINTER]),
}


class Metadata(ct.Structure):
    """dds_type_meta_ser."""

    _fields_ = (("data", POINTER), ("size", U32))


class Descriptor(ct.Structure):
    """dds_topic_descriptor_t: a topic's type."""

    _fields_ = (
        ("size", U32),
        ("align", U32),
        ("flags", U32),
        ("keys_count", U32),
        ("type_name", ct.c_char_p),
        ("keys", POINTER),
        ("ops_count", U32),
        ("ops", ct.POINTER(U32)),
        ("meta", ct.c_char_p),
        ("type_information", Metadata),
        ("type_mapping", Metadata),
        ("representation", U32),
    )


class Slice(ct.Structure):
    """ddsrt_iovec_t: bytes to send."""

    _fields_ = (("base", ct.c_char_p), ("length", SIZE))


class SampleInfo(ct.Structure):
    """dds_sample_info_t, of which we read whether there is data and who wrote it."""

    _fields_ = (
        ("sample_state", ct.c_int),
        ("view_state", ct.c_int),
        ("instance_state", ct.c_int),
        ("valid_data", ct.c_bool),
        ("source_timestamp", I64),
        ("instance_handle", U64),
        ("publication_handle", U64),
        ("counts", U32 * 5),
    )


class Matched(ct.Structure):
    """dds_publication_matched_status_t."""

    _fields_ = (
        ("total", U32),
        ("total_change", I32),
        ("current", U32),
        ("current_change", I32),
        ("last", U64),
    )


class Endpoint(ct.Structure):
    """dds_builtintopic_endpoint_t, up to its quality of service."""

    _fields_ = (
        ("key", ct.c_uint8 * 16),
        ("participant_key", ct.c_uint8 * 16),
        ("participant", U64),
        ("topic_name", ct.c_char_p),
        ("type_name", ct.c_char_p),
        ("qos", POINTER),
    )


# ---------------------------------------------------------------------- the library


class DdsError(TrocarError):
    """Cyclone DDS failed; `code` is its own."""

    def __init__(self, doing: str, code: int, reason: str) -> None:
        self.code = code
        super().__init__(f"ROS 2: {doing}: Cyclone DDS: {reason}")


class Cyclone:
    """The functions above: `wait` those that may wait, `quick` those that never do."""

    def __init__(self, path: str) -> None:
        self.wait = _declare(ct.CDLL(path), WAITING)
        self.quick = _declare(ct.PyDLL(path), QUICK)

    def checked(self, code: int, doing: str) -> int:
        """Return `code`, an entity or a count.

        Raises:
            DdsError: it is negative
        """
        if code < 0:
            raise DdsError(doing, code, self.quick.dds_strretcode(code).decode(errors="replace"))
        return code

    def guid(self, entity: int) -> bytes:
        """Return the GUID of an entity, 16 bytes."""
        found = ct.create_string_buffer(16)
        self.checked(self.quick.dds_get_guid(entity, found), "a GUID")
        return found.raw

    def user_data(self, endpoint: int | None) -> bytes | None:
        """Return the USER_DATA of an endpoint, and free it; None when it is gone."""
        if not endpoint:
            return None
        qos = Endpoint.from_address(endpoint).qos
        data, size = ct.c_void_p(), ct.c_size_t()
        try:
            if not self.quick.dds_qget_userdata(qos, ct.byref(data), ct.byref(size)):
                return b""
            found = ct.string_at(data, size.value) if data.value else b""
            self.quick.dds_free(data)
            return found
        finally:
            self.quick.dds_builtintopic_free_endpoint(endpoint)


def _declare(library: Any, functions: dict[str, tuple[Any, list[Any]]]) -> Any:
    for name, (result, arguments) in functions.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library


@cache
def load() -> Cyclone:
    """Load the library.

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        InputError: on Windows, whose C structures are others
    """
    if sys.platform == "win32":
        raise InputError("ROS 2: Windows is not supported; allowed: Linux, macOS")
    try:
        from cyclonedds.internal import DDS
    except ImportError:
        raise MissingExtraError("cyclonedds", "ros2", "ROS 2") from None
    return Cyclone(DDS._dll_handle._name)  # pyright: ignore[reportPrivateUsage]  no public name


@dataclass(frozen=True)
class QualityOfService:
    """Quality of service: reliable, which every subscriber's request is compatible with.

    Args:
        depth: how many messages are kept for a subscriber that lags, or wait at ours
        latched: whether late subscribers get the last message (TRANSIENT_LOCAL)
        user_data: of the endpoint
        best_effort: of a reader: takes best-effort messages, too
    """

    depth: int
    latched: bool = False
    user_data: bytes = b""
    best_effort: bool = False

    def qos(self, lib: Cyclone) -> int:
        """Return a new dds_qos_t."""
        quick = lib.quick
        found = quick.dds_create_qos()
        quick.dds_qset_reliability(found, 0 if self.best_effort else 1, 0)
        quick.dds_qset_durability(found, int(self.latched))
        quick.dds_qset_history(found, KEEP_LAST, self.depth)
        quick.dds_qset_durability_service(found, 0, KEEP_LAST, 1, *[UNLIMITED] * 3)
        quick.dds_qset_data_representation(found, 1, XCDR1)
        quick.dds_qset_userdata(found, self.user_data, len(self.user_data))
        return found


# ---------------------------------------------------------------------- writers and readers

#: Payloads above it are written while other threads run. Source: measured, copying takes 10 us.
LARGE = 64 * 1024
#: Most samples taken by one call. Source: our own choice, the depth of a queue of commands.
TAKEN = 64
# One octet: the least that every message has, so that any bytes pass. Source: dds_opcodes.h,
# DDS_OP_ADR | DDS_OP_TYPE_1BY at offset 0, DDS_OP_RTS.
ANY_BYTES = (ct.c_uint32 * 3)(0x01010000, 0, 0)
NOTHING = Metadata(None, 0)


#: Topics on which Cyclone DDS describes writers and readers, and endpoints that are read at once.
#: Source: dds.h, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION.
BUILTIN_WRITERS, BUILTIN_READERS, DESCRIBED = 0x7FFF0003, 0x7FFF0004, 4096


@dataclass(frozen=True)
class OfferedEndpoint:
    """A writer or reader of another participant.

    Attributes:
        topic, kind: names of topic and type in DDS
        writes: a writer; else a reader
        durable: late subscribers of the writer get its last message
    """

    topic: str
    kind: str
    writes: bool
    durable: bool


@dataclass(frozen=True)
class DdsSample:
    """A received message: CDR with its header, the writer's handle, time of writing [ns]."""

    payload: bytes
    writer: int
    written_ns: int


class DdsWriter:
    """Writes on one topic; made by `DdsParticipant.writer`."""

    def __init__(self, lib: Cyclone, entity: int) -> None:
        self._lib = lib
        self.entity = entity
        self.guid = lib.guid(entity)
        self.matched = 0
        kind = ct.c_void_p()
        lib.checked(lib.quick.dds_get_entity_sertype(entity, ct.byref(kind)), "a writer's type")
        self._type = kind.value

    def write(self, payload: bytes) -> bool:
        """Send, without ever waiting for a subscriber; return whether there was room."""
        payload += bytes(-len(payload) % 4)
        data = Slice(payload, len(payload))
        make = self._lib.quick.ddsi_serdata_from_ser_iov
        sample = make(self._type, DATA, 1, ct.byref(data), len(payload))
        calls = self._lib.wait if len(payload) > LARGE else self._lib.quick
        return bool(sample) and calls.dds_writecdr(self.entity, sample) == 0

    def look(self) -> int:
        """Count the subscribers; kept in `matched`."""
        status = Matched()
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
        return self._lib.user_data(found)


class DdsReader:
    """Reads one topic; made by `DdsParticipant.reader`."""

    def __init__(self, lib: Cyclone, entity: int) -> None:
        self._lib = lib
        self.entity = entity
        self.guid = lib.guid(entity)
        self._samples = (ct.c_void_p * TAKEN)()
        self._infos = (SampleInfo * TAKEN)()

    def take(self) -> list[DdsSample]:
        """Take what arrived, up to TAKEN messages, oldest first."""
        quick = self._lib.quick
        count = quick.dds_takecdr(self.entity, self._samples, TAKEN, self._infos, ANY_STATE)
        found: list[DdsSample] = []
        for sample, info in zip(self._samples[: max(count, 0)], self._infos, strict=False):
            if info.valid_data:
                payload = ct.create_string_buffer(quick.ddsi_serdata_size(sample))
                quick.ddsi_serdata_to_ser(sample, 0, len(payload), payload)
                found.append(DdsSample(payload.raw, info.publication_handle, info.source_timestamp))
            quick.ddsi_serdata_unref(sample)
        return found

    def participant_of(self, writer: int) -> int:
        """Return the handle of the participant that a writer belongs to; 0 when it is gone."""
        found = self._lib.quick.dds_get_matched_publication_data(self.entity, writer)
        if not found:
            return 0
        participant = int(Endpoint.from_address(found).participant)
        self._lib.quick.dds_builtintopic_free_endpoint(found)
        return participant

    def user_data_of(self, writer: int) -> bytes | None:
        """Return the USER_DATA of who wrote, None when it is gone."""
        found = self._lib.quick.dds_get_matched_publication_data(self.entity, writer)
        return self._lib.user_data(found)


class DdsParticipant:
    """A participant of a domain.

    Args:
        domain: 0 to 232
        config: Cyclone DDS's XML; None: that of CYCLONEDDS_URI
        user_data: of the participant

    Attributes:
        guid: of the participant, 16 bytes

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        DdsError: no such network, too many participants, or the process is in the domain already
    """

    def __init__(self, domain: int, config: str | None, user_data: bytes) -> None:
        self._lib = lib = load()
        self._topics: dict[str, int] = {}
        self._ends: dict[int, DdsWriter | DdsReader] = {}
        self._domain = 0
        if config is not None:
            entity = lib.wait.dds_create_domain(domain, config.encode())
            self._domain = lib.checked(entity, f"domain {domain}")
        wish = QualityOfService(1, user_data=user_data).qos(lib)
        try:
            entity = lib.wait.dds_create_participant(domain, wish, None)
            self._participant = lib.checked(entity, f"a participant of domain {domain}")
        except DdsError:
            self._leave()
            raise
        finally:
            lib.quick.dds_delete_qos(wish)
        self.guid = lib.guid(self._participant)
        waitset = lib.wait.dds_create_waitset(self._participant)
        self._waitset = lib.checked(waitset, "a waitset")
        self._woken = (ct.c_ssize_t * 64)()

    def writer(self, topic: str, kind: str, quality: QualityOfService) -> DdsWriter:
        """Return a writer of messages of the DDS type `kind`; `wait` reports its subscribers."""
        create = self._lib.wait.dds_create_writer
        writer = DdsWriter(self._lib, self._end(create, topic, kind, quality))
        self._watch(writer, PUBLICATION_MATCHED)
        writer.look()
        return writer

    def reader(self, topic: str, kind: str, quality: QualityOfService) -> DdsReader:
        """Return a reader of messages of the DDS type `kind`; `wait` reports its messages."""
        create = self._lib.wait.dds_create_reader
        reader = DdsReader(self._lib, self._end(create, topic, kind, quality))
        self._watch(reader, DATA_AVAILABLE)
        return reader

    def wait(self, timeout_s: float) -> list[DdsWriter | DdsReader]:
        """Wait until something arrives or a subscriber comes or goes; return where."""
        count = self._lib.wait.dds_waitset_wait(
            self._waitset, self._woken, len(self._woken), int(timeout_s * 1e9)
        )
        woken = self._woken[: max(0, min(count, len(self._woken)))]
        return [self._ends[entity] for entity in woken]

    def ends(self) -> list[DdsWriter | DdsReader]:
        """Return every writer and reader."""
        return list(self._ends.values())

    def offered(self) -> tuple[OfferedEndpoint, ...]:
        """List the writers and readers of other participants."""
        return (*self._described(BUILTIN_WRITERS), *self._described(BUILTIN_READERS))

    def close(self) -> None:
        """Leave the domain; nothing of the bus may be used afterwards."""
        self._lib.wait.dds_delete(self._participant)
        self._leave()

    def _described(self, topic: int) -> list[OfferedEndpoint]:
        """Read one of Cyclone DDS's own topics."""
        lib = self._lib
        created = lib.wait.dds_create_reader(self._participant, topic, None, None)
        reader = lib.checked(created, "the list of endpoints")
        samples, infos = (ct.c_void_p * DESCRIBED)(), (SampleInfo * DESCRIBED)()
        count = lib.quick.dds_read(reader, samples, infos, DESCRIBED, DESCRIBED)
        found: list[OfferedEndpoint] = []
        for sample, info in zip(samples[: max(count, 0)], infos, strict=False):
            if not info.valid_data or not sample:
                continue
            end = Endpoint.from_address(sample)
            if bytes(end.participant_key) == self.guid:
                continue
            durability = ct.c_int(0)
            lib.quick.dds_qget_durability(end.qos, ct.byref(durability))
            names = (end.topic_name or b"").decode(), (end.type_name or b"").decode()
            found.append(OfferedEndpoint(*names, topic == BUILTIN_WRITERS, durability.value > 0))
        if count > 0:
            lib.quick.dds_return_loan(reader, samples, count)
        lib.wait.dds_delete(reader)
        return found

    def _leave(self) -> None:
        if self._domain > 0:
            self._lib.wait.dds_delete(self._domain)

    def _end(
        self, create: Callable[..., int], topic: str, kind: str, quality: QualityOfService
    ) -> int:
        wish = quality.qos(self._lib)
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

    def _watch(self, end: DdsWriter | DdsReader, status: int) -> None:
        quick = self._lib.quick
        self._ends[end.entity] = end
        self._lib.checked(quick.dds_set_status_mask(end.entity, status), "what to wait for")
        attached = quick.dds_waitset_attach(self._waitset, end.entity, end.entity)
        self._lib.checked(attached, "what to wait for")


# ---------------------------------------------------------------------- network and domain

# Highest that leaves room for its ports. Source: ROS 2, "The ROS_DOMAIN_ID".
LAST_DOMAIN = 232
LOOPBACK = '<Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces>'
# What a reader may get, and fragments as large as the loopback takes: images cost less.
LOOPBACK_GENERAL = (
    f"<General>{LOOPBACK}<MaxMessageSize>65500B</MaxMessageSize>"
    "<FragmentSize>63000B</FragmentSize></General>"
)
# As many processes may take part on this machine as ports allow.
DISCOVERY = (
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>{most}</MaxAutoParticipantIndex>{peers}</Discovery>"
)
# A subscriber that died must not stop the others; messages are limited to 32 MB.
INTERNAL = (
    "<Internal><Watermarks><WhcHigh>256MB</WhcHigh><WhcAdaptive>false</WhcAdaptive></Watermarks>"
    "<MaxSampleSize>32MB</MaxSampleSize></Internal>"
)
NO_MULTICAST = "<General><AllowMulticast>false</AllowMulticast></General>"
#: CYCLONEDDS_URI that keeps a ROS 2 program on the loopback beside the simulator.
CLIENT_URI = f"<General>{LOOPBACK}</General>"


@dataclass(frozen=True)
class Network:
    """The domain and the interfaces of a participant.

    Args:
        domain: ROS_DOMAIN_ID
        config: Cyclone DDS's XML; None: that of the environment's CYCLONEDDS_URI
        reach: in words, for the start line
        set: what a ROS 2 terminal must set to meet us, beside the domain and the RMW
    """

    domain: int = 0
    config: str | None = None
    reach: str = ""
    set: str = ""


def network(environment: Mapping[str, str]) -> Network:
    """Read ROS_DOMAIN_ID, CYCLONEDDS_URI, ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_LOCALHOST_ONLY.

    Without any of them: domain 0, on the loopback only.

    Raises:
        InputError: a value that none of them can have
    """
    domain = _domain(environment.get("ROS_DOMAIN_ID", ""))
    if environment.get("CYCLONEDDS_URI"):
        return Network(domain, None, "where CYCLONEDDS_URI says", "CYCLONEDDS_URI=...")
    chosen = _range(environment)
    if chosen == "SUBNET":
        config = DISCOVERY.format(most=32, peers="") + INTERNAL
        return Network(domain, config, "the whole network, without any password", "")
    peers = '<Peers><Peer address="{}"/></Peers>'
    if chosen == "LOCALHOST":
        config = NO_MULTICAST + DISCOVERY.format(most=32, peers=peers.format("localhost"))
        same = "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        return Network(domain, config + INTERNAL, "programs on this machine", same)
    config = LOOPBACK_GENERAL + DISCOVERY.format(most=120, peers=peers.format("127.0.0.1"))
    return Network(domain, config + INTERNAL, "the loopback only", f"CYCLONEDDS_URI='{CLIENT_URI}'")


def _domain(text: str) -> int:
    if not text:
        return 0
    if not text.isascii() or not text.isdigit() or int(text) > LAST_DOMAIN:
        raise InputError(f"ROS_DOMAIN_ID: got {text!r}; allowed: 0 to {LAST_DOMAIN}")
    return int(text)


def _range(environment: Mapping[str, str]) -> str:
    only = environment.get("ROS_LOCALHOST_ONLY", "")
    if only not in ("", "0", "1"):
        raise InputError(f"ROS_LOCALHOST_ONLY: got {only!r}; allowed: 0, 1")
    if only == "1":
        return "LOOPBACK"
    chosen = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if chosen == "SYSTEM_DEFAULT":
        return "SUBNET"
    if chosen not in ("", "SUBNET", "LOCALHOST"):
        raise InputError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE: got {chosen!r}; "
            "allowed: LOCALHOST, SUBNET, SYSTEM_DEFAULT"
        )
    return chosen or ("SUBNET" if only == "0" else "LOOPBACK")
