"""rclpy's stand-in in place of rclpy, and simulators that speak by it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager

import pytest

from tests.ros.rclpy_node.stand_in import Wire, modules, packages
from tests.ros.served import running
from trocar.ros import Core
from trocar.ros.transports.rclpy_node import REACH, RclpyTransport

Serving = Callable[..., AbstractContextManager[tuple[Core, RclpyTransport]]]


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    """Let rclpy be imported, and every package of messages but trocar's own."""
    for name in REACH:
        monkeypatch.delenv(name, raising=False)
    found = Wire()
    for name, module in (*modules(found).items(), *packages(["trocar_msgs"]).items()):
        monkeypatch.setitem(sys.modules, name, module)
    return found


@pytest.fixture
def serving(wire: Wire) -> Serving:  # noqa: ARG001  rclpy has to be there
    """Run a PSM on rclpy for as long as a block."""
    return lambda: running(RclpyTransport())
