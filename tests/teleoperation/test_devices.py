"""A newcomer at a keyboard or a gamepad: keys and sticks that are pressed by a script."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry import rotation_vector_from_matrix
from trocar.live import Loop
from trocar.ros import Core
from trocar.ros.transports.memory import MemoryTransport
from trocar.simulation import World
from trocar.teleoperation.devices import (
    AXES,
    PEDAL_KEYS,
    TABLES,
    DeviceCommand,
    from_keys,
    from_pad,
    from_spacemouse,
    table,
)
from trocar.teleoperation.session import Device


class Clock:
    time = 100.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float, until: object = None) -> None:  # noqa: ARG002
        self.time += seconds


class Session:
    """Somebody at a device, in the thread of the test."""

    def __init__(
        self, rig: str = "pegs", name: str = "KEYBOARD", published: Sequence[str] = ()
    ) -> None:
        self.world, self.clock = World(rig), Clock()
        if "work" in self.world.rig.poses:
            self.world.reset(pose="work")
        self.loop = Loop(self.world, tick_s=0.001, clock=self.clock)
        self.device = Device(self.loop, name)
        self.core = Core(self.loop, components=self.device.components())
        self.transport = MemoryTransport(["system/warning", *published])
        self.core.attach(self.transport)
        self.core.begin()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.001)):
            self.loop.tick()
            self.clock.time += 0.001
        self.core.publish_waiting()

    def press(self, *keys: str, seconds: float = 0.1) -> None:
        assert self.core.receive("teleop/keys", {"data": " ".join(keys)})
        self.run(seconds)

    def push(self, axes: list[float], buttons: list[float], seconds: float = 0.1) -> None:
        assert self.core.receive("teleop/gamepad", {"axes": axes, "buttons": buttons})
        self.run(seconds)

    def drive(self, drive: DeviceCommand, seconds: float = 0.4) -> None:
        self.device.receive(drive)
        self.run(seconds)

    def tip_in_image(self, arm: str = "PSM1") -> np.ndarray:
        """Return the measured tip in the endoscope's optical frame, (4, 4)."""
        camera = self.world.cameras()["endoscope"].T_world_camera
        T = self.world.reference_pose(arm) @ self.world.arm(arm).local.measured_cp().matrix
        return np.linalg.inv(camera) @ T

    def tip(self, arm: str = "PSM1") -> np.ndarray:
        """Return the measured tip as the endoscope sees it: right, up, away [m]."""
        return self.tip_in_image(arm)[:3, 3] * [1, -1, 1]

    def pointing(self, arm: str = "PSM1") -> np.ndarray:
        """Return where the jaws point as the endoscope sees it: right, up, away."""
        return self.tip_in_image(arm)[:3, 2] * [1, -1, 1]

    @property
    def state(self) -> str:
        return self.device.engine.components[self.device.used].current


#: The tops of the pegs at the left, and how far above them the wrist is when the jaws touch one.
#: Source: rig pegs; the jaws are about as long. [m]
PEGS, JAWS = ([0.044, 0.085, 0.126], [0.044, 0.107, 0.126]), [0.0, 0.0, 0.018]
KEYS = (("KeyD", "KeyA"), ("KeyW", "KeyS"), ("KeyR", "KeyF"))


def by_keys(session: Session, error: np.ndarray) -> None:
    """Hold the keys that lead on; the fine one when it is near."""
    held = [pair[int(e < 0.0)] for pair, e in zip(KEYS, error, strict=True) if abs(e) > 7e-4]
    if np.linalg.norm(error) < 5e-3:
        held.append("KeyX")
    session.press(*held)


def by_pad(session: Session, error: np.ndarray) -> None:
    """Lean the sticks as far as it is away."""
    lean = np.sign(error) * np.clip(np.abs(error) / 8e-3, 0.45, 1.0) * (np.abs(error) > 7e-4)
    fine = float(np.linalg.norm(error) < 5e-3)
    buttons = [0.0, 0.0, fine, 0, 0, 0, max(-lean[2], 0.0), max(lean[2], 0.0)]
    session.push([lean[0], -lean[1], 0.0, 0.0], buttons)


