"""Poses beyond the joints' limits: what is commanded slides along them, as on the robot.

robot_walks.csv was recorded by us from sawIntuitiveResearchKit 9e535e6 in its kinematic
simulation: poses streamed out of the range and back, and the set-points 40 ms after each. Those
that had not changed by then are left out.
"""

from __future__ import annotations

import csv
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.errors import RejectedError
from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform
from trocar.simulation import World
from trocar.simulation.arm import Arm
from trocar.simulation.journal import Entry

Array = NDArray[np.float64]

WALKS = Path(__file__).with_name("robot_walks.csv")
HOME = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
#: How near joints are to the robot's [rad or m].
SAME = 1e-3


@pytest.fixture
def world() -> World:
    world = World("psm")
    world.set_state("PSM1", np.append(HOME, 0.0))
    return world


@pytest.fixture
def arm(world) -> Arm:
    return world.arm("PSM1")


def shifted(T: Array, *by: float) -> Array:
    return transform(T[:3, :3], T[:3, 3] + by)


def turned(T: Array, axis: int, degrees: float) -> Array:
    turn = np.radians(degrees) * np.eye(3)[axis]
    return transform(T[:3, :3] @ matrix_from_rotation_vector(turn), T[:3, 3])


def stream(world: World, arm: Arm, poses: list[Array]) -> list[Array]:
    """Command poses at 100 Hz; return the set-points after each."""
    found: list[Array] = []
    for T in poses:
        assert arm.servo_cp(T), arm.rejections.last
        world.step(10)
        found.append(arm.setpoint_jp())
    assert arm.operating_state().state == "ENABLED"
    return found


@pytest.fixture
def events(world) -> list[tuple[str, object]]:
    """The arm's ends of moves and errors, as they come."""
    found: list[tuple[str, object]] = []

    def listen(entry: Entry) -> None:
        if entry.kind == "event" and entry.name in ("goal_reached", "error"):
            found.append((entry.name, *entry.values.values()))

    world.listen(listen)
    return found


def test_a_stream_past_the_end_of_the_insertion_slides_sideways(world, arm):
    """Source: recorded; yaw 0.5294, wrist yaw -0.5294, no message, ENABLED."""
    here = arm.setpoint_cp().matrix
    down = [shifted(here, 0.0, 0.0, -0.001 * k) for k in range(1, 161)]
    aside = [shifted(down[-1], 0.001 * k, 0.0, 0.0) for k in range(1, 161)]
    assert stream(world, arm, down)[-1] == pytest.approx([0, 0, 0.24, 0, 0, 0], abs=SAME)
    q = stream(world, arm, aside)
    assert q[-1] == pytest.approx([0.5294, 0, 0.24, 0, 0, -0.5294], abs=SAME)
    assert np.abs(np.diff(q, axis=0)).max() < 0.01


def test_a_stream_into_the_cannula_stops_outside_and_comes_back_the_same_way(world, arm):
    """Source: recorded; nearest 0.0606, back at 0.12."""
    here = arm.setpoint_cp().matrix
    out = [shifted(here, 0.0, 0.0, 0.001 * k) for k in range(91)]
    q = np.array(stream(world, arm, out + out[::-1]))
    assert q[:, 2].min() == pytest.approx(0.0606, abs=1e-6)
    assert q[-1] == pytest.approx(HOME, abs=SAME)


def test_a_wrist_turned_past_its_limit_stays_there_and_comes_back(world, arm):
    """Source: recorded; 1 deg steps to 120 deg hold -1.39626."""
    here = arm.setpoint_cp().matrix
    there = [turned(here, 0, k) for k in range(121)]
    assert stream(world, arm, there)[-1] == pytest.approx([0, 0, 0.12, 0, 0, -1.39626], abs=SAME)
    assert stream(world, arm, there[::-1])[-1] == pytest.approx(HOME, abs=SAME)


