"""Masters that are carried by a hand or a recording, and masters that are somewhere else."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.teleoperation.console_rig import Bench
from tests.teleoperation.test_devices import Clock
from trocar.descriptions.catalogue import DATA
from trocar.errors import InputError, MissingExtraError, UnknownNameError
from trocar.geometry import angle_between
from trocar.live import Loop
from trocar.recording import record
from trocar.ros import Core
from trocar.ros.transports.memory import MemoryTransport
from trocar.simulation import World
from trocar.teleoperation import devices, engine_and_components
from trocar.teleoperation.devices import (
    STILL,
    DeviceCommand,
    Poll,
    Source,
    SpaceMouse,
    from_keys,
    from_spacemouse,
)
from trocar.teleoperation.motion import MasterMotion, MotionPlayer
from trocar.teleoperation.session import Session

REMOTE = """
[[teleop]]
kind = "psm"
master = "HAND"
slave = "PSM1"
gripper_threshold_deg = 0
"""


def test_a_hand_on_a_handle_carries_the_master_and_the_tool_follows() -> None:
    bench = Bench()
    bench.enable()
    world = bench.world
    base = world.reference_pose("MTMR")
    goal = base @ world.arm("MTMR").local.measured_cp().matrix
    tool = world.arm("PSM1").setpoint_cp().matrix[:3, 3]
    goal[:3, 3] += [0.02, 0.01, 0.015]
    bench.engine.carriers["MTMR"].carry(goal)
    bench.run(0.6)
    here = base @ world.arm("MTMR").local.measured_cp().matrix
    np.testing.assert_allclose(here[:3, 3], goal[:3, 3], atol=2e-3)
    moved = np.linalg.norm(world.arm("PSM1").setpoint_cp().matrix[:3, 3] - tool)
    assert moved == pytest.approx(0.2 * np.linalg.norm([0.02, 0.01, 0.015]), rel=0.1)
    bench.engine.carriers["MTMR"].let_go()
    assert not bench.engine.carriers["MTMR"].busy


@pytest.mark.slow
def test_a_recorded_motion_carries_the_masters_again(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    source = Bench()
    with record(source.world, tmp_path / "hands.mcap"):
        goal = source.world.arm("MTMR").measured_cp().matrix
        goal[:3, 3] += [0.03, 0.0, 0.0]
        source.carry("MTMR", goal)
        source.run(0.1)
    loop = Loop(World("full_cart_mtm", setup_joints="locked"), tick_s=0.001, speed="max")
    session = Session("masters", motion=str(tmp_path / "hands.mcap"))
    core = Core(loop, components=session.components(loop))
    core.attach(MemoryTransport([]))
    core.begin()
    assert session.engine is not None
    player = session.engine.players[0]
    assert isinstance(player, MotionPlayer)
    before = loop.world.arm("PSM1").setpoint_cp().matrix[:3, 3]
    while not player.over:
        assert loop.world.time < 15.0
        if not player.busy:
            before = loop.world.arm("PSM1").setpoint_cp().matrix[:3, 3]
        loop.tick()
    for _ in range(200):
        loop.tick()
    moved = loop.world.arm("PSM1").setpoint_cp().matrix[:3, 3] - before
    assert np.linalg.norm(moved) == pytest.approx(0.2 * 0.03, rel=0.15)


@pytest.mark.slow
def test_a_reset_lets_a_recorded_motion_begin_anew_once_its_master_is_aligned() -> None:
    bench = Bench()
    rest = bench.world.arm("MTMR").joints.setpoints()
    times = np.linspace(0.0, 1.0, 101)
    joints = np.tile(rest, (len(times), 1))
    joints[:, 0] += 0.1 * np.sin(times)
    player = MotionPlayer(bench.engine, MasterMotion(times, {"MTMR": joints}))
    bench.engine.players.append(player)
    bench.console.enable(True)
    bench.console.set_operator_present(True)
    one = bench.engine.components["MTMR_PSM1"]

    def wait_until(done: Callable[[], bool]) -> None:
        while not done():
            assert bench.world.time < 15.0
            bench.loop.tick()

    wait_until(lambda: player.busy)
    bench.run(0.5)
    for _ in range(2):
        bench.world.reset()
        bench.loop.tick()
        bench.loop.tick()
        assert not player.busy and not bench.engine.carriers["MTMR"].busy
        assert not one.following
        wait_until(lambda: player.busy)
        assert one.following
        wait_until(lambda: player.over)


class Away:
    """A rig whose master is somewhere else, and that master."""

    def __init__(self, folder: Path) -> None:
        text = (DATA / "rigs" / "two_psm_ecm.toml").read_text(encoding="utf-8")
        (folder / "rig.toml").write_text(text + REMOTE, encoding="utf-8")
        self.clock, self.world = Clock(), World(folder / "rig.toml")
        self.world.reset(pose="work")
        self.loop = Loop(self.world, tick_s=0.001, clock=self.clock)
        self.engine, parts = engine_and_components(self.loop)
        self.core = Core(self.loop, components=parts)
        self.transport = MemoryTransport(["HAND/move_cp", "HAND_PSM1/error"])
        self.core.attach(self.transport)
        self.core.begin()
        self.one = self.engine.components["HAND_PSM1"]
        self.at, self.turn = np.array([0.0, 0.0, 0.3]), {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}

    def run(self, seconds: float, *, talk: bool = True) -> None:
        for k in range(round(seconds / 0.001)):
            if talk and k % 10 == 0:
                place = dict(zip("xyz", self.at.tolist(), strict=True))
                pose = {"position": place, "orientation": self.turn}
                assert self.core.receive("HAND/measured_cp", {"pose": pose})
                grip = {"position": [0.6], "name": []}
                assert self.core.receive("HAND/gripper/measured_js", grip)
            self.loop.tick()
            self.clock.time += 0.001
        self.core.publish_waiting()


def test_a_master_somewhere_else_is_asked_to_turn_and_then_moves_the_tool(tmp_path: Path) -> None:
    away = Away(tmp_path)
    away.one.command("enable")
    away.run(0.2)
    assert away.one.current == "ALIGNING_MTM"
    goal = away.transport.last("HAND/move_cp")
    assert goal["header"]["frame_id"] == "HRSV"
    away.turn = goal["pose"]["orientation"]
    away.run(0.1)
    assert away.one.following
    before = away.world.arm("PSM1").setpoint_cp().matrix[:3, 3]
    away.at = np.add(away.at, [0.0, 0.01, 0.0])
    away.run(0.1)
    moved = away.world.arm("PSM1").setpoint_cp().matrix[:3, 3] - before
    assert np.linalg.norm(moved) == pytest.approx(0.002, abs=1e-6)


def test_a_master_that_vanishes_leaves_the_tool_where_it_is_and_it_is_said(tmp_path: Path) -> None:
    away = Away(tmp_path)
    away.one.command("enable")
    away.run(0.2)
    away.turn = away.transport.last("HAND/move_cp")["pose"]["orientation"]
    away.run(0.1)
    assert away.one.following
    there = away.world.arm("PSM1").joints.setpoints()
    away.run(0.3, talk=False)
    assert away.one.current == "DISABLED"
    assert not away.one.following
    assert "HAND: no message for 0.1 s" in str(away.transport.last("HAND_PSM1/error")["data"])
    np.testing.assert_array_equal(away.world.arm("PSM1").joints.setpoints()[:6], there[:6])


@pytest.mark.parametrize("key", ["KeyW", "KeyE", "KeyC"])
def test_half_the_scale_of_a_device_halves_all_its_speeds(key: str) -> None:
    def changed(scale: float) -> np.ndarray:
        world = World("pegs")
        world.reset(pose="work")
        loop = Loop(world, tick_s=0.001, clock=Clock())
        session = Session("keyboard", scale=scale)
        Core(loop, components=session.components(loop)).begin()
        device = session.device
        assert device is not None
        assert f"scale {scale:g}" in session.driving(None).status()
        arm, seen = world.arm("PSM1"), []
        for keys in ([], [key]):
            device.receive(from_keys(keys))
            for _ in range(200):
                loop.tick()
            seen.append((arm.local.setpoint_cp().matrix, arm.joints.setpoints()[-1]))
        (A, shut), (B, now) = seen
        turned = angle_between(A[:3, :3], B[:3, :3])
        return np.array([np.linalg.norm(B[:3, 3] - A[:3, 3]), turned, now - shut])

    whole = changed(1.0)
    assert np.abs(whole).max() > 1e-3
    np.testing.assert_allclose(changed(0.5), 0.5 * whole, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("rig", ["psm", "full_cart_mtm"])
def test_where_clients_drive_the_page_has_the_pedals(rig: str) -> None:
    loop, session = Loop(World(rig), tick_s=0.001), Session()
    core = Core(loop, components=session.components(loop))
    transport = MemoryTransport(["footpedals/coag"])
    core.attach(transport)
    core.begin()
    driving = session.driving(None)
    assert driving.title == "Pedals" and not driving.tables
    assert core.topics["console/teleop/enable"].later == (rig == "psm")
    (coag,) = (pedal for pedal in driving.pedals if pedal.label == "Coag")
    for on in (True, False):
        coag.press(on)
        for _ in range(10):  # until the next sample
            loop.tick()
        core.publish_waiting()
        assert coag.pressed() is on
        assert transport.last("footpedals/coag")["buttons"] == [int(on)]


def test_masters_alone_are_dragged_for_a_console_elsewhere() -> None:
    """Nothing is served under console/teleop, which is the other console's."""
    loop, session = Loop(World("mtm"), tick_s=0.001, speed="max"), Session("masters")
    core = Core(loop, components=session.components(loop))
    core.begin()
    driving = session.driving(None)
    assert driving.handles == ("MTML", "MTMR")
    assert "Teleoperation on" not in [pedal.label for pedal in driving.pedals]
    assert core.topics["console/teleop/enable"].later
    goal = loop.world.reference_pose("MTMR") @ loop.world.arm("MTMR").local.measured_cp().matrix
    goal[:3, 3] += [0.0, 0.02, 0.0]
    assert driving.carry is not None
    driving.carry("MTMR", goal)
    for _ in range(600):
        loop.tick()
    here = loop.world.reference_pose("MTMR") @ loop.world.arm("MTMR").local.measured_cp().matrix
    np.testing.assert_allclose(here[:3, 3], goal[:3, 3], atol=2e-3)


