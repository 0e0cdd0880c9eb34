"""Closed-form inverse of the gimbal arm, judged by the MTM's DH product."""

import numpy as np
import pytest

from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry import matrix_from_quaternion, pose_difference, standard_dh, transform
from trocar.kinematics.inverse_gimbal_arm import GimbalArmGeometry, inverse_gimbal_arm

# The dVRK's numbers: facts section 5; right arm, then left.
MTM = GimbalArmGeometry(upper_arm=0.2794, forearm=0.3645, wrist_height=0.1506)
RIGHT = (
    np.array([-1.13446, -0.31416, -0.872665, -1.6580, -1.6580, -0.785398, -8.37758]),
    np.array([0.698132, 1.13446, 0.610865, 3.5779, 3.2288, 0.785398, 7.85398]),
)
LEFT = (
    np.array([-0.698132, -0.261799, -0.872665, -3.5779, -1.6580, -0.785398, -8.37758]),
    np.array([1.13446, 1.13446, 0.610865, 1.6580, 3.2288, 0.785398, 7.85398]),
)
WIDE = (np.full(7, -np.pi), np.full(7, np.pi))


def tip(q):
    q1, q2, q3, q4, q5, q6, q7 = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    half = np.pi / 2
    return (
        standard_dh(0, half, 0, q1 - half)
        @ standard_dh(0.2794, 0, 0, q2 - half)
        @ standard_dh(0.3645, -half, 0, q3 + half)
        @ standard_dh(0, half, 0.1506, q4)
        @ standard_dh(0, -half, 0, q5)
        @ standard_dh(0, half, 0, q6 - half)
        @ standard_dh(0, 0, 0, q7 + half)
    )


@pytest.mark.parametrize(
    ("n", "limits"), [(1000, RIGHT), (1000, LEFT), (500, WIDE)], ids=["right", "left", "wide"]
)
def test_every_solution_makes_the_pose_and_the_generating_one_is_among_them(n, limits):
    q = np.random.default_rng(1).uniform(limits[0], limits[1], (n, 7))
    poses = tip(q)
    found = [
        inverse_gimbal_arm(MTM, T, *limits, platform_angle=own[3])
        for T, own in zip(poses, q, strict=True)
    ]
    which = np.repeat(np.arange(n), [len(s) for s in found])
    every = np.concatenate(found)
    metres, radians = pose_difference(tip(every), poses[which])
    assert max(metres.max(), radians.max()) < 1e-9
    assert ((every >= limits[0]) & (every <= limits[1])).all()
    assert (every[:, 3] == q[which, 3]).all()
    nearest = [np.abs(s - own).max(axis=-1).min() for s, own in zip(found, q, strict=True)]
    assert max(nearest) < 1e-9


def test_without_limits_all_eight_branches_are_found():
    q = np.random.default_rng(2).uniform(*WIDE, (50, 7))
    for own in q:
        assert len(inverse_gimbal_arm(MTM, tip(own), *WIDE, platform_angle=own[3])) == 8


def test_poses_made_at_the_limits_are_inside_them():
    corners = np.array(np.meshgrid(*zip(*RIGHT, strict=True))).reshape(7, -1).T
    for own in corners:
        found = inverse_gimbal_arm(MTM, tip(own), *RIGHT, own, platform_angle=own[3])
        assert np.abs(found[0] - own).max() < 1e-9


def test_every_whole_turn_of_roll_is_there_and_the_seed_picks_one():
    q = np.array([0.1, 0.2, 0.1, 0.4, 0.3, -0.2, 1.0])
    for roll in (1.0, 1.0 + 2 * np.pi, 1.0 - 2 * np.pi):
        seed = np.array([*q[:6], roll])
        found = inverse_gimbal_arm(MTM, tip(q), *RIGHT, seed, platform_angle=0.4)
        assert len(found) == 3
        assert np.abs(found[0] - seed).max() < 1e-12