def test_a_roll_turned_past_its_limit_holds_for_half_a_turn_more(world, arm):
    """C12, recorded: 4.53786 until 440 deg, then it jumps by half a turn into FAULT."""
    here = arm.setpoint_cp().matrix
    q = stream(world, arm, [turned(here, 2, k) for k in range(441)])
    assert q[250][3] == pytest.approx(np.radians(250), abs=SAME)
    assert np.array(q[261:])[:, 3] == pytest.approx(4.53786, abs=SAME)
    for k in (441, 442, 443):
        arm.servo_cp(turned(here, 2, k))
        world.step(20)
    assert arm.operating_state().state == "FAULT"


def test_relative_steps_slide_along_limits_too(world, arm):
    for _ in range(150):
        assert arm.servo_cr(transform(np.eye(3), [0.0, 0.0, -0.001]))
        world.step(10)
    assert arm.setpoint_jp()[2] == pytest.approx(0.24, abs=1e-6)
    for _ in range(40):
        assert arm.servo_cr(transform(np.eye(3), [0.001, 0.0, 0.0]))
        world.step(10)
    assert arm.setpoint_jp()[0] > 0.1


def walks() -> list[tuple[str, str, list[dict[str, str]]]]:
    with WALKS.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    starts = np.cumsum([row["state"] == "start" for row in rows]).tolist()
    found: list[tuple[str, str, list[dict[str, str]]]] = []
    for _, group in groupby(zip(starts, rows, strict=True), key=lambda pair: pair[0]):
        walk = [row for _, row in group]
        found.append((walk[0]["rig"], walk[0]["arm"], walk))
    return found


def numbers(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)


@pytest.mark.parametrize("walk", range(len(walks())))
def test_poses_streamed_out_of_the_range_and_back_lead_to_the_robots_joints(walk: int) -> None:
    rig, name, rows = walks()[walk]
    world = World(rig)
    arm = world.arm(name)
    arm.local.set_base_frame(np.eye(4))
    start, whole = numbers(rows[0]["joints"]), arm.joints.setpoints()
    whole[: len(start)] = start
    world.set_state(name, whole)
    compared = 0
    for row in rows[1:]:
        x, y, z, w = (values := numbers(row["pose"]))[3:] / np.linalg.norm(values[3:])
        arm.servo_cp(transform(matrix_from_quaternion(np.array([w, x, y, z])), values[:3]))
        world.step(50)
        assert arm.operating_state().state == row["state"]
        if row["joints"]:
            compared += 1
            assert arm.setpoint_jp() == pytest.approx(numbers(row["joints"]), abs=SAME)
    assert compared > 40


@pytest.mark.parametrize(
    ("by", "turn", "goal"),
    [
        ([0.0, 0.0, -0.3], 0.0, [0, 0, 0.24, 0, 0, 0]),  # C4
        ([0.0, 0.0, 0.0], 170.0, [0, 0, 0.12, 2.96706, 0, 0]),  # C14
    ],
)
def test_move_cp_goes_to_the_clipped_pose_and_reaches_its_goal(arm, events, by, turn, goal):
    motion = arm.move_cp(turned(shifted(arm.setpoint_cp().matrix, *by), 2, turn))
    assert motion.wait(10.0)
    assert arm.setpoint_jp() == pytest.approx(goal, abs=SAME)
    assert events == [("goal_reached", True)]


def test_a_roll_moved_on_past_its_limit_stops_there(arm):
    """C14, recorded: 170, 190 and 300 deg end at 2.96706, 3.316126 and 4.53786."""
    here = arm.setpoint_cp().matrix
    for degrees, roll in ((170, 2.96706), (190, 3.316126), (300, 4.53786)):
        assert arm.move_cp(turned(here, 2, degrees)).wait(10.0)
        assert arm.setpoint_jp()[3] == pytest.approx(roll, abs=SAME)


def test_a_goal_on_another_branch_is_taken_as_on_the_robot(arm):
    """C3, recorded on its way: yaw -1.498, insertion 0.011 after 2 s, both at their limit then."""
    arm.move_jp([0, 0, 0.12, 0, 0, -0.6]).wait()
    motion = arm.move_cp(shifted(arm.local.forward_kinematics(HOME).matrix, 1.0, 0.0, 0.0))
    assert motion.goal == pytest.approx([-1.588, 0, 0, 0, 0, 1.39626], abs=SAME)


