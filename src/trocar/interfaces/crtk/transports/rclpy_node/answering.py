"""Calls of services: rclpy's objects in and out, our messages between."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from trocar.errors import InputError
from trocar.interfaces.crtk.messages import blank, cdr_decode, cdr_encode, service_type
from trocar.interfaces.crtk.transports.rclpy_node.node import NoAnswerError

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.messages import ServiceType
    from trocar.interfaces.crtk.topics import Service
    from trocar.interfaces.crtk.transports.rclpy_node.library import Library

_log = logging.getLogger("trocar")

TIMEOUT_S = 5.0
# Longer ones are no call. Source: our own choice, 1 MB.
LONGEST = 1_000_000

Answer = Callable[[Any, Any], Any]


def answering(library: Library, core: Core, service: Service, made: Any) -> Answer:
    """Return what answers the calls of a service, to be given to `create_service`.

    Args:
        library: rclpy
        core: knows the answers
        service: its row
        made: its class, with `Request` and `Response`
    """
    kind = service_type(service.type)
    serialization = library.serialization

    def answer(request: Any, _response: Any) -> Any:
        try:
            data = serialization.serialize_message(request)
            if len(data) > LONGEST:
                raise InputError(f"got a call of {len(data)} bytes; allowed: {LONGEST}")
            found = core.call(service.name, cdr_decode(kind.request, data), TIMEOUT_S)
        except InputError as problem:
            _log.warning("ROS 2: %s: %s", service.name, problem)
            found = _refusal(kind, str(problem))
        except Exception as problem:
            _log.exception("ROS 2: %s: no answer", service.name)
            raise NoAnswerError from problem
        return serialization.deserialize_message(cdr_encode(kind.response, found), made.Response)

    return answer


def _refusal(kind: ServiceType, reason: str) -> dict[str, Any]:
    """Return an answer that says what was wrong.

    Raises:
        NoAnswerError: the type has no room for it
    """
    answer = blank(kind.response)
    if "message" not in answer:
        raise NoAnswerError
    return {**answer, "message": reason}
