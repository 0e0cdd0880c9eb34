"""rclpy's stand-in in place of rclpy, and simulators that speak by it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

from trocar.interfaces import Loop
from trocar.interfaces.crtk import Core
from trocar.interfaces.crtk.transports.rclpy_node import RclpyTransport
from trocar.interfaces.crtk.transports.rclpy_node.reach import SAID
from trocar.interfaces.loop import SERVER_TICK_S
from trocar.simulation import World

from .stand_in import Wire, modules, packages

Serving = Callable[..., AbstractContextManager[tuple[Core, RclpyTransport]]]


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    """Let rclpy be imported, and every package of messages but trocar's own."""
    for name in SAID:
        monkeypatch.delenv(name, raising=False)
    found = Wire()
    for name, module in (*modules(found).items(), *packages(["trocar_msgs"]).items()):
        monkeypatch.setitem(sys.modules, name, module)
    return found


@pytest.fixture
def serving(wire: Wire) -> Serving:  # noqa: ARG001  rclpy has to be there
    """Run a PSM on rclpy for as long as a block."""

    @contextmanager
    def serve() -> Iterator[tuple[Core, RclpyTransport]]:
        loop = Loop(World("psm"), tick_s=SERVER_TICK_S)
        core, transport = Core(loop), RclpyTransport()
        core.attach(transport)
        core.start()
        loop.start()
        try:
            yield core, transport
        finally:
            loop.stop()
            core.close()

    return serve