def test_a_turn_to_the_other_side_stays_and_is_said_to_be_missed(arm):
    """C6, recorded: goal_reached true, the arm does not move."""
    motion = arm.move_cp(turned(arm.setpoint_cp().matrix, 0, 180))
    assert motion.wait(1.0)
    assert arm.setpoint_jp() == pytest.approx(HOME, abs=SAME)
    assert "missed by 0.00 mm and 180.00 deg" in arm.rejections.last


def test_a_pose_without_a_solution_is_an_error_and_the_goal_is_not_reached(arm, events):
    """C5, recorded: error "unable to solve inverse kinematics", goal_reached false."""
    here = arm.setpoint_cp().matrix
    motion = arm.move_cp(transform(here[:3, :3], [0.0, 0.0, -0.005]))
    assert motion.done
    assert not motion.goal_reached
    (error, text), ended = events
    assert error == "error"
    assert "unable to solve inverse kinematics" in text
    assert ended == ("goal_reached", False)
    assert arm.setpoint_jp() == pytest.approx(HOME)


@pytest.mark.parametrize("way", ["down", "wrist"])
def test_jumps_out_of_reach_are_clipped_and_end_in_fault(world, arm, way):
    """C9 to C11, recorded: clipped set-points, then a tracking error."""
    here = arm.setpoint_cp().matrix
    there, goal = {
        "down": (shifted(here, 0.0, 0.0, -0.3), [0, 0, 0.24, 0, 0, 0]),
        "wrist": (turned(here, 0, 120), [0, 0, 0.12, 0, 0, -1.39626]),
    }[way]
    assert arm.servo_cp(there)
    assert arm.setpoint_jp() == pytest.approx(goal, abs=SAME)
    world.step(50)
    assert arm.operating_state().state == "FAULT"


def test_in_the_cannula_cartesian_commands_are_rejected(world, arm, events):
    """C19, recorded: a warning, nothing moves."""
    world.set_state("PSM1", np.array([0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.0]))
    here = arm.setpoint_cp().matrix
    assert not arm.servo_cp(here)
    assert "insert the instrument" in arm.rejections.last
    motion = arm.move_cp(shifted(here, 0.0, 0.0, -0.05))
    assert motion.done
    assert not motion.goal_reached
    assert events == [("goal_reached", False)]


def test_in_the_cannula_a_move_cp_after_a_move_is_made_with_a_warning(arm, events):
    """C20, recorded: goal_reached true; after a servo_jp or a homing the robot would hang."""
    assert arm.move_jp([0.0, 0.0, 0.03, 0.0, 0.0, 0.0]).wait(5.0)
    here = arm.setpoint_cp().matrix
    assert not arm.servo_cp(here)
    assert arm.move_cp(shifted(here, 0.0, 0.0, -0.05)).wait(5.0)
    assert "past the remote centre" in arm.rejections.last
    assert arm.setpoint_jp() == pytest.approx([0.0, 0.0, 0.08, 0.0, 0.0, 0.0], abs=SAME)
    assert arm.move_jp([0.0, 0.0, 0.03, 0.0, 0.0, 0.0]).wait(5.0)
    assert arm.servo_jp(arm.setpoint_jp())
    assert arm.move_cp(shifted(here, 0.0, 0.0, -0.05)).done
    assert events == [("goal_reached", reached) for reached in (True, True, True, False)]


def test_in_the_cannula_commands_of_the_tip_go_on_until_one_of_the_joints(world, arm):
    """Recorded, walk-poses 4.08: where the arm is in Cartesian space its depth is not looked at."""
    here = arm.setpoint_cp().matrix
    assert arm.move_cp(transform(here[:3, :3], [0.0, 0.0, 0.2])).wait(5.0)  # behind the centre
    assert arm.setpoint_jp()[2] < 0.05
    behind = arm.setpoint_cp().matrix
    saved = world.save()
    for _ in range(2):
        assert arm.servo_cp(behind)
        assert arm.jaw.servo_jp([0.1])
        assert arm.servo_cp(behind)
        assert arm.servo_jp(arm.setpoint_jp())
        assert not arm.servo_cp(behind)
        world.load(saved)


