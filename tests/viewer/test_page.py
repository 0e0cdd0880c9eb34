"""The page's parts, without a browser: what they post, what they show, what they send."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser

from tests.live.fake_world import FakeWorld
from tests.viewer.visitor import visiting
from trocar.live import Command, Loop
from trocar.simulation import World
from trocar.simulation.records import DrawnCurve
from trocar.viewer.driving import Driving, DrivingTab, Pedal
from trocar.viewer.measurements import (
    SPAN_S,
    History,
    Span,
    axis_span,
    joint_table,
    simulation_cards,
)
from trocar.viewer.page import Page
from trocar.viewer.panel import (
    ANGLE,
    HANDS_OFF,
    LENGTH,
    SETTLED,
    ArmControls,
    JointInfo,
    JointSliders,
    effort_range,
    goal_range,
    read_arm,
)
from trocar.viewer.scene import (
    FIELD_OF_VIEW,
    SHEET,
    VIEW,
    Bodies,
    Drawings,
    camera_above_sheet,
    camera_for,
)
from trocar.viewer.server import LocalServer, serving


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


class Desk:
    """The sliders of PSM1 of a fake world, and what they post."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self.world: Any = FakeWorld()
        self.posted: list[Any] = []
        self.loop: Any = SimpleNamespace(post=self.posted.append)
        self.info = read_arm(self.world, "PSM1")
        self.sliders = JointSliders(gui, self.loop, self.info, self.now)

    @property
    def now(self):
        return self.world.snapshot().arms["PSM1"]

    @property
    def shown(self) -> list[float]:
        return [handle.value for handle in self.sliders.handles]

    def drag(self, joint: int, value: float) -> None:
        self.sliders.handles[joint].value = value
        self.sliders.touch(joint, value)


@pytest.fixture
def desk(server: LocalServer) -> Desk:
    return Desk(server.gui)


def test_sliders_start_at_the_set_points(server: LocalServer) -> None:
    desk = Desk(server.gui)
    desk.world.arms["PSM1"].setpoint[:] = [0.1, -0.2, 0.1, 1.0, 0.5]
    sliders = JointSliders(server.gui, desk.loop, desk.info, desk.now)
    shown = [handle.value for handle in sliders.handles]
    assert shown == pytest.approx([5.7, -11.5, 100.0, 57.3, 28.6], abs=1e-9)
    assert desk.posted == []


def test_a_drag_posts_a_move_of_that_joint_alone(desk: Desk) -> None:
    desk.drag(2, 150.0)
    desk.drag(0, 30.0)
    assert [command.verb for command in desk.posted] == ["move_jp"] * 2
    assert desk.posted[0].kwargs["q"] == pytest.approx((0.0, 0.0, 0.15, 0.0))
    assert desk.posted[1].kwargs["q"] == pytest.approx((np.deg2rad(30), 0.0, 0.15, 0.0))


def test_the_jaw_has_a_command_of_its_own(desk: Desk) -> None:
    desk.drag(4, -20.0)
    assert desk.posted[0].verb == "jaw.move_jp"
    assert desk.posted[0].kwargs["q"] == pytest.approx((np.deg2rad(-20),))


def test_sliders_stay_under_the_hand_and_follow_otherwise(desk: Desk) -> None:
    desk.drag(0, 30.0)
    desk.sliders.follow(desk.now._replace(busy=True))
    assert desk.shown[0] == 30.0  # the arm is still on its way
    arm = desk.world.arms["PSM1"]
    arm.setpoint[0] = np.deg2rad(30.0)
    for _ in range(HANDS_OFF + 1):
        desk.sliders.follow(desk.now._replace(busy=False))
    arm.setpoint[:] = 0.05  # moved by somebody else
    desk.sliders.follow(desk.now._replace(busy=True))
    assert desk.shown == pytest.approx([2.9, 2.9, 50.0, 2.9, 2.9])
    assert len(desk.posted) == 1


def test_following_itself_posts_nothing(desk: Desk) -> None:
    desk.world.arms["PSM1"].setpoint[:] = 0.05
    desk.sliders.follow(desk.now)
    assert desk.shown[0] == pytest.approx(2.9)
    assert desk.posted == []