@pytest.mark.parametrize("way", [by_keys, by_pad])
@pytest.mark.parametrize("peg", [PEGS[0], pytest.param(PEGS[1], marks=pytest.mark.slow)])
def test_a_newcomer_brings_the_jaws_to_a_peg_within_a_target_of_two_millimetres(
    way: Callable[[Session, np.ndarray], None], peg: list[float]
) -> None:
    """The person sees where the tip was a fifth of a second ago, and needs no half minute."""
    session = Session()
    way(session, np.zeros(3))
    camera = session.world.cameras()["endoscope"].T_world_camera
    target = (np.linalg.inv(camera) @ [*np.add(peg, JAWS), 1.0])[:3] * [1, -1, 1]
    seen = [session.tip()] * 3
    for _ in range(200):
        way(session, target - seen[-3])
        seen.append(session.tip())
        if np.linalg.norm(target - seen[-1]) < 1e-3 and np.ptp(seen[-3:], axis=0).max() < 1e-4:
            break
    assert np.linalg.norm(target - seen[-1]) < 1e-3  # the radius of a target of 2 mm
    assert session.state == "ENABLED"


@pytest.mark.parametrize(
    ("key", "way"),
    [
        ("KeyD", (1, 0, 0)),
        ("KeyA", (-1, 0, 0)),
        ("KeyW", (0, 1, 0)),
        ("KeyS", (0, -1, 0)),
        ("KeyR", (0, 0, 1)),
        ("KeyF", (0, 0, -1)),
    ],
)
def test_each_key_moves_the_tip_its_way_in_the_picture(key: str, way: tuple[int, ...]) -> None:
    session = Session()
    session.press()
    before = session.tip()
    session.press(key, seconds=0.4)
    moved = session.tip() - before
    assert moved @ way == pytest.approx(0.004, abs=5e-4)


RIGHT, UP = (1, 0, 0), (0, 1, 0)
LEFT, DOWN = (-1, 0, 0), (0, -1, 0)


@pytest.mark.parametrize(
    ("drive", "way"),
    [
        (from_keys(["ArrowUp"]), UP),
        (from_keys(["ArrowDown"]), DOWN),
        (from_keys(["ArrowLeft"]), LEFT),
        (from_keys(["ArrowRight"]), RIGHT),
        (from_pad([0.0, 0.0, 0.0, -1.0], []), UP),
        (from_pad([0.0, 0.0, 0.0, 1.0], []), DOWN),
        (from_pad([0.0, 0.0, -1.0, 0.0], []), LEFT),
        (from_pad([0.0, 0.0, 1.0, 0.0], []), RIGHT),
        (from_spacemouse((0, 0, 0), (1.0, 0.0, 0.0), ()), UP),  # the cap's far edge is lifted
        (
            from_spacemouse((0, 0, 0), (0.0, 0.0, 1.0), ()),
            RIGHT,
        ),  # and goes right: clockwise from above
    ],
)
def test_arrows_stick_and_cap_turn_the_jaws_their_way_in_the_picture(
    drive: DeviceCommand, way: tuple[int, ...]
) -> None:
    session = Session()
    session.press()
    before = session.pointing()
    session.drive(drive)
    turned = session.pointing() - before
    assert turned @ way > 0.1
    assert turned @ way > 3.0 * np.abs(np.cross(turned, way)[2])  # that way, and not the other


@pytest.mark.parametrize(
    ("drive", "clockwise"),
    [
        (from_keys(["KeyE"]), 1),
        (from_keys(["KeyQ"]), -1),
        (from_pad([], [0.0] * 5 + [1.0]), 1),
        (from_pad([], [0.0] * 4 + [1.0]), -1),
        (from_spacemouse((0, 0, 0), (0.0, -1.0, 0.0), ()), 1),  # its right edge is pressed
    ],
)
def test_rolling_right_is_clockwise_in_the_picture(drive: DeviceCommand, clockwise: int) -> None:
    session = Session()
    session.press()
    before = session.tip_in_image()[:3, :3]
    session.drive(drive)
    turned = rotation_vector_from_matrix(session.tip_in_image()[:3, :3] @ before.T)
    assert clockwise * turned[2] > 0.1
    assert clockwise * turned[2] > 0.9 * np.linalg.norm(turned)


def test_keys_turn_and_grip_and_choose() -> None:
    session = Session()
    session.press()
    q = session.world.arm("PSM1").joints.setpoints()
    session.press("KeyE", seconds=0.3)
    turned = session.world.arm("PSM1").joints.setpoints() - q
    assert np.abs(turned[3:6]).max() > 0.1
    session.press("KeyC", seconds=0.4)
    session.press("KeyC", seconds=0.4)
    session.press("KeyC", seconds=0.3)
    assert session.world.arm("PSM1").joints.setpoints()[-1] < -0.1
    session.press("Digit2")
    assert session.device.used == "KEYBOARD_PSM2"
    assert session.state == "ENABLED"
    assert session.device.engine.components["KEYBOARD_PSM1"].current == "DISABLED"