def test_what_a_session_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="--arm, --scale: rig mtm has no instrument"):
        Session("masters", scale=0.5).components(Loop(World("mtm")))
    with pytest.raises(UnknownNameError, match="keyboard"):
        Session("piano")
    with pytest.raises(InputError, match="above 0 to 1"):
        Session("keyboard", scale=2.0)
    with pytest.raises(InputError, match="with --device masters"):
        Session("keyboard", motion="x.mcap")
    with pytest.raises(InputError, match=r"e.g. full_cart_mtm"):
        Session("masters").components(Loop(World("psm")))
    with pytest.raises(InputError, match=r"got 'ECM'; allowed: PSM1, PSM2, PSM3$"):
        Session("masters", "ECM").components(Loop(World("full_cart_mtm", setup_joints="locked")))


@pytest.mark.parametrize("name", ["gamepad", "spacemouse"])
def test_a_library_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr(devices, "find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match=rf"trocar\[{name}\]"):
        Session(name)


class FakeHid:
    """Stands for the library of HID devices, with one spacemouse plugged in."""

    def __init__(self) -> None:
        self.reports: list[bytes] = []
        self.plugged = self.open = True

    def enumerate(self, vendor: int, product: int) -> list[dict]:  # noqa: ARG002
        one = {"path": b"/dev/hidraw7", "product_id": 0xC635, "usage_page": 1, "usage": 8}
        return [one] if vendor == 0x256F and self.plugged else []

    def device(self) -> SimpleNamespace:
        def read(_size: int) -> list[int]:
            if not self.plugged:
                raise OSError("unplugged")
            return list(self.reports.pop(0)) if self.reports else []

        def open_path(_path: bytes) -> None:
            if not self.open:
                raise OSError("open failed")

        nothing = lambda *_: None  # noqa: E731
        return SimpleNamespace(
            open_path=open_path, set_nonblocking=nothing, read=read, close=nothing
        )


class Pauses(list):
    """Stands for the end of a thread: notes how long it pauses, and comes after so many."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self._count = count

    def wait(self, seconds: float) -> bool:
        self.append(seconds)
        return len(self) > self._count


def polled(source: Source, count: int) -> tuple[list[DeviceCommand], Pauses]:
    """Return what a device says in so many looks, and the pauses before each of them."""
    heard: list[DeviceCommand] = []
    pauses = Pauses(count)
    Poll(source, heard.append, pauses.wait).run()
    return heard, pauses


class Moody:
    """A device that does in turn as it is told: says something, is not there or cannot be read."""

    def __init__(self, *moods: DeviceCommand | OSError | None) -> None:
        self.moods, self.opened = list(moods), 0

    def open(self) -> None:
        self.opened += 1

    def poll(self) -> DeviceCommand | None:
        mood = self.moods.pop(0)
        if isinstance(mood, OSError):
            raise mood
        return mood

    def close(self) -> None:
        self.opened -= 1


def test_a_device_that_cannot_be_read_is_told_of_once_and_comes_back(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bad = OSError("no answer")
    source = Moody(STILL, bad, bad, bad, STILL, STILL)
    heard, _ = polled(source, 6)
    assert heard == [STILL] * 3
    assert len(caplog.records) == 1
    assert caplog.records[0].levelname == "WARNING"
    assert "no answer" in caplog.text
    assert source.opened == 0
    polled(Moody(bad, STILL, bad), 3)
    assert len(caplog.records) == 3  # it was well in between


def test_a_device_that_is_not_there_is_looked_for_less_often() -> None:
    bad = OSError("no answer")
    _, pauses = polled(Moody(STILL, STILL, None, None, bad, STILL, STILL), 7)
    often, seldom = devices.PERIOD_S, devices.RETRY_S
    assert pauses[1:] == [often, often, seldom, seldom, seldom, often, often]
    assert seldom > 10 * often


def test_a_spacemouse_that_cannot_be_opened_is_refused_and_one_that_comes_back_so_is_told_of(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    hid = FakeHid()
    monkeypatch.setattr(devices, "find_spec", lambda _: True)
    monkeypatch.setattr(devices, "import_module", lambda _: hid)
    spacemouse = SpaceMouse()
    hid.open = False
    heard, _ = polled(spacemouse, 3)
    assert not heard
    assert len(caplog.records) == 1
    assert "open failed" in caplog.text
    with pytest.raises(InputError, match=r"cannot be opened.*udev"):
        SpaceMouse()
    hid.open = True
    assert polled(spacemouse, 2)[0] == [from_spacemouse((0.0,) * 3, (0.0,) * 3, ())] * 2


def test_a_spacemouse_is_read_and_may_be_unplugged(monkeypatch: pytest.MonkeyPatch) -> None:
    hid = FakeHid()
    monkeypatch.setattr(devices, "find_spec", lambda _: True)
    monkeypatch.setattr(devices, "import_module", lambda _: hid)
    spacemouse = SpaceMouse()
    spacemouse.open()
    hid.reports = [b"\x01" + struct.pack("<3h", 350, 0, -350), b"\x03\x01"]
    drive = spacemouse.poll()
    assert drive is not None
    assert drive.move == (1.0, 1.0, 0.0)
    assert drive.grip == -1.0
    hid.plugged = False
    assert spacemouse.poll() is None
    hid.plugged = True
    again = spacemouse.poll()
    assert again is not None and not again.linear.any()
    hid.plugged = False
    with pytest.raises(InputError, match="none found"):
        SpaceMouse()


def _fail(_index: int) -> int:
    raise RuntimeError("just unplugged")


def test_a_gamepad_is_read_by_its_standard_names_and_may_be_unplugged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    there = [True]
    one = SimpleNamespace(
        attached=lambda: there[0],
        get_axis=lambda index: 32767 if index in (0, 5) else 0,
        get_button=lambda index: index == 1,
    )
    sdl = SimpleNamespace(
        init=lambda: None,
        quit=lambda: None,
        get_count=lambda: int(there[0]),
        is_controller=lambda _: True,
        Controller=lambda _: one,
    )
    nothing = SimpleNamespace(init=lambda: None, pump=lambda: None)
    library = SimpleNamespace(display=nothing, event=nothing, error=RuntimeError)
    monkeypatch.setattr(devices, "find_spec", lambda _: True)
    monkeypatch.setattr(devices, "import_module", lambda name: library if name == "pygame" else sdl)
    pad = devices.Gamepad()
    pad.open()
    drive = pad.poll()
    assert drive is not None
    assert drive.move == (1.0, 0.0, 1.0)
    assert drive.grip == 1.0
    one.get_axis = sdl.Controller = _fail
    with pytest.raises(OSError, match="just unplugged"):
        pad.poll()
    with pytest.raises(InputError, match=r"just unplugged.*reads gamepads in the browser"):
        devices.Gamepad()
    there[0] = False
    assert pad.poll() is None
    with pytest.raises(InputError, match="no gamepad found"):
        devices.Gamepad()