def test_one_warning_says_by_how_much_a_goal_is_missed(arm):
    here = arm.setpoint_cp().matrix
    arm.move_cp(shifted(here, 0.0, 0.0, -0.13))
    assert arm.rejections.count == 1
    assert arm.rejections.last == (
        "move_cp: the goal is missed by 10.00 mm and 0.00 deg; insertion beyond the limit"
    )


def test_the_warning_says_that_the_wrist_stays_off_the_remote_centre(arm):
    here = arm.setpoint_cp().matrix
    arm.move_cp(shifted(here, 0.0, 0.0, 0.07))
    assert arm.rejections.last.endswith("; the wrist stays 45 mm past the remote centre")


def test_the_warning_says_that_the_insertion_of_an_endoscope_stays():
    world = World("ecm")
    world.set_state("ECM", np.array([0.0, 0.0, 0.05, 0.0]))
    arm = world.arm("ECM")
    here = arm.setpoint_cp().matrix
    arm.move_cp(transform(here[:3, :3], here[:3, 3] - 0.02 * here[:3, 2]))
    assert arm.rejections.last.endswith("; the insertion stays at 40 mm")


def test_strict_limits_reject_a_pose_beyond_a_limit(arm, events):
    arm.joints.use_strict_limits(True)
    here = arm.setpoint_cp().matrix
    beyond = shifted(here, 0.0, 0.0, -0.13)
    assert not arm.servo_cp(beyond)
    motion = arm.move_cp(beyond)
    assert motion.done
    assert not motion.goal_reached
    assert "missed by 10.00 mm" in motion.reason
    assert events == [("goal_reached", False)]
    assert arm.setpoint_jp() == pytest.approx(HOME)
    assert arm.move_cp(shifted(here, 0.0, 0.0, -0.1)).wait(10.0)


@pytest.mark.parametrize("verb", ["servo_cp", "move_cp"])
def test_a_world_that_raises_rejects_a_pose_beyond_a_limit(verb):
    arm = World("psm", on_reject="raise").arm("PSM1")
    with pytest.raises(RejectedError, match="missed by"):
        getattr(arm, verb)(shifted(arm.setpoint_cp().matrix, 0.0, 0.0, -0.2))


def test_inverse_kinematics_is_in_the_arms_own_frame_or_in_one_by_name():
    """Source: mtsIntuitiveResearchKitArm.cpp:2337, 9e535e6."""
    arm = World("full_cart").arm("PSM1")
    q = [0.2, -0.1, 0.15, 0.3, 0.2, -0.1]
    public, own = arm.forward_kinematics(q), arm.local.forward_kinematics(q)
    assert np.abs(public.matrix - own.matrix).max() > 0.1
    assert arm.inverse_kinematics(own.matrix, q) == pytest.approx(q, abs=1e-8)
    assert arm.inverse_kinematics(public.matrix, q, frame=public.frame_id) == pytest.approx(
        q, abs=1e-8
    )
    world = arm.measured_cp("world").matrix @ inverse(arm.local.measured_cp().matrix)
    assert arm.inverse_kinematics(world @ own.matrix, q, frame="world") == pytest.approx(
        q, abs=1e-6
    )


def test_inverse_kinematics_goes_beyond_limits(arm):
    deeper = shifted(arm.setpoint_cp().matrix, 0.0, 0.0, -0.3)
    assert arm.inverse_kinematics(deeper) == pytest.approx([0, 0, 0.42, 0, 0, 0], abs=1e-6)


def test_a_skew_arm_slides_along_its_limit(skew_overlay):
    world = World("psm", calibration=skew_overlay("psm", np.random.default_rng(1)))
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.append(HOME, 0.0))
    here = arm.setpoint_cp().matrix
    down = [shifted(here, 0.0, 0.0, -0.001 * k) for k in range(1, 141)]
    aside = [shifted(down[-1], 0.001 * k, 0.0, 0.0) for k in range(1, 41)]
    q = np.array(stream(world, arm, down + aside + aside[::-1] + down[::-1]))
    assert q[139, 2] == pytest.approx(0.24)
    assert q[179, 0] > q[139, 0] + 0.1
    assert q[-1] == pytest.approx(q[0], abs=1e-6)
