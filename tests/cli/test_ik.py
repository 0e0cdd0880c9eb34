"""`trocar ik`: all joint positions for a pose, or why there are none."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm, names
from trocar.geometry import quaternion_from_matrix
from trocar.kinematics import forward

DOWN = ["0", "0.70710678", "0.70710678", "0"]
SOLVED = [name for name in names("arms") if load_arm(name).inverse_kinematics]


def words(T):
    """Return a pose as the command line takes it."""
    return [*map(repr, [*T[:3, 3].tolist(), *quaternion_from_matrix(T[:3, :3]).tolist()])]


@pytest.mark.parametrize("name", SOLVED)
def test_what_fk_says_ik_gives_back(name, trocar, rng):
    arm = load_arm(name)
    mechanism = arm.mechanism
    q = mechanism.lower + (mechanism.upper - mechanism.lower) * rng.uniform(0.4, 0.9)
    platform = ["--platform", q[3]] if arm.inverse_kinematics == "gimbal_arm" else []
    pose = words(forward.pose(mechanism, q))
    answer = trocar("ik", name, *pose, *platform, "--json")
    assert (answer.status, answer.err) == (0, "")
    document = answer.document
    count = arm.own_joints
    assert set(document) == {"arm", "tool", "relative_to", "joints", "solutions"}
    assert tuple(document["joints"]) == mechanism.joint_names[:count]
    # A quaternion carries an orientation to a few roundings.
    assert np.abs(np.array(document["solutions"]) - q[:count]).max(axis=1).min() < 1e-9


def test_an_mtm_chooses_its_platform_by_itself(trocar):
    if "mtml" not in SOLVED:
        pytest.skip("no masters yet")
    q = [0.1, 0.2, -0.1, 0.3, 0.5, 0.4, 1.0]
    T = forward.pose(load_arm("mtml").mechanism, [*q, 0.0])
    found = trocar("ik", "mtml", *words(T), "--json").document["solutions"]
    assert abs(found[0][5]) < 1e-9  # wrist yaw
    assert np.abs(forward.pose(load_arm("mtml").mechanism, [*found[0], 0.0]) - T).max() < 1e-9


def test_the_seed_chooses_what_comes_first(trocar):
    q = np.array([0.2, -0.3, 0.12, 2.5, 0.5, -0.6])
    T = forward.pose(load_arm("psm").mechanism, [*q, 0.0])
    for turn in (0.0, -2.0 * np.pi):
        seed = q + turn * np.eye(6)[3]
        found = trocar("ik", "psm", *words(T), "--json", "--seed", *seed).document["solutions"]
        assert len(found) == 2
        assert np.abs(found[0] - seed).max() < 1e-9
    assert (
        "2 solutions, nearest to the seed first"
        in trocar("ik", "psm", *words(T), "--seed", *q).out.splitlines()[0]
    )


def test_people_read_a_table_with_units(trocar):
    out = trocar("ik", "psm", 0, 0, "-0.12", *DOWN).out.splitlines()
    assert out[0] == "psm with LARGE_NEEDLE_DRIVER:400006: 1 solution"
    joints = ("yaw [rad]", "pitch [rad]", "insertion [m]", "roll [rad]", "wrist_pitch [rad]")
    assert " ".join(out[2].split()) == " ".join([*joints, "wrist_yaw [rad]"])
    # 0.12 m past the remote centre, less the reach at insertion 0: 0.4162 + 0.0091 - 0.4318 m.
    assert out[3].split()[2] == "0.126500000"


def test_a_quaternion_of_four_digits_is_made_a_unit_one(trocar):
    answer = trocar("ik", "psm", 0, 0, -0.12, 0, 0.7071, 0.7071, 0, "--json")
    assert answer.document["solutions"][0] == pytest.approx([0, 0, 0.1265, 0, 0, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (
            ["0", "0", "-0.9", *DOWN],
            "pose out of reach: insertion 0.9065 m is beyond its upper limit 0.24 by 0.667",
        ),
        (
            ["0", "0", "-0.0095", *DOWN],
            "singular pose: the wrist pitch axis is within 1 mm of the remote centre, so yaw, "
            "pitch and roll are not determined",
        ),
    ],
)
def test_a_pose_without_solution_fails_with_its_reason(pose, reason, trocar):
    answer = trocar("ik", "psm", *pose)
    assert (answer.status, answer.complaint) == (1, reason)
    answer = trocar("ik", "psm", *pose, "--json")
    assert (answer.status, answer.err) == (1, f"trocar: error: {reason}\n")
    assert answer.document == {
        "arm": "psm",
        "tool": "LARGE_NEEDLE_DRIVER:400006",
        "relative_to": "rcm",
        "solutions": [],
        "reason": reason,
    }


def test_a_scope_that_looks_past_the_remote_centre_fails_with_its_reason(trocar):
    answer = trocar("ik", "ecm", 0.01, 0, -0.1, 0, 1, 0, 0)
    assert answer.status == 1
    assert "its z axis misses the line through the remote centre and the tip by" in answer.err


POSE = ["0", "0", "-0.12", *DOWN]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ["psm", 0, 0, -0.12, 1, 1, 0, 0],
            "QW QX QY QZ: got a quaternion of norm 1.41421; allowed: 1 to within 0.001",
        ),
        (["psm", 0, 0, -0.12, 0, 0, 0, 0], "QW QX QY QZ: got a quaternion of norm 0; allowed: 1"),
        (["psm", 0, 0, -0.12, "nan", 0, 0, 0], "QW QX QY QZ: got a quaternion of norm nan;"),
        (
            ["psm", 0, "-inf", 0.1, *DOWN],
            "X Y Z: got 0.0, -inf, 0.1; allowed: finite numbers",
        ),
        (["psm", 0, 0, -0.12, 0, 1, 0], "ik: the following arguments are required: QZ"),
        (["psm", *POSE, "--seed", 0, 0], "seed: expected 6 finite numbers, got [0.0, 0.0]"),
        (["psm", *POSE, "--platform", 0], "platform_angle: only an arm with a wrist platform"),
        (["suj_psm1", *POSE], "suj_psm1: no inverse kinematics: got a description that names no"),
        (["psm", *POSE, "--tool", "none"], "psm: not built as 'rcm_arm', whose joints are RRSRRR"),
        (["pms", *POSE], "unknown arm 'pms' (did you mean 'psm'?)"),
    ],
)
def test_bad_input_is_refused(words, complaint, trocar):
    answer = trocar("ik", *words)
    assert answer.status == 2
    assert answer.complaint.startswith(complaint)
