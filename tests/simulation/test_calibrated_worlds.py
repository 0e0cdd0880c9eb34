"""Calibrated arms in motion: loops under load, remote centres that wander, recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.simulation.pitching import whole_pitch
from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.overlay import Overlay, write_overlay
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import LogError
from trocar.kinematics.forward import coordinates
from trocar.recording import record
from trocar.robot.follow import repeat
from trocar.simulation import World
from trocar.simulation.health import arm_health, remote_centre_error, remote_centre_wander

#: Source: the goals that `trocar bench` prints beside its figures.
GAP_M = 0.1e-6
RCM_M = 3e-6
GRIPPER = Path(__file__).parents[2] / "examples" / "mechanisms" / "four_bar_gripper.toml"


@pytest.mark.parametrize(("rig", "name"), [("psm", "PSM1"), ("ecm", "ECM")])
@pytest.mark.parametrize("kind", ["parallel_overlay", "skew_overlay"])
def test_loops_of_a_calibrated_arm_hold_under_ten_newtons_over_the_whole_pitch(
    rig, name, kind, request, rng
):
    overlay = request.getfixturevalue(kind)(rig, rng)
    world = World(rig, calibration=overlay, tip_load_n=10.0)
    q, v = whole_pitch(world, name, 4.0)
    world.set_state(name, q[0], v[0])
    played = world.play({name: q}, {name: v}, every=1)
    arm = world.rig.arm(name).arm
    health = arm_health(arm, played.coordinates[name])
    assert health.loop_gap_m <= GAP_M
    assert health.branch_ok
    ideal = coordinates(arm.mechanism, played.positions[name])
    loaded, own = (remote_centre_error(arm.mechanism, c) for c in (played.coordinates[name], ideal))
    assert loaded is not None and own is not None
    assert np.abs(loaded - own).max() <= RCM_M  # what the load adds to the geometry's own


def test_health_tells_how_far_a_robots_own_geometry_takes_it_from_its_remote_centre(
    skew_overlay, parallel_overlay, rng
):
    assert remote_centre_wander(load_arm("psm").mechanism) < 1e-12
    assert World("psm").health().rcm_wander_m < 1e-12
    parallel = World("psm", calibration=parallel_overlay("psm", rng))
    assert parallel.health().rcm_wander_m < 1e-9
    skew = World("psm", calibration=skew_overlay("psm", rng))
    health = skew.health()
    assert 1e-4 < health.rcm_error_m <= health.rcm_wander_m < 0.05
    assert health.per_arm["PSM1"].rcm_wander_m == health.rcm_wander_m
    assert remote_centre_wander(load_arm("suj_psm1").mechanism) == 0.0


def test_the_same_calibration_gives_the_same_motion_to_the_last_bit(skew_overlay, rng):
    overlay = skew_overlay("psm", rng)

    def state() -> bytes:
        world = World("psm", calibration=overlay, tip_load_n=5.0)
        world.arm("PSM1").move_jp([0.3, 0.4, 0.1, 0.0, 0.2, 0.1])
        world.step(300)
        return world.save().row.tobytes()

    assert state() == state()


def test_an_empty_overlay_moves_as_the_nominal_arm_to_the_last_bit():
    states = []
    for calibration in (None, Overlay("psm")):
        world = World("psm", calibration=calibration)
        world.arm("PSM1").move_jp([0.3, 0.4, 0.1, 0.0, 0.2, 0.1])
        world.step(300)
        states.append(world.save().row.tobytes())
    assert states[0] == states[1]


def test_measured_poses_are_those_of_the_calibrated_kinematics(skew_overlay, rng):
    world = World("psm", calibration=skew_overlay("psm", rng))
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.array([0.4, 0.5, 0.1, 0.3, 0.2, 0.1, 0.3]))
    body = world.snapshot()
    index = arm.runtime.motors.index.bodies["wrist_yaw"]
    expected = world.reference_pose("PSM1") @ arm.local.measured_cp().matrix
    assert np.abs(body.positions[index] - expected[:3, 3]).max() < 1e-9


def test_a_recording_keeps_the_calibration_when_its_file_is_gone(tmp_path, skew_overlay, rng):
    pytest.importorskip("mcap")
    file = tmp_path / "o.toml"
    write_overlay(file, skew_overlay("psm", rng))
    world = World("two_psm_ecm", calibration=[f"PSM2={file}"])
    with record(world, tmp_path / "run.mcap"):
        world.arm("PSM2").move_jp([0.2, 0.3, 0.1, 0.0, 0.1, 0.1])
        world.step(200)
        world.exchange_tool("PSM2", "PROGRASP_FORCEPS:420093")
        world.step(50)
    file.unlink()
    report = repeat(tmp_path / "run.mcap")
    assert report.identical
    assert report.periods == 251
    strange = load_rig("two_psm_ecm", {"PSM1": skew_overlay("psm", rng)})
    with pytest.raises(LogError, match="its motion cannot be repeated"):
        repeat(tmp_path / "run.mcap", strange)


def test_a_four_bar_gripper_with_four_different_sides_simulates():
    arm = load_arm(GRIPPER)
    world = World(lone_arm_rig(arm))
    gripper = world.arm("FOUR_BAR_GRIPPER")
    for goal in (arm.mechanism.upper, arm.mechanism.lower):
        motion = gripper.move_jp(goal)
        worst = 0.0
        while not motion.done:
            world.step(10)
            worst = max(worst, world.health().loop_gap_m)
            assert world.health().branch_ok
        assert worst < GAP_M
        world.step(300)
        assert gripper.measured_js().position == pytest.approx(goal, abs=1e-2)
