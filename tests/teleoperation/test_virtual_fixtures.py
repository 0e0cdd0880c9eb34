"""Virtual fixtures act: as forces that a hand feels at a master, and as a filter of set-points."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from trocar.cli import main
from trocar.descriptions.fixtures import Fixture, Mode, Plane
from trocar.descriptions.teleops import TeleopDescription
from trocar.errors import DescriptionError
from trocar.live import Loop
from trocar.live.inbox import Command
from trocar.recording import record
from trocar.robot.follow import repeat
from trocar.simulation import World
from trocar.teleoperation import Teleoperation
from trocar.teleoperation.masters import VirtualMaster
from trocar.teleoperation.psm import PsmTeleoperation
from trocar.teleoperation.remote_master import RemoteMaster
from trocar.teleoperation.slave import view_in_world
from trocar.teleoperation.virtual_fixtures import Fixtures

RIG = Path(__file__).parents[2] / "examples" / "assistance" / "rig.toml"
STIFFNESS = 400.0


def plane(point: np.ndarray, normal: np.ndarray, mode: Mode, frame: str = "world") -> Fixture:
    stiffness = STIFFNESS if mode == "force" else 0.0
    region = Plane(np.asarray(point), np.asarray(normal))
    return Fixture("wall", "PSM1", mode, frame, region, stiffness, 5.0, "f.toml", "fixture[0]")


def tip(world: World) -> np.ndarray:
    return (world.reference_pose("PSM1") @ world.arm("PSM1").local.measured_cp().matrix)[:3, 3]


def following() -> tuple[World, Loop, PsmTeleoperation]:
    """Return a master that moves an instrument, its orientation locked."""
    world = World(RIG)
    loop = Loop(world, tick_s=0.001, speed="max")
    engine = Teleoperation(loop)
    engine.start()
    (component,) = engine.components.values()
    assert isinstance(component, PsmTeleoperation)
    component.set_align(False)
    component.lock_rotation(True)
    component.command("enable")
    run(loop, 0.01)
    assert component.following
    return world, loop, component


def run(loop: Loop, seconds: float) -> None:
    for _ in range(round(seconds / loop.tick_s)):
        loop.tick()


def test_a_master_pushes_the_hand_back_with_the_force_of_the_fixture() -> None:
    """The tip begins outside a wall: with no hand at it, the master moves until it is inside."""
    world, loop, component = following()
    arm, normal = world.arm("MTMR"), np.array([0.6, 0.0, 0.8])
    wall = tip(world) + 0.001 * normal
    component.fixtures = Fixtures(world, [plane(wall, normal, "force")])
    before = arm.measured_cp().matrix
    loop.tick()
    # Stiffness and distance count at the master: 400 N/m * 1 mm / 0.2.
    force = before[:3, :3] @ arm.body.measured_cf().force
    expected = view_in_world(world)[:3, :3].T @ (STIFFNESS * 0.001 / 0.2 * normal)
    np.testing.assert_allclose(force, expected, atol=0.02)  # the gimbal's lock exerts some of it
    run(loop, 0.3)
    moved = arm.measured_cp().matrix[:3, 3] - before[:3, 3]
    assert moved @ expected > 0.0
    assert normal @ (wall - tip(world)) < 3e-4


def test_a_locked_translation_exerts_no_force() -> None:
    world, loop, component = following()
    up = np.array([0.0, 0.0, 1.0])
    component.fixtures = Fixtures(world, [plane(tip(world) + 0.01 * up, up, "force")])
    loop.tick()
    assert np.linalg.norm(world.arm("MTMR").body.measured_cf().force) > 2.0
    component.lock_translation(True)
    run(loop, 0.002)
    assert np.linalg.norm(world.arm("MTMR").body.measured_cf().force) < 0.5


def test_a_filter_keeps_the_instrument_inside_wherever_the_hand_goes() -> None:
    world, loop, component = following()
    up = np.array([0.0, 0.0, 1.0])
    lowest = float(tip(world)[2]) - 0.001
    component.fixtures = Fixtures(world, [plane(np.array([0.0, 0.0, lowest]), up, "filter")])
    down = view_in_world(world)[:3, :3].T @ -up
    arm = world.arm("MTMR")
    run(loop, 0.01)
    arm.body.servo_cf([*(arm.measured_cp().matrix[:3, :3].T @ (4.0 * down)), 0.0, 0.0, 0.0])
    commanded, start = [], arm.measured_cp().matrix[:3, 3]
    for _ in range(300):
        loop.tick()
        commanded.append(
            world.reference_pose("PSM1") @ world.arm("PSM1").local.setpoint_cp().matrix
        )
    assert (arm.measured_cp().matrix[:3, 3] - start) @ down * component.scale > 0.002
    assert min(T[2, 3] for T in commanded) == pytest.approx(lowest, abs=1e-6)


def test_servo_cp_is_filtered_and_a_recording_repeats_it(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    world = World("psm")
    wall = plane(np.array([0.0, 0.0, -0.09]), np.array([0.0, 0.0, 1.0]), "filter", "PSM1")
    loop = Loop(world, tick_s=0.001, speed="max")
    loop.filter_command = Fixtures(world, [wall]).filter_command
    arm = world.arm("PSM1")
    # In the frame of measured_cp, which a client may have set anywhere.
    base = np.eye(4)
    base[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    base[:3, 3] = [0.1, 0.2, 0.3]
    arm.local.set_base_frame(base, "table")
    start = T = arm.measured_cp().matrix
    with record(world, tmp_path / "run.mcap"):
        for k in range(200):
            T = start.copy()
            T[:3, 3] += 1e-4 * k * np.array([0.5, 0.0, -1.0])
            loop.post(Command("PSM1", "servo_cp", {"T": T}))
            loop.tick()
    commanded = arm.local.setpoint_cp().matrix[:3, 3]
    assert start[2, 3] - 0.3 - 0.02 < -0.09  # it would have gone below
    assert commanded[2] == pytest.approx(-0.09, abs=1e-9)
    assert commanded[1] == pytest.approx((np.linalg.inv(base) @ T)[1, 3], abs=1e-9)
    assert repeat(tmp_path / "run.mcap").identical


def test_a_filter_passes_on_what_it_does_not_know() -> None:
    world = World("psm")
    wall = plane(np.array([0.0, 0.0, 10.0]), np.array([0.0, 0.0, 1.0]), "filter")
    fixtures = Fixtures(world, [wall])
    for command in (
        Command("PSM1", "servo_jp", {"q": np.zeros(6)}),
        Command("PSM1", "servo_cp", {"T": "no pose"}),
        Command("world", "reset"),
    ):
        assert fixtures.filter_command(command) is command


def test_a_fixture_moves_with_its_object() -> None:
    world = World("pegs")
    name, thing = next(iter(world.objects.items()))
    fixtures = Fixtures(world, [plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), "filter", name)])
    T = np.eye(4)
    T[:3, 3] = [0.1, 0.2, 0.5]
    thing.set_cp(T)
    np.testing.assert_allclose(fixtures.filtered("PSM1", np.zeros(3)), [0.0, 0.0, 0.5], atol=1e-12)


def test_a_master_on_topics_is_sent_the_force() -> None:
    """A real MTM gets the force as its wrench, once for each change."""
    master, sent = RemoteMaster("MTMR", lambda: 0.0), []
    master.publish = lambda topic, fields: sent.append((topic, dict(fields)))
    world = World("psm")
    for force in ([0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [0.0, 0.0, 0.0]):
        master.exert(world, np.array([*force, 0.0, 0.0, 0.1 * force[0]]))
    assert [topic for topic, _ in sent] == ["body/servo_cf"] * 2
    np.testing.assert_array_equal(sent[0][1]["wrench"], [1.0, 2.0, 3.0, 0.0, 0.0, 0.1])
    np.testing.assert_array_equal(sent[1][1]["wrench"], np.zeros(6))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"arm": "PSM7"}, "f.toml: fixture[0].arm: got 'PSM7'; allowed: PSM1"),
        ({"frame": "table"}, "fixture[0].frame: got 'table'; allowed: world, PSM1"),
    ],
)
def test_an_arm_or_a_frame_that_is_not_there_is_rejected(change, message: str) -> None:
    one = plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), "filter")
    with pytest.raises(DescriptionError, match=re.escape(message)):
        Fixtures(World("psm"), [Fixture(**{**vars(one), **change})])


def test_a_force_without_a_master_that_exerts_it_is_rejected() -> None:
    world = World("psm")
    loop = Loop(world)
    fixtures = Fixtures(world, [plane(np.zeros(3), np.array([0.0, 0.0, 1.0]), "force")])
    keys = VirtualMaster("KEYBOARD", lambda: 0.0)
    teleop = TeleopDescription("KEYBOARD_PSM1", "psm", ("KEYBOARD",), "PSM1")
    with pytest.raises(DescriptionError, match=re.escape("fixture[0].mode: got 'force', but no")):
        Teleoperation(loop, (teleop,), {"KEYBOARD": keys}, fixtures)


WALL = """schema = 1
[[fixture]]
kind = "plane"
arm = "PSM1"
mode = "{mode}"
point_mm = [0, 0, 100]
normal = [0, 0, 1]
"""
LIVE = ("--duration", "0.05", "--websocket-port", "0", "--no-cameras", "--no-page")


@pytest.mark.parametrize(
    ("words", "mode", "status"),
    [
        (("sim", "--rig", "psm", *LIVE), "filter", 0),
        (("sim", "--rig", "psm", *LIVE), 'force"\nstiffness_n_per_m = 300 #', 2),
        (("sim", "--rig", "psm", "--headless"), "filter", 2),
        (("sim", "--rig", "mtm", *LIVE), "filter", 2),
        (("teleop", "--rig", RIG, *LIVE), 'force"\nstiffness_n_per_m = 300 #', 0),
    ],
)
def test_the_command_line_takes_fixtures(
    tmp_path: Path,
    words: tuple[str | Path, ...],
    mode: str,
    status: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "wall.toml"
    file.write_text(WALL.replace("{mode}", mode))
    assert main([*map(str, words), "--fixture", str(file)]) == status
    errors = [e for e in capsys.readouterr().err.splitlines() if e.startswith("trocar: error")]
    assert len(errors) == (status != 0)
