"""A service as rmw_cyclonedds_cpp has it: two topics, and 16 octets that tell whose call it is.

Source: rmw_cyclonedds_cpp, `cdds_request_header_t` {uint64 guid; int64 seq} before the message.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from trocar.interfaces.crtk.messages import ServiceType, cdr_decode, cdr_encode
from trocar.interfaces.crtk.transports.ros2 import names
from trocar.interfaces.crtk.transports.ros2.bus import Bus, Reader, Taken, Writer
from trocar.interfaces.crtk.transports.ros2.hashes import type_hash
from trocar.interfaces.crtk.transports.ros2.quality import Quality

HEADER = slice(4, 20)
# Calls and answers that wait. Source: rmw, rmw_qos_profile_services_default.
DEPTH = 10
# How long an answer waits until its caller listens. Source: rmw_cyclonedds_cpp, 100 ms.
LISTENS_S = 0.1
LOOK_S = 0.01


@dataclass(frozen=True)
class Served:
    """A service's two ends."""

    name: str
    kind: ServiceType
    requests: Reader
    replies: Writer


def open_service(bus: Bus, name: str, kind: ServiceType, number: int) -> Served:
    """Offer a service; `number` tells it from the participant's others."""
    own = names.endpoint_id(bus.guid, number)

    def quality(half: Any) -> Quality:
        data = names.user_data(serviceid=own, typehash=type_hash(half))
        return Quality(DEPTH, user_data=data)

    reply, request = names.reply_name(name), names.request_name(name)
    return Served(
        name,
        kind,
        bus.reader(request, kind.request.dds_name, quality(kind.request)),
        bus.writer(reply, kind.response.dds_name, quality(kind.response)),
    )


def read_request(served: Served, taken: Taken) -> dict[str, Any]:
    """Return what was asked.

    Raises:
        MessageError: the bytes are no request of this service
    """
    payload = taken.payload
    return cdr_decode(served.kind.request, payload[: HEADER.start] + payload[HEADER.stop :])


def reply(served: Served, taken: Taken, answer: dict[str, Any]) -> bool:
    """Answer; return False when the caller is gone, or does not listen in time.

    Raises:
        MessageError: the answer is none of this service
    """
    payload = cdr_encode(served.kind.response, answer)
    if not _listens(served, taken.writer):
        return False
    header = taken.payload[HEADER]
    return served.replies.write(payload[: HEADER.start] + header + payload[HEADER.start :])


def _listens(served: Served, caller: int) -> bool:
    """Wait until the caller's own reader is known, or any when the caller has no name."""
    data = served.requests.user_data_of(caller)
    if data is None:
        return False
    name = names.read_user_data(data, "clientid")
    until = time.monotonic() + LISTENS_S
    while not any(_is(served, handle, name) for handle in served.replies.readers()):
        if time.monotonic() > until:
            return False
        time.sleep(LOOK_S)
    return True


def _is(served: Served, reader: int, name: str | None) -> bool:
    if name is None:
        return True
    data = served.replies.user_data_of(reader)
    return data is not None and names.read_user_data(data, "clientid") == name
