"""The inverse kinematics of the robot's software, beside its own recorded answers.

robot_inverse.csv was recorded by us from sawIntuitiveResearchKit 9e535e6 in its kinematic
simulation, service inverse_kinematics: random goals in and beyond the limits, up to 3 rad away.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.errors import UnreachableError
from trocar.geometry.rotations import matrix_from_quaternion, matrix_from_rotation_vector
from trocar.geometry.se3 import pose_difference, transform
from trocar.kinematics import jacobian_spatial, pose
from trocar.kinematics.robot_inverse import robot_solution, screw_chain

Array = NDArray[np.float64]

RECORDED = Path(__file__).with_name("robot_inverse.csv")
HOME = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
#: Joints of a tip deep below the remote centre with the instrument turned over. [rad, m]
BEHIND = [np.pi, 0.0, -0.407, 0.0, 0.0, -np.pi]


def numbers(text: str) -> Array:
    return np.array(text.split(), dtype=np.float64)


def recorded_pose(text: str) -> Array:
    values = numbers(text)
    x, y, z, w = values[3:] / np.linalg.norm(values[3:])
    return transform(matrix_from_quaternion(np.array([w, x, y, z])), values[:3])


def reached(arm: str, T: Array, start: Array, measured: Array | None = None) -> Array:
    """Return `solved` where there is a solution."""
    found = solved(arm, T, start, measured)
    assert found is not None
    return found


def solved(arm: str, T: Array, start: Array, measured: Array | None = None) -> Array | None:
    described = load_arm(arm)
    measured = start if measured is None else measured
    try:
        return robot_solution(
            described.mechanism, described.inverse_kinematics, T, start, measured
        )[0]
    except UnreachableError:
        return None


@pytest.fixture(scope="module")
def home() -> Array:
    return pose(load_arm("psm").mechanism, np.append(HOME, 0.0))


@pytest.mark.parametrize(("arm", "least"), [("psm", 0.95), ("mtmr", 0.9), ("ecm", 1.0)])
def test_the_robot_answers_the_same(arm: str, least: float) -> None:
    """The rest are jumps whose damped steps wander; rounding of the DH table moves their end."""
    with RECORDED.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["arm"] == arm]
    same = 0
    for row in rows:
        found = solved(
            arm, recorded_pose(row["pose"]), numbers(row["seed"]), numbers(row["measured"])
        )
        if row["solved"] == "0":
            same += found is None
        else:
            same += found is not None and np.abs(found - numbers(row["joints"])).max() < 1e-3
    assert len(rows) >= 40
    assert same >= least * len(rows)


@pytest.mark.parametrize(
    ("step", "start", "by", "turn", "expected"),
    [
        ("C1", HOME, [0.03, 0, 0], [0, 0, 0], [0.258407, 0, 0.123898, 0, 0, -0.258407]),
        ("C2", HOME, [0, 0, 0], [0.6, 0, 0], [0, 0, 0.12, 0, 0, -0.6]),
        # Another branch, behind the remote centre.
        ("C3", [0, 0, 0.12, 0, 0, -0.6], [1, 0, 0], [0, 0, 0], [-1.683813, 0, -1, 0, 0, 1.683813]),
        ("C4", HOME, [0, 0, -0.3], [0, 0, 0], [0, 0, 0.42, 0, 0, 0]),
        # From where C3 ended: behind the remote centre, half turns on the side of rounded tables.
        ("C4", [-1.588, 0, 0, 0, 0, 1.39626], [0, 0, -0.3], [0, 0, 0], BEHIND),
        ("C4", [1.588, 0, 0, 0, 0, -1.39626], [0, 0, -0.3], [0, 0, 0], BEHIND),
        # Turned over: no rotation is nearer than another, so the search ends where it starts.
        ("C6", HOME, [0, 0, 0], [np.pi, 0, 0], HOME),
        ("C8", HOME, [0.05, 0, 0], [0, 0, 0], [0.414949, 0, 0.130525, 0, 0, -0.414949]),
        ("C9", HOME, [1, 0, 0], [0, 0, 0], [1.457776, 0, 1.012921, 0, 0, -1.457776]),
        ("C11", HOME, [0, 0, 0], [2.0944, 0, 0], [0, 0, 0.12, 0, 0, -2.0944]),
    ],
)
def test_single_goals_are_solved_as_on_the_robot(home, step, start, by, turn, expected) -> None:
    """Source: recorded steps of the dVRK's own software, in their order in its driver."""
    T = transform(home[:3, :3] @ matrix_from_rotation_vector(np.array(turn)), home[:3, 3] + by)
    found = solved("psm", T, np.array(start, dtype=np.float64))
    assert found == pytest.approx(expected, abs=1e-4), step


