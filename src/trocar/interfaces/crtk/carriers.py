"""The transports that a core has: started together, and none of them in the way of another."""

from __future__ import annotations

import logging
from contextlib import ExitStack
from typing import TYPE_CHECKING

from trocar.interfaces.crtk.transport import Batch, Transport

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

_log = logging.getLogger("trocar")


class Carriers:
    """Keep transports, those that run apart from those that do not yet."""

    def __init__(self) -> None:
        self._waiting: list[Transport] = []
        self._running: tuple[Transport, ...] = ()
        self._begun = False
        self._broken: set[str] = set()

    def add(self, transport: Transport, core: Core) -> None:
        """Take one more; it starts with the others, or now when they run."""
        if self._begun:
            transport.start(core)
            self._running += (transport,)
        else:
            self._waiting.append(transport)

    def start(self, core: Core) -> None:
        """Start all.

        Raises:
            TrocarError: one cannot start; none of the others runs then
        """
        with ExitStack() as started:
            for transport in self._waiting:
                transport.start(core)
                started.callback(transport.close)
            started.pop_all()
        self._running, self._begun = tuple(self._waiting), True

    def wanted(self) -> list[tuple[Transport, frozenset[str]]]:
        """Return what each that runs wants."""
        return [(transport, self._asked(transport)) for transport in self._running]

    def send(self, transport: Transport, batch: Batch) -> None:
        """Hand a batch over; a transport that breaks does not end the others' messages."""
        try:
            transport.send(batch)
        except Exception:  # noqa: BLE001  logged whole
            self._complain(transport)

    def _asked(self, transport: Transport) -> frozenset[str]:
        try:
            return transport.wanted()
        except Exception:  # noqa: BLE001  logged whole
            self._complain(transport)
            return frozenset()

    def _complain(self, transport: Transport) -> None:
        """Log what was raised just now, once for each transport."""
        if transport.name not in self._broken:
            self._broken.add(transport.name)
            _log.exception("%s: messages are lost", transport.name)

    def close(self) -> None:
        """Close those that run, the newest first."""
        running, self._running = self._running, ()
        for transport in reversed(running):
            transport.close()