def test_in_effort_mode_sliders_are_efforts_from_zero(desk: Desk) -> None:
    desk.world.arms["PSM1"].joints.set_mode("effort", ("yaw", "jaw"))
    desk.sliders.follow(desk.now)
    yaw, pitch = desk.sliders.handles[:2]
    assert (yaw.label, yaw.min, yaw.max, yaw.value) == ("yaw N m", -3.31, 3.31, 0.0)
    assert pitch.label == "pitch deg"
    desk.drag(0, 0.5)
    assert desk.posted == [Command("PSM1", "servo_jf", {"effort": (0.5, 0.0, 0.0, 0.0)})]


def test_a_locked_brake_greys_its_slider_out(server: LocalServer) -> None:
    desk = Desk(server.gui)
    info = read_arm(desk.world, "SUJ1")
    arm = desk.world.snapshot().arms["SUJ1"]
    sliders = JointSliders(server.gui, desk.loop, info, arm)
    sliders.follow(arm._replace(locked=(True, False)))
    assert [handle.disabled for handle in sliders.handles] == [True, False]


def test_gains_are_posted_when_the_typing_is_over(desk: Desk, server: LocalServer) -> None:
    yaw = ArmControls(server.gui, desk.loop, desk.info, desk.world.snapshot()).gains["yaw"]
    for gains in ((1.0, 0.0, 5.0), (15.0, 0.0, 5.0), (150.0, 0.0, 5.0)):
        yaw.handle.value = gains
        yaw.touch(gains)
        yaw.show((100.0, 0.0, 5.0))
    assert desk.posted == []
    for _ in range(SETTLED):
        yaw.show((100.0, 0.0, 5.0))
    gains = {"joint": "yaw", "p": 150.0, "i": 0.0, "d": 5.0}
    assert desk.posted == [Command("PSM1", "set_gains", gains)]
    yaw.show((100.0, 0.0, 5.0))  # still the old gains: not shown, the new ones are on their way
    assert yaw.handle.value == (150.0, 0.0, 5.0)
    for _ in range(SETTLED):
        yaw.show((100.0, 0.0, 5.0))
    assert yaw.handle.value == (100.0, 0.0, 5.0)
    assert len(desk.posted) == 1


def test_the_page_names_the_clients_that_command_the_arm(server: LocalServer) -> None:
    world = World("psm")
    loop = Loop(world)
    arm = ArmControls(server.gui, loop, read_arm(world, "PSM1"), world.snapshot())
    for shown in ("none", "/alice", "/alice, /bob"):
        arm.follow(world.snapshot())
        assert arm.clients.value == shown
        loop.commanders.claim("PSM1", "/bob" if shown == "/alice" else "/alice")


def test_fingers_squeeze_a_gripper_and_let_it_go(server: LocalServer) -> None:
    world, posted = World("mtm"), []
    loop: Any = SimpleNamespace(post=posted.append)
    info = read_arm(world, "MTMR")
    sliders = JointSliders(server.gui, loop, info, world.snapshot().arms["MTMR"])
    sliders.touch(7, 10.0)
    sliders.touch(7, 60.0)
    assert posted[0] == Command(
        "MTMR", "gripper.squeeze_to", {"angle": pytest.approx(np.deg2rad(10))}
    )
    assert posted[1] == Command("MTMR", "gripper.release", {})
    for command in posted:
        command.apply(world)


def joint(lower: float, upper: float, unit=ANGLE, effort: float = 1.0) -> JointInfo:
    return JointInfo("yaw", unit, lower, upper, effort, (1.0, 0.0, 0.0))


@pytest.mark.parametrize(("lower", "upper"), [(-1.59941, 1.59941), (0.0, 0.24), (-0.7, 1.39626)])
@pytest.mark.parametrize("unit", [ANGLE, LENGTH])
def test_a_slider_stays_inside_the_limits(lower: float, upper: float, unit) -> None:
    low, high, step = goal_range(joint(lower, upper, unit))
    assert lower * unit.scale - 1e-9 <= low < lower * unit.scale + step
    assert upper * unit.scale - step < high <= upper * unit.scale + 1e-9


