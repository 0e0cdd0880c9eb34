"""What a browser shows over the scene: the workspace of an arm, the outline, pictures of depth."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.kinematics.workspace import workspace
from trocar.live import Command, Loop
from trocar.simulation import World
from trocar.simulation.journal import WORLD
from trocar.viewer.server import LocalServer, serving
from trocar.viewer.workspace import WorkspaceSurface


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


@pytest.fixture(scope="module")
def loop() -> Iterator[Loop]:
    loop = Loop(World("full_cart"))
    loop.post(Command(WORLD, "pause"))
    loop.start()
    yield loop
    loop.stop()


def browser(server: LocalServer, arm: str = "ECM") -> Any:
    panel = SimpleNamespace(arm=SimpleNamespace(name=arm))
    return SimpleNamespace(browser=server, panel=panel, pressers={})


def until(met: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not met():
        assert time.monotonic() < end, "in vain"
        time.sleep(0.01)


def test_the_surface_stands_where_the_arm_does_and_says_why_it_does_not(
    server: LocalServer, loop: Loop
) -> None:
    desk = browser(server)
    surface = WorkspaceSurface(desk, loop)

    def shows(line: str) -> bool:
        surface.show()
        return line in surface.line

    surface.show()
    assert surface.node is None and surface.line == ""  # off by default
    surface.box.value = True
    until(lambda: shows("ECM: "))
    until(lambda: surface.node is not None or shows("never"))
    assert surface.node is not None
    T, mechanism = loop.ask(
        lambda world: (world.reference_pose("ECM"), world.arm("ECM").description.mechanism)
    ).result()
    assert np.allclose(surface.node.position, T[:3, 3])
    assert np.allclose(matrix_from_quaternion(surface.node.wxyz), T[:3, :3])
    assert np.allclose(surface.node.vertices, workspace(mechanism).vertices, atol=1e-6)
    desk.panel.arm.name = "SUJ_ECM"
    until(lambda: shows("SUJ_ECM has no tip"))
    assert surface.node is None
    surface.close()
    assert surface.line == ""