@pytest.mark.parametrize("limits", [RIGHT, LEFT], ids=["right", "left"])
def test_own_platform_choice_reaches_every_orientation_at_every_reachable_position(limits):
    rng = np.random.default_rng(3)
    q = rng.uniform(limits[0], limits[1], (1000, 7))
    turns = matrix_from_quaternion(rng.standard_normal((1000, 4)))
    poses = transform(turns, tip(q)[:, :3, 3])
    level = 0
    for T in poses:
        found = inverse_gimbal_arm(MTM, T, *limits)
        metres, radians = pose_difference(tip(found), T)
        assert max(metres.max(), radians.max()) < 1e-9
        level += bool(np.abs(found[:, 5]).max() < 1e-9)
    # Wrist yaw is 0 but where that platform angle is in the sixth of a turn that the limits leave
    # out; half of those poses have another, so about one in twelve is left.
    assert 850 < level < 980


def test_roll_axis_along_the_platform_axis_keeps_the_platform_of_the_seed():
    q = np.array([0.1, 0.2, 0.1, 0.4, np.pi / 2, 0.0, 1.0])
    found = inverse_gimbal_arm(MTM, tip(q), *RIGHT, q)
    assert np.abs(found[0] - q).max() < 1e-9


def test_a_wrist_too_far_away_says_by_how_much():
    longest = 0.2794 + np.hypot(0.3645, 0.1506)
    pose = transform(np.eye(3), [0.0, -longest - 0.01, 0.0])
    message = r"the wrist is 0.683786 m from the shoulder, the arm reaches at most .* by 0.01 m"
    with pytest.raises(UnreachableError, match=message) as caught:
        inverse_gimbal_arm(MTM, pose, *RIGHT)
    assert caught.value.excess == {"distance": pytest.approx(0.01)}


def test_a_wrist_too_near_says_by_how_much():
    shortest = np.hypot(0.3645, 0.1506) - 0.2794
    pose = transform(np.eye(3), [0.0, -shortest + 0.02, 0.0])
    with pytest.raises(UnreachableError, match=r"reaches at least .* misses by 0.02 m"):
        inverse_gimbal_arm(MTM, pose, *RIGHT)


def test_a_pose_beyond_a_limit_says_which_and_by_how_much():
    q = [0.1, 0.2, 0.1, 0.4, 0.3, 0.9, 1.0]
    with pytest.raises(UnreachableError, match=r"wrist_yaw 0\.9 rad is beyond its upper limit"):
        inverse_gimbal_arm(MTM, tip(q), *RIGHT, platform_angle=0.4)


def test_a_platform_angle_beyond_its_limits_is_out_of_reach():
    q = [0.1, 0.2, 0.1, 0.4, 0.3, 0.1, 1.0]
    message = "platform angle 3.6 rad is beyond its limits -1.658 to 3.5779 by 0.0221"
    with pytest.raises(UnreachableError, match=message) as caught:
        inverse_gimbal_arm(MTM, tip(q), *RIGHT, platform_angle=3.6)
    assert caught.value.excess == {"wrist_platform": pytest.approx(0.0221)}


def test_parallel_gimbal_axes_are_singular_where_the_limits_allow_them():
    pose = tip([0.1, 0.2, 0.1, 0.4, 0.3, np.pi / 2, 1.0])
    with pytest.raises(SingularError, match="wrist pitch and wrist roll turn about one line"):
        inverse_gimbal_arm(MTM, pose, *WIDE, platform_angle=0.4)
    with pytest.raises(UnreachableError, match="wrist_yaw"):
        inverse_gimbal_arm(MTM, pose, *RIGHT, platform_angle=0.4)


def test_a_wrist_above_the_outer_yaw_is_singular():
    pose = transform(np.eye(3), [0.0, 0.0, 0.4])
    with pytest.raises(SingularError, match="outer yaw"):
        inverse_gimbal_arm(MTM, pose, *WIDE)


def test_bad_arguments_are_rejected():
    pose = tip(np.zeros(7))
    with pytest.raises(InputError, match="platform_angle: expected a finite number, got nan"):
        inverse_gimbal_arm(MTM, pose, *RIGHT, platform_angle=np.nan)
    with pytest.raises(InputError, match="pose: expected finite numbers"):
        inverse_gimbal_arm(MTM, pose * np.nan, *RIGHT)
    with pytest.raises(InputError, match="seed: expected 7 finite numbers"):
        inverse_gimbal_arm(MTM, pose, *RIGHT, np.zeros(6))
