"""Service calls wait for the simulation, so threads of their own make them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from trocar.errors import InputError
from trocar.interfaces.crtk.messages import blank
from trocar.interfaces.crtk.transports.ros2.bus import Taken
from trocar.interfaces.crtk.transports.ros2.service import HEADER, Served, read_request, reply

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

_log = logging.getLogger("trocar")

# Calls at a time, and calls that wait beyond them. Source: our own choice.
AT_ONCE = 4
WAITING = 64
TIMEOUT_S = 5.0
# Longer ones are no call. Source: our own choice, 1 MB.
LONGEST = 1_000_000


class Calls:
    """Answers the calls of every service."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._pool = ThreadPoolExecutor(AT_ONCE, "trocar-ros2-call")
        self._room = threading.BoundedSemaphore(AT_ONCE + WAITING)

    def answer(self, served: Served, calls: Sequence[Taken]) -> None:
        """Answer calls of a service, without waiting for it."""
        for call in calls:
            self._submit(served, call)

    def close(self) -> None:
        """End after the calls that are being answered."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _submit(self, served: Served, taken: Taken) -> None:
        if not HEADER.stop < len(taken.payload) <= LONGEST:
            _log.warning("ROS 2: %s: got a call of %d bytes", served.name, len(taken.payload))
            return
        if not self._room.acquire(blocking=False):
            _log.warning("ROS 2: %s: more than %d calls wait", served.name, WAITING)
            return
        future = self._pool.submit(self._answer, served, taken)
        future.add_done_callback(lambda _: self._room.release())

    def _answer(self, served: Served, taken: Taken) -> None:
        try:
            answer = self._core.call(served.name, read_request(served, taken), TIMEOUT_S)
        except InputError as problem:
            _log.warning("ROS 2: %s: %s", served.name, problem)
            answer = _refusal(served, str(problem))
        except Exception:  # noqa: BLE001  a pool would swallow it
            _log.exception("ROS 2: %s: no answer", served.name)
            return
        try:
            if answer is not None and not reply(served, taken, answer):
                _log.warning("ROS 2: %s: the caller does not listen any more", served.name)
        except InputError:
            _log.exception("ROS 2: %s: the answer cannot be written", served.name)


def _refusal(served: Served, reason: str) -> dict[str, object] | None:
    """Return an answer that says what was wrong; None where the type has no room for it."""
    answer = blank(served.kind.response)
    if "message" not in answer:
        return None
    return {**answer, "message": reason}