@pytest.mark.parametrize("limit", [0.16, 0.35, 3.316, 9.88, 100.0, 80.66])
def test_an_effort_slider_stays_inside_the_limit(limit: float) -> None:
    low, high, step = effort_range(joint(-1, 1, effort=limit))
    assert low == -high
    assert 0.9 * limit < high <= limit + 1e-9
    assert 50 < high / step < 1001


def test_arm_info_is_read_off_a_real_arm() -> None:
    world = World("psm")
    info = read_arm(world, "PSM1")
    assert [joint.unit for joint in info.joints] == [LENGTH if k == 2 else ANGLE for k in range(7)]
    assert info.joints[0].effort_max == pytest.approx(3.316, abs=1e-3)
    assert info.gravity_compensation and not info.has_brakes
    assert info.joints[-1].is_jaw and "home" in info.poses
    world.arm("PSM1").joints.use_gravity_compensation(False)
    world.arm("PSM1").joints.set_gains("yaw", p=11.0)
    info = read_arm(world, "PSM1")
    assert not info.gravity_compensation
    assert info.joints[0].gains[0] == 11.0


def test_history_keeps_the_last_seconds_and_forgets_after_a_reset() -> None:
    history, world = History(), FakeWorld()
    world.arms["PSM1"].goal[0] = 0.3
    for _ in range(360):
        world.step(40)
        history.add(world.snapshot())
        history.add(world.snapshot())  # the same moment counts once
    trace = history.trace("PSM1", 0)
    assert trace.ago[-1] == 0.0 and -SPAN_S - 1e-6 <= trace.ago[0] < -SPAN_S + 0.05
    assert np.all(np.diff(trace.ago) > 0)
    assert trace.commanded[-1] == 0.3
    world.reset()
    history.add(world.snapshot())
    assert history.trace("PSM1", 0).ago.tolist() == [0.0]
    assert History().trace("PSM1", 0).ago.size == 0


@pytest.mark.parametrize("middle", [-1234.5, 0.0, 0.013])
@pytest.mark.parametrize("height", [0.0, 1e-3, 0.7, 89.0])
def test_an_axis_holds_its_values_between_round_numbers(middle: float, height: float) -> None:
    values = middle + height * np.array([-0.5, 0.5])
    span = axis_span(values, Span(0.0, 0.0), least=0.01)
    assert span.low <= values.min() and values.max() <= span.high
    assert 0.01 <= span.high - span.low <= 3 * max(height, 0.01) + 1e-9
    assert axis_span(values, span, least=0.01) == span


@pytest.mark.parametrize("aspect", [0.3, 0.46, 0.9])
def test_on_a_phone_the_view_stands_above_the_sheet(aspect: float) -> None:
    points = np.random.default_rng(0).uniform([0.5, 1.5, 0.2], [1.5, 2.5, 1.2], (200, 3))
    position, look_at = camera_above_sheet(*camera_for(points, VIEW), aspect)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    x, y, z = np.stack([right, np.cross(right, forward), forward]) @ (points - position).T
    t = np.tan(FIELD_OF_VIEW / 2)
    assert np.abs(x / z / t).max() <= aspect
    assert (y / z / t).max() <= 1.0 and (y / z / t).min() >= 2 * SHEET - 1.0


def test_bodies_send_only_what_moved(server: LocalServer) -> None:
    world: Any = FakeWorld()
    bodies = Bodies(server.scene, world.shapes())
    assert bodies.show(world.snapshot()) == 7
    assert bodies.show(world.snapshot()) == 0
    world.arms["PSM2"].q[2] += 0.01  # the insertion carries two bodies
    assert bodies.show(world.snapshot()) == 2


def test_small_moves_add_up_until_they_are_sent(server: LocalServer) -> None:
    world: Any = FakeWorld()
    bodies = Bodies(server.scene, world.shapes())
    bodies.show(world.snapshot())
    sent = 0
    for _ in range(10):
        world.arms["PSM2"].q[2] += 3e-6
        sent += bodies.show(world.snapshot())
    assert sent > 0


