"""Errors of robots: what arms report, where they are, and how the two differ."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from trocar import Batch, World, load_rig
from trocar.descriptions import RigDescription
from trocar.descriptions.robot_errors import JointErrors, JointRow, RobotErrors, robot_errors
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.modeling import naming
from trocar.simulation.readout import Reader

Array = NDArray[np.float64]

GOAL = [0.3, 0.2, 0.14, 0.4, -0.3, 0.2]


def with_errors(errors: RobotErrors | None, rig: str = "psm") -> RigDescription:
    return replace(load_rig(rig), errors=errors)


def of_joints(*joints: str, latency: float = 0.0, **sizes: float) -> RobotErrors:
    return RobotErrors("test", (JointRow(("PSM",), joints, JointErrors(**sizes)),), latency=latency)


def moved(world: World, steps: int = 400) -> World:
    world.arm("PSM1").servo_jp(GOAL)
    world.step(steps)
    return world


def row(world: World) -> Array:
    return world.save().row


def test_perfect_moves_bit_for_bit_as_no_errors_do() -> None:
    plain, perfect = moved(World("psm")), moved(World("psm", errors="perfect"))
    assert np.array_equal(row(plain), row(perfect))
    assert perfect.signature == plain.signature
    arm, true = perfect.arm("PSM1"), perfect.true_state("PSM1")
    np.testing.assert_allclose(arm.joints.readings(), [true.q, true.qd, true.effort], atol=1e-15)
    np.testing.assert_allclose(arm.measured_cp().matrix, true.cp.matrix, atol=1e-15)


def test_a_rigs_own_errors_are_overridden_by_name() -> None:
    rig = with_errors(robot_errors("lab"))
    assert World(rig).errors == robot_errors("lab")
    assert World(rig, errors="perfect").errors is None


def test_encoders_read_whole_steps() -> None:
    world = moved(World("psm", errors="lab", seed=1), 123)
    steps = np.array([7.72e-6, 7.72e-6, 1.30e-6, *4 * [1.34e-4]])
    counts = world.arm("PSM1").joints.readings()[0] / steps
    assert np.abs(counts - counts.round()).max() < 1e-6
    true = world.true_state("PSM1").q / steps
    assert np.abs(true - true.round()).max() > 1e-3


def test_a_seed_determines_the_errors_and_another_one_gives_others() -> None:
    first, again, other = (moved(World("psm", errors="lab", seed=s)) for s in (4, 4, 5))
    assert np.array_equal(row(first), row(again))
    assert np.array_equal(first.arm("PSM1").joints.readings(), again.arm("PSM1").joints.readings())
    assert np.abs(first.true_state("PSM1").q - other.true_state("PSM1").q).max() > 1e-3
    other.reset(4)
    assert np.array_equal(row(moved(other)), row(first))


def test_motion_does_not_depend_on_how_steps_are_divided() -> None:
    whole, parts = World("psm", errors="lab"), World("psm", errors="lab")
    moved(whole, 300)
    moved(parts, 7)
    for count in (1, 2, 90, 200):
        parts.step(count)
    assert np.array_equal(row(whole), row(parts))
    assert np.array_equal(whole.arm("PSM1").joints.readings(), parts.arm("PSM1").joints.readings())


def test_a_saved_state_goes_on_to_the_last_bit() -> None:
    first = moved(World("two_psm_ecm", errors="wide", seed=2), 133)
    second = World("two_psm_ecm", errors="wide", seed=9)
    second.load(first.save())
    for world in (first, second):
        world.arm("PSM1").servo_jp([0.1, -0.1, 0.1, 0.0, 0.0, 0.0])
        world.step(200)
    assert np.array_equal(row(first), row(second))
    for name in first.arms:
        assert np.array_equal(
            first.arm(name).measured_cp().matrix, second.arm(name).measured_cp().matrix
        )
        assert np.array_equal(first.true_state(name).world, second.true_state(name).world)


def test_a_state_of_other_errors_is_rejected() -> None:
    with pytest.raises(InputError, match="errors lab"):
        World("psm").load(World("psm", errors="lab").save())


@pytest.mark.parametrize("hysteresis", [0.0, 0.004])
def test_a_reversal_loses_backlash_and_hysteresis(hysteresis: float) -> None:
    sizes = {"backlash": 0.01, "hysteresis": hysteresis, "travel": 0.05}
    world = World(with_errors(of_joints("yaw", **sizes)), collisions=False)
    arm, yaw = world.arm("PSM1"), np.zeros(6)
    yaw[2] = 0.12
    lost: dict[float, list[float]] = {}
    for sign in (1.0, -1.0, 1.0):
        for angle in sign * np.linspace(-0.3, 0.3, 61):
            yaw[0] = angle
            arm.servo_jp(yaw)
            world.step(40)
            if abs(angle) < 1e-9:
                world.step(400)
                lost.setdefault(sign, []).append(
                    arm.joints.readings()[0][0] - world.true_state("PSM1").q[0]
                )
    width = lost[1.0][-1] - lost[-1.0][-1]
    assert width == pytest.approx(0.01 + hysteresis, rel=1e-6)


def test_cables_stretch_with_the_load() -> None:
    world = World(with_errors(of_joints("pitch", compliance=0.004)), dynamics="cad")
    world.step(3000)
    arm, true = world.arm("PSM1"), world.true_state("PSM1")
    assert abs(true.effort[1]) > 0.1
    stretch = (arm.joints.readings()[0] - true.q)[1]
    assert stretch == pytest.approx(0.004 * true.effort[1], rel=1e-3)


def test_late_readings_are_those_of_before() -> None:
    plain, late = World("psm"), World(with_errors(of_joints(latency=0.02)))
    for world in (plain, late):
        moved(world, 80)
    before = plain.arm("PSM1").joints.readings()[:2], plain.arm("PSM1").measured_cp().matrix
    for world in (plain, late):
        world.step(20)
    assert np.array_equal(row(plain), row(late))
    np.testing.assert_allclose(late.arm("PSM1").joints.readings()[:2], before[0], atol=1e-15)
    np.testing.assert_allclose(late.arm("PSM1").measured_cp().matrix, before[1], atol=1e-15)
    assert np.array_equal(late.true_state("PSM1").q, plain.true_state("PSM1").q)


def test_a_registration_moves_the_reported_cameras_frame() -> None:
    world = World(with_errors(RobotErrors("test", registration=(0.002, 0.01)), "two_psm_ecm"))
    changes = []
    for pose in ("start", "work"):
        world.reset(pose=pose)
        arm = world.arm("PSM1")
        changes.append(arm.measured_cp().matrix @ np.linalg.inv(world.true_state("PSM1").cp.matrix))
    np.testing.assert_allclose(changes[0], changes[1], atol=1e-12)
    assert 1e-4 < np.linalg.norm(changes[0][:3, 3]) < 0.01


def test_a_commanded_pose_is_reached_as_it_is_reported() -> None:
    world = World("two_psm_ecm", errors="lab", seed=3, collisions=False)
    world.reset(pose="work")
    arm = world.arm("PSM1")
    goal = arm.measured_cp().matrix
    goal[:3, 3] += [0.005, -0.004, 0.003]
    arm.servo_cp(goal)
    world.step(1500)
    reported, true = arm.measured_cp().matrix, world.true_state("PSM1").cp.matrix
    assert np.linalg.norm(reported[:3, 3] - goal[:3, 3]) < 3e-4
    assert np.linalg.norm(true[:3, 3] - goal[:3, 3]) > 1e-3


def test_setup_joints_that_read_wrong_move_the_reported_base() -> None:
    errors = RobotErrors("test", (JointRow(("SUJ",), (), JointErrors(offset=0.01)),))
    world = World(with_errors(errors, "suj_two_psm_ecm"))
    lost = world.arm("PSM1").measured_cp().matrix[:3, 3] - world.true_state("PSM1").cp.matrix[:3, 3]
    assert 1e-3 < np.linalg.norm(lost) < 0.1
    assert np.array_equal(world.arm("PSM1").joints.readings()[0], world.true_state("PSM1").q)


def test_every_reading_agrees_with_the_verbs() -> None:
    world = moved(World("two_psm_ecm", errors="lab", seed=6), 250)
    read = Reader(world.model).read(world.sample())
    shown = world.snapshot()
    for row_, name in enumerate(world.arms):
        arm = world.arm(name)
        np.testing.assert_allclose(
            read.bases[row_] @ read.measured[row_], arm.measured_cp().matrix, atol=1e-12
        )
        assert np.array_equal(shown.arms[name].q, arm.joints.readings()[0])
        assert np.array_equal(
            arm.measured_js().position, arm.joints.readings()[0][: arm.description.own_joints]
        )


def test_pictures_show_the_truth() -> None:
    world = moved(World("psm", errors="wide", seed=1), 1000)
    shown = mujoco.MjData(world.mj_model)
    shown.qpos[:] = world.mj_data.qpos
    mujoco.mj_kinematics(world.mj_model, shown)
    np.testing.assert_allclose(world.snapshot().positions, shown.xpos, atol=1e-15)
    tip = world.true_state("PSM1").world[:3, 3]
    at = world.mj_model.site(naming.frame_site("PSM1", "tip")).id
    mujoco.mj_kinematics(world.mj_model, shown)
    assert np.linalg.norm(tip - shown.site_xpos[at]) < 2e-6
    assert np.linalg.norm(tip - world.arm("PSM1").measured_cp("world").matrix[:3, 3]) > 1e-3


def test_an_exchanged_tool_leaves_the_errors_of_other_joints() -> None:
    world = moved(World("two_psm_ecm", errors="lab", seed=8))
    before = {
        name: world.arm(name).joints.readings()[0] - world.true_state(name).q for name in world.arms
    }
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    for name in ("PSM2", "ECM"):
        now = world.arm(name).joints.readings()[0] - world.true_state(name).q
        np.testing.assert_allclose(now, before[name], atol=2.7e-4)
    world.step(100)


def test_a_lone_arm_with_errors_takes_another_tool() -> None:
    world = World("psm", errors="lab")
    world.exchange_tool("PSM1", "none")
    world.step(100)
    world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
    world.step(100)


@pytest.mark.parametrize("calibration", [None, "psm"])
def test_worlds_of_a_batch_have_the_errors_that_worlds_have(calibration: str | None) -> None:
    first, world = (
        World("two_psm_ecm", errors="lab", seed=3, collisions=False, calibration=calibration)
        for _ in range(2)
    )
    batch = Batch(first, 2, threads=1)
    world.load(first.save())
    rest = batch.setpoints
    for size in (0.1, -0.05):
        goal = np.clip(rest[0] + 0.1 * size, world.joints.lower, world.joints.upper)
        readings = batch.step(np.stack([goal, rest[1]]), n=57)
        for arm in world.arms.values():
            own = goal[arm.runtime.motors.index.rows]
            arm.servo_jp(own[: arm.description.own_joints])
            if arm.jaw is not None:
                arm.jaw.servo_jp(own[arm.description.own_joints :])
        world.step(57)
    assert np.array_equal(batch.rows[0], row(world))
    assert not np.array_equal(batch.rows[0], batch.rows[1])
    found = np.concatenate([arm.joints.readings()[0] for arm in world.arms.values()])
    np.testing.assert_allclose(readings.q[0], found, atol=1e-15)
    tip = world.arm("PSM1").measured_cp().matrix
    np.testing.assert_allclose(readings.tips["PSM1"][0], tip, atol=1e-12)
    assert np.abs(tip - world.true_state("PSM1").cp.matrix).max() > 1e-4


def test_unknown_errors_list_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="perfect, lab, wide"):
        World("psm", errors="labb")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('errors = "labb"', "errors.*labb.*perfect, lab, wide"),
        ("[errors]\nlatency_ms = -1", "latency.*allowed: 0 to 1 s"),
        ("[errors]\nlatency = 1", "unknown key.*latency_ms"),
        ("[errors]\nregistration_mm = -1", "registration.*allowed: 0 or more"),
        ("[[errors.joint]]\noffset_rad_m = -1", "offset.*allowed: 0 or more"),
        ("[[errors.joint]]\nhysteresis_deg = 1", "travel.*allowed: more than 0"),
        ('[[errors.joint]]\narms = ["PSM9"]', "PSM9.*allowed"),
        ('[[errors.joint]]\narms = ["PSM"]\njoints = ["elbow"]', "elbow.*allowed.*yaw"),
        ("errors = 3", "got 3; allowed: a table"),
    ],
)
def test_wrong_errors_of_a_rig_are_named(tmp_path: Path, text: str, message: str) -> None:
    own = Path(load_rig("psm").file).read_text()
    head, _, tail = own.partition("[[arm]]")
    plain = text if text.startswith("errors") else ""
    block = "" if plain else text
    path = tmp_path / "rig.toml"
    path.write_text(f"{head}\n{plain}\n[[arm]]{tail}\n{block}\n")
    with pytest.raises(DescriptionError, match=message):
        load_rig(path)


def test_a_rig_builds_on_a_preset(tmp_path: Path) -> None:
    own = Path(load_rig("psm").file).read_text()
    path = tmp_path / "rig.toml"
    path.write_text(
        own + '\n[errors]\npreset = "lab"\nlatency_ms = 40\n'
        'joint = [{ arms = ["PSM1"], joints = ["yaw"], offset_deg = 1 }]\n'
    )
    errors, lab = load_rig(path).errors, robot_errors("lab")
    assert errors is not None and lab is not None
    assert errors.latency == pytest.approx(0.04)
    assert errors.of("PSM1", "PSM", "yaw").offset == pytest.approx(np.deg2rad(1.0))
    assert errors.of("PSM1", "PSM", "pitch") == lab.of("PSM1", "PSM", "pitch")