def test_the_camera_key_drags_the_picture() -> None:
    session = Session()
    session.press()
    before = session.tip()
    session.press("KeyV", "KeyD", seconds=0.4)
    session.press("KeyV")
    assert (session.tip() - before)[0] > 0.002
    session.press()
    assert session.state == "ENABLED"


def test_a_device_that_falls_silent_holds_is_disabled_and_it_is_said(
    caplog: pytest.LogCaptureFixture,
) -> None:
    session = Session()
    session.press("KeyD", seconds=0.3)
    session.run(0.45)
    assert session.state == "DISABLED"
    assert "KEYBOARD: no message for 0.5 s" in caplog.text
    there = session.world.arm("PSM1").joints.setpoints()
    session.run(0.3)
    np.testing.assert_array_equal(session.world.arm("PSM1").joints.setpoints(), there)
    session.press()
    assert session.state == "ENABLED"


def test_a_device_waits_for_its_first_input_as_long_as_it_takes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    session = Session()
    assert "first input" in session.device.engine.components[session.device.used].message
    session.world.reset(pose="work")
    for _ in range(70):  # arms have 60 s to get ready
        session.world.step(1000)
        session.run(0.001)
    assert not caplog.text
    session.press("KeyD")
    assert session.state == "ENABLED"


@pytest.mark.parametrize(
    ("key", "topics"),
    [
        ("KeyK", ["console/clutch", "footpedals/clutch"]),
        ("KeyV", ["console/camera", "footpedals/camera"]),
        ("KeyG", ["footpedals/coag"]),
        ("KeyB", ["footpedals/bicoag"]),
        ("KeyY", ["footpedals/cam_minus"]),
        ("KeyU", ["footpedals/cam_plus"]),
    ],
)
def test_a_key_that_is_held_presses_a_pedal(key: str, topics: list[str]) -> None:
    session = Session(published=topics)
    session.press(key)
    session.press()
    for topic in topics:
        pressed = [m["buttons"] for m in session.transport.received[topic]]
        assert pressed[-2:] == [[1], [0]]


def test_a_page_that_loses_the_keys_releases_the_pedals() -> None:
    session = Session(published=["footpedals/coag"])
    session.press("KeyG")
    session.press("aside")
    assert session.transport.last("footpedals/coag")["buttons"] == [0]


def test_the_clutch_key_stops_the_tool_and_goes_on_when_it_is_released() -> None:
    session = Session()
    session.press("KeyD", seconds=0.3)
    session.press("KeyD", "KeyK", seconds=0.1)
    before = session.world.arm("PSM1").joints.setpoints()
    session.press("KeyD", "KeyK", seconds=0.3)
    np.testing.assert_array_equal(session.world.arm("PSM1").joints.setpoints(), before)
    session.press("KeyD", seconds=0.3)
    session.press("KeyD", seconds=0.3)
    assert np.abs(session.world.arm("PSM1").joints.setpoints() - before).max() > 1e-3


def test_a_page_that_loses_the_keys_puts_them_aside(caplog: pytest.LogCaptureFixture) -> None:
    session = Session()
    session.press("KeyD")
    session.press("aside", seconds=0.8)
    assert session.state == "DISABLED"
    assert not caplog.text
    session.press("KeyD")
    assert session.state == "ENABLED"


def test_a_tool_that_something_holds_up_is_not_pushed_into_a_fault(
    caplog: pytest.LogCaptureFixture,
) -> None:
    session = Session()
    session.press()
    for _ in range(30):
        session.press("KeyR", "ShiftLeft")  # into the board
    assert session.state == "ENABLED"
    assert "in its way" in caplog.text
    before = session.tip()
    session.press("KeyF", seconds=0.2)
    session.press("KeyF", "ShiftLeft", seconds=0.4)
    session.press("KeyF", "ShiftLeft", seconds=0.4)
    assert (session.tip() - before)[2] < -0.004


def test_a_tool_stops_at_its_limits_and_comes_back_at_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    session = Session()
    session.press()
    for _ in range(25):
        session.press("ArrowDown", "ShiftLeft")
    assert session.state == "ENABLED"
    assert "PSM1 cannot follow: wrist" in caplog.text
    before = session.world.arm("PSM1").joints.setpoints()
    session.press("ArrowUp", "ShiftLeft", seconds=0.2)
    assert np.abs(session.world.arm("PSM1").joints.setpoints() - before)[3:6].max() > 0.2