def test_drawings_send_only_what_bent_and_remove_what_is_gone(server: LocalServer) -> None:
    drawings, now = Drawings(server.scene), FakeWorld().snapshot()
    points = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.2, 0.1, 1.0]])
    thread, other = (DrawnCurve(name, points, 0.001) for name in ("thread", "other"))
    assert drawings.show(now._replace(drawings=(thread, other))) == 2
    assert drawings.show(now._replace(drawings=(thread, other))) == 0
    bent = thread._replace(points=points + np.array([0.0, 0.0, 0.01]))
    assert drawings.show(now._replace(drawings=(bent, other))) == 1
    assert drawings.nodes["thread"].vertices[:, 2].min() > 1.005
    assert drawings.show(now) == 0 and not drawings.nodes


def test_the_page_refreshes_with_a_reader_and_leaves_the_rest_alone_without(
    server: LocalServer,
) -> None:
    world: Any = FakeWorld()
    loop = Loop(world, speed="max")
    page = Page(server, world, loop)
    page.refresh()
    desk = page.open(server)
    desk.build(1920)
    assert desk.panel is not None and desk.tables is not None
    assert desk.tables.joints.content == ""
    loop.post(Command("PSM1", "move_jp", {"q": (0.5, 0.0, 0.1, 0.0)}))
    for _ in range(12):
        loop.run(0.1)
        page.refresh()
    assert desk.panel.arm.name == "PSM1"
    assert desk.panel.controls is not None
    assert desk.panel.controls.sliders.handles[0].value == pytest.approx(28.6, abs=0.2)
    assert "PSM1/yaw/measured" in desk.tables.joints.content
    desk.tools.set_visible(True)
    page.refresh()
    loop.run(0.01)
    page.refresh()
    assert np.allclose(desk.tools.nodes["PSM2"].position, (-0.15, -0.25, 0.9))


def test_tables_show_numbers_in_units_for_people() -> None:
    world: Any = FakeWorld()
    world.arms["PSM1"].q[:] = [np.deg2rad(12.345), -1e-9, 0.1, 0.0, 0.0]
    arm = world.snapshot().arms["PSM1"]
    table = joint_table(read_arm(world, "PSM1"), arm)
    assert '<td data-trocar="PSM1/yaw/measured">12.35</td>' in table.replace("12.34<", "12.35<")
    assert '<td data-trocar="PSM1/insertion/measured">100.00</td>' in table
    assert "-0.00" not in table and "insertion [mm]" in table
    state = Loop(world).state
    cards = simulation_cards(state, 1e-7, 3e-6)
    assert '<b class="" data-trocar="gap">0.040 &micro;m</b>' in cards
    assert '<b class="good" data-trocar="branch">ok</b>' in cards
    flipped = replace(state, health=replace(state.health, branch_ok=False), paused=True)
    assert '<b class="bad" data-trocar="branch">flipped</b>' in simulation_cards(flipped, 0, 0)
    assert '<b class="" data-trocar="rtf">paused</b>' in simulation_cards(flipped, 0, 0)


def test_a_message_cannot_smuggle_markup_into_the_page(server: LocalServer) -> None:
    world: Any = FakeWorld()
    page = Page(server, world, Loop(world))
    desk = page.open(server)
    desk.build(1920)
    assert desk.tables is not None
    with page.notices.listening():
        logging.getLogger("trocar").warning("<script>alert(1)</script>")
    page.fail(ValueError("<b>bold</b>"))
    content = desk.tables.messages.content
    assert "<script>" not in content and "&lt;b&gt;bold" in content


def test_a_pedal_is_pressed_by_its_box_and_its_key_and_shows_who_else_pressed_it(
    server: LocalServer,
) -> None:
    pressed, calls = [False], []

    def press(on: bool) -> None:
        pressed[0] = on
        calls.append(on)

    pedal = Pedal("Coag", press, lambda: pressed[0], "G")
    driving = Driving("Pedals", {}, lambda: "", pedals=[pedal])
    tab = DrivingTab(server, driving, "nonce")
    with visiting(server) as visitor:
        for on in (True, False, True):
            assert visitor.trigger("Pedal: Coag").props["hotkey"] == "G"
            assert calls[-1] is on and visitor.widget("Coag (G)").value is on
        for on in (False, True):
            visitor.use("Coag (G)", on)
            assert calls[-1] is on
        pressed[0] = False  # somebody else released it
        for _ in range(6 * (SETTLED + 1)):
            tab.show({})
        assert visitor.widget("Coag (G)").value is False and len(calls) == 5
