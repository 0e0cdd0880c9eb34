"""An instrument exchanged while the loop runs: at a tick boundary, and in sight on the page."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from trocar.live import Command, Loop
from trocar.simulation import World
from trocar.viewer.page import Page
from trocar.viewer.panel import NONE, SETTLED, ArmControls, read_arm
from trocar.viewer.scene import Bodies
from trocar.viewer.server import LocalServer, serving

MARYLAND = "MARYLAND_BIPOLAR_FORCEPS:400172"
PROGRASP = "PROGRASP_FORCEPS:420093"


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


def test_an_exchange_is_applied_between_two_ticks() -> None:
    world = World("three_psm")
    loop = Loop(world, speed="max")
    loop.post(Command("PSM2", "move_to", {"name": "work"}))
    loop.start(duration_s=1.0)
    loop.post(Command("PSM1", "set_tool_type", {"name": MARYLAND}))
    loop.post(Command("PSM1", "set_tool_type", {"name": "SPOON"}))
    loop.post(Command("PSM1", "jaw.move_jp", {"q": [0.5]}))
    loop.wait()
    assert world.arm("PSM1").description.tool == MARYLAND == loop.latest.arms["PSM1"].tool
    assert loop.state.refused == 1  # the spoon
    assert loop.latest.build == 2
    assert loop.latest.arms["PSM1"].q[6] == pytest.approx(0.5, abs=0.01)
    assert loop.latest.arms["PSM2"].q[:2] == pytest.approx(
        world.arm("PSM2").joints.poses["work"][:2], abs=0.02
    )


def test_only_the_bodies_that_look_otherwise_are_sent_again(server: LocalServer) -> None:
    world = World("three_psm")
    bodies = Bodies(server.scene, world.shapes())
    assert bodies.renew(world.shapes()) == 0
    world.exchange_tool("PSM1", MARYLAND)
    assert bodies.renew(world.shapes()) == 3  # the wrist, and two fingers
    assert bodies.show(world.snapshot()) == len(bodies.glbs)


def test_the_instruments_that_fit_are_read_off_an_arm() -> None:
    info = read_arm(World("psm"), "PSM1")
    assert info.tool == "LARGE_NEEDLE_DRIVER:400006" and PROGRASP in info.tools
    assert read_arm(World("ecm"), "ECM").tools == ()


def test_a_person_chooses_an_instrument(server: LocalServer) -> None:
    world, posted = World("psm"), []
    loop: Any = SimpleNamespace(post=posted.append)
    info = read_arm(world, "PSM1")
    choice = ArmControls(server.gui, loop, info, world.snapshot()).instrument
    assert choice is not None
    assert choice.handle.value == info.tool
    assert set(choice.handle.options) == {*info.tools, NONE}  # type: ignore[attr-defined]
    choice.handle.value = MARYLAND
    choice.touch(MARYLAND)
    assert posted == [Command("world", "exchange_tool", {"name": "PSM1", "tool": MARYLAND})]
    choice.show(info.tool)  # still the old one: the exchange is on its way
    assert choice.handle.value == MARYLAND
    for _ in range(SETTLED):
        choice.show(info.tool)  # it was refused
    assert choice.handle.value == info.tool
    posted[0].apply(world)
    assert world.arm("PSM1").description.tool == MARYLAND


def test_the_page_shows_the_new_instrument_and_its_limits(server: LocalServer) -> None:
    world = World("psm")
    loop = Loop(world, speed="max")
    page = Page(server, world, loop)
    desk = page.open(server)
    desk.build(1920)
    assert desk.panel is not None and desk.tables is not None
    assert desk.panel.controls is not None
    wide = desk.panel.controls.sliders.handles[5]
    assert wide.label == "wrist_yaw deg" and wide.max == pytest.approx(80.0, abs=0.1)
    looks = dict(page.bodies.glbs)

    def look() -> None:
        for _ in range(12):
            loop.run(0.02)
            page.refresh()

    look()
    loop.post(Command("PSM1", "set_tool_type", {"name": MARYLAND}))
    look()
    assert desk.panel.controls is not None
    sliders = desk.panel.controls.sliders.handles
    assert sliders[5].max == pytest.approx(90.0, abs=0.1)
    changed = [body for body, packed in page.bodies.glbs.items() if looks[body] != packed]
    assert len(changed) == 3
    assert desk.panel.controls.instrument is not None
    assert desk.panel.controls.instrument.handle.value == MARYLAND
    loop.post(
        Command("PSM1", "set_tool_type", {"name": "none"})
    )  # fewer joints and bodies than the page knew
    look()
    assert desk.panel.controls is not None
    assert len(desk.panel.controls.sliders.handles) == 3
    assert len(page.bodies.glbs) == len(looks) - 5
    assert "PSM1/insertion/measured" in desk.tables.joints.content
    assert "jaw" not in desk.tables.joints.content
    assert page.bodies.show(loop.latest) == 0  # everything was sent


def test_another_arm_s_controls_wait_for_its_sheet(server: LocalServer) -> None:
    """An arm that lost its jaw while another one was on the panel, and is chosen then."""
    world = World("three_psm")
    loop = Loop(world, speed="max")
    page = Page(server, world, loop)
    desk = page.open(server)
    desk.build(1920)
    assert desk.panel is not None and desk.tables is not None
    loop.post(Command("PSM2", "set_tool_type", {"name": "none"}))
    for _ in range(6):
        loop.run(0.02)
        page.refresh()
    desk.panel.choice.value = "PSM2"
    desk.panel.choose()
    assert desk.panel.controls is None
    for _ in range(12):
        page.refresh()
        loop.run(0.02)
    assert desk.panel.controls is not None
    assert len(desk.panel.controls.sliders.handles) == 3