def test_a_wrist_at_the_remote_centre_has_no_solution(home) -> None:
    """C5: 5 mm from the remote centre, the robot's search does not converge."""
    assert solved("psm", transform(home[:3, :3], [0.0, 0.0, -0.005]), HOME) is None


@pytest.mark.parametrize("from_depth", [0.12, 0.0606, 0.05])
def test_a_wrist_stays_45_mm_outside_the_remote_centre_or_comes_no_nearer(home, from_depth) -> None:
    """Source: mtsIntuitiveResearchKitPSM.cpp:648-661, 9e535e6."""
    T = transform(home[:3, :3], home[:3, 3] + [0.0, 0.0, 0.09])
    start = HOME.copy()
    start[2] = from_depth
    assert reached("psm", T, start)[2] == pytest.approx(min(from_depth, 0.0606), abs=1e-9)


def test_the_roll_takes_the_turn_nearest_to_the_measured_one(home) -> None:
    for measured in (-4.0, -1.0, 0.0, 2.0, 4.5):
        for turn in np.linspace(-3.0, 3.0, 7):
            T = transform(
                home[:3, :3] @ matrix_from_rotation_vector(np.array([0.0, 0.0, turn])), home[:3, 3]
            )
            here = HOME.copy()
            here[3] = measured
            roll = reached("psm", T, HOME, here)[3]
            assert abs(roll - measured) < np.pi + 2e-3
            assert np.cos(roll - turn) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("arm", ["psm", "mtmr"])
def test_a_solution_nearby_brings_the_tip_to_the_pose(arm: str, rng) -> None:
    described = load_arm(arm)
    mechanism, own = described.mechanism, described.own_joints
    middle = 0.5 * (mechanism.lower + mechanism.upper)[:own]
    for _ in range(20):
        start = middle + rng.uniform(-0.2, 0.2, own)
        if arm == "psm":
            start[2] = rng.uniform(0.1, 0.2)
        goal = np.zeros(len(mechanism.joints))
        goal[:own] = start + rng.uniform(-0.02, 0.02, own)
        T = pose(mechanism, goal)
        goal[:own] = solved(arm, T, start)
        metres, radians = pose_difference(pose(mechanism, goal), T)
        assert max(metres, radians) < 1e-9


def test_the_quick_chain_has_the_pose_and_jacobian_of_the_mechanism(rng) -> None:
    for arm in ("psm", "mtmr"):
        described = load_arm(arm)
        mechanism, own = described.mechanism, described.own_joints
        q = np.zeros(len(mechanism.joints))
        q[:own] = rng.uniform(mechanism.lower[:own], mechanism.upper[:own])
        T, J = screw_chain(mechanism, own).at(q[:own])
        assert np.abs(T - pose(mechanism, q)).max() < 1e-12
        assert np.abs(J - jacobian_spatial(mechanism, q)[:, :own]).max() < 1e-12


def test_a_scope_is_turned_along_its_line_and_inserted_by_40_mm_at_least() -> None:
    """Source: robManipulatorECM.cpp, mtsIntuitiveResearchKitECM.cpp:241-264, 9e535e6."""
    mechanism = load_arm("ecm").mechanism
    q = np.array([0.3, 0.2, 0.1, 0.4])
    T = pose(mechanism, q)
    tilted = T.copy()
    tilted[:3, :3] = T[:3, :3] @ matrix_from_rotation_vector(np.array([0.1, 0.0, 0.0]))
    assert solved("ecm", tilted, q) == pytest.approx(q, abs=1e-9)
    q[2] = 0.02
    assert reached("ecm", pose(mechanism, q), q)[2] == pytest.approx(0.04, abs=1e-9)


@pytest.mark.parametrize(("joint", "beyond"), [(1, "lower"), (2, "upper"), (3, "upper")])
def test_a_scope_beyond_a_limit_is_an_error_not_clipped(joint: int, beyond: str) -> None:
    """Source: robManipulatorECM.cpp, 9e535e6: a joint that is clamped makes the search fail."""
    mechanism = load_arm("ecm").mechanism
    q = np.array([0.1, 0.1, 0.1, 0.0])
    limit = getattr(mechanism, beyond)[joint]
    q[joint] = limit + (-1.0 if beyond == "lower" else 1.0) * 0.02
    with pytest.raises(UnreachableError, match=mechanism.joints[joint].name):
        robot_solution(mechanism, "rcm_scope", pose(mechanism, q), q, q)