def test_the_same_keys_make_the_same_motion() -> None:
    def once() -> np.ndarray:
        session = Session()
        for keys in (["KeyD", "KeyE"], ["KeyR"], ["KeyX", "KeyW"]):
            session.press(*keys, seconds=0.2)
        return session.world.arm("PSM1").joints.readings()[0]

    np.testing.assert_array_equal(once(), once())


def test_what_is_no_gamepad_is_refused(caplog: pytest.LogCaptureFixture) -> None:
    session = Session()
    for buttons in ("abc", [[1]], ["a"], {"a": 1}, [float("nan")], [float("inf")], [[1], [2, 3]]):
        assert not session.core.receive("teleop/gamepad", {"axes": [0.0], "buttons": buttons})
    assert "got buttons[0] nan; allowed: finite" in caplog.text
    assert session.core.receive("teleop/gamepad", {"axes": [], "buttons": []})


def test_a_rig_without_instruments_and_an_arm_that_it_has_not_are_refused() -> None:
    with pytest.raises(InputError, match="has no instrument"):
        Device(Loop(World("mtm")), "KEYBOARD")
    with pytest.raises(InputError, match="allowed: PSM1, PSM2"):
        Device(Loop(World("pegs")), "KEYBOARD", "PSM7")


def test_sticks_at_rest_and_unknown_keys_do_nothing() -> None:
    for drive in (
        from_keys(["KeyZ", "F1"]),
        from_pad([0.1, -0.1, 0.0, 0.05], [0.0] * 17),
        from_pad([], []),
        from_spacemouse((0.05, 0.0, -0.1), (0.0, 0.0, 0.1), (False, False)),
    ):
        assert not drive.linear.any()
        assert not drive.angular.any()


def test_a_pad_and_a_spacemouse_move_as_the_tables_say() -> None:
    right = from_pad([1.0, 0.0, 0.0, 0.0], [])
    assert right.move == (1.0, 0.0, 0.0)
    assert from_pad([0.0, -1.0], []).move[1] == 1.0
    assert from_pad([], [0.0] * 7 + [1.0]).move[2] == 1.0
    assert from_spacemouse((1.0, 0.0, 0.0), (0, 0, 0), ()).move == (1.0, 0.0, 0.0)
    assert from_spacemouse((0.0, -1.0, 0.0), (0, 0, 0), ()).move == (0.0, 0.0, 1.0)
    assert from_spacemouse((0.0, 0.0, -1.0), (0, 0, 0), ()).move == (0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("drive", "mm_s", "deg_s"),
    [
        (from_keys(["KeyW", "ArrowUp"]), 10, 30),
        (from_pad([1.0, 0.0, 1.0, 0.0], []), 17, 52),
        (from_spacemouse((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), ()), 17, 52),
    ],
)
def test_speeds_are_those_of_the_documentation(drive: DeviceCommand, mm_s: int, deg_s: int) -> None:
    assert round(1e3 * np.linalg.norm(drive.linear)) == mm_s
    assert round(np.degrees(np.linalg.norm(drive.angular))) == deg_s


def test_the_fine_button_makes_sticks_slower_by_as_much_as_the_table_says() -> None:
    stick, said = [1.0, 0.0, 1.0, 0.0], {x.touch: x.does for x in TABLES["gamepad"]}
    full, fine = from_pad(stick, []), from_pad(stick, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(fine.linear, 0.2 * full.linear)
    np.testing.assert_allclose(fine.angular, 0.2 * full.angular)
    assert "0.2 of the speed" in said["X (held)"]


def test_a_table_lists_the_instruments_of_the_rig_only() -> None:
    def uses(device: str, *instruments: str) -> list[str]:
        return [x.does for x in table(device, instruments) if "select" in x.does]

    assert uses("keyboard", "PSM1", "PSM2") == ["select PSM1, PSM2"]
    assert uses("keyboard", "PSM1") == uses("gamepad", "PSM1") == []
    assert len(uses("gamepad", "PSM1", "PSM2")) == 1


def test_every_key_is_in_the_table_that_people_see() -> None:
    text = " ".join(line.touch for line in TABLES["keyboard"])
    for key in AXES:
        assert key.removeprefix("Key") in text or key.startswith("Arrow")
    for pedal, letter in PEDAL_KEYS.items():
        assert pedal == "operator_present" or f"{letter} " in text
