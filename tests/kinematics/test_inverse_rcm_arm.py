"""Closed-form inverse of the RCM arm, judged by the PSM's DH product."""

import numpy as np
import pytest

from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry import modified_dh, pose_difference, rotation_x, transform
from trocar.kinematics.inverse_rcm import RcmArmGeometry, inverse_rcm_arm

# The dVRK's numbers: facts section 1, Large Needle Driver 400006, and the Si generation's limits.
OFFSET, TOOL, WRIST = 0.4318, 0.4162, 0.0091
TIP_ROTATION = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
PSM = RcmArmGeometry(OFFSET, TOOL, WRIST, TIP_ROTATION)
PSM_SI = RcmArmGeometry(0.4826, TOOL, WRIST, TIP_ROTATION)
LOWER = np.array([-1.588, -0.925025, 0.0, -4.53786, -1.39626, -1.39626])
UPPER = np.array([1.588, 0.925025, 0.240, 4.53786, 1.39626, 1.39626])
SI_LOWER = np.array([-2.964, -1.265, 0.0, -4.53786, -1.39626, -1.39626])
SI_UPPER = np.array([2.964, 1.301, 0.29, 4.53786, 1.39626, 1.39626])
WIDE_LOWER = np.array([-np.pi, -np.pi, -0.6, -np.pi, -np.pi, -np.pi])
WIDE_UPPER = np.array([np.pi, np.pi, 0.6, np.pi, np.pi, np.pi])
CENTRE = OFFSET - TOOL  # insertion with the wrist pitch axis at the remote centre: 15.6 mm


def tip(q, geometry=PSM):
    q1, q2, q3, q4, q5, q6 = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    half = np.pi / 2
    return (
        modified_dh(0, half, 0, q1 + half)
        @ modified_dh(0, -half, 0, q2 - half)
        @ modified_dh(0, half, q3 - geometry.insertion_offset, 0)
        @ modified_dh(0, 0, geometry.tool_length, q4)
        @ modified_dh(0, -half, 0, q5 - half)
        @ modified_dh(geometry.wrist_length, -half, 0, q6 - half)
        @ transform(geometry.tip_rotation, np.zeros(3))
    )


def draw(n, lower, upper, centre, seed):
    q = np.random.default_rng(seed).uniform(lower, upper, (2 * n, 6))
    return q[np.abs(q[:, 2] - centre) > 1e-3][:n]


@pytest.mark.parametrize(
    ("n", "geometry", "lower", "upper"),
    [
        (1000, PSM, LOWER, UPPER),
        (500, PSM, LOWER, np.array([1.588, 0.925025, 0.03, 4.53786, 1.39626, 1.39626])),
        (500, PSM_SI, SI_LOWER, SI_UPPER),
        (500, PSM, WIDE_LOWER, WIDE_UPPER),
    ],
    ids=["psm", "psm_near_the_remote_centre", "psm_si", "no_limits"],
)
def test_every_solution_makes_the_pose_and_the_generating_one_is_among_them(
    n, geometry, lower, upper
):
    centre = geometry.insertion_offset - geometry.tool_length
    q = draw(n, lower, upper, centre, seed=1)
    poses = tip(q, geometry)
    found = [inverse_rcm_arm(geometry, T, lower, upper) for T in poses]
    which = np.repeat(np.arange(n), [len(s) for s in found])
    every = np.concatenate(found)
    metres, radians = pose_difference(tip(every, geometry), poses[which])
    assert max(metres.max(), radians.max()) < 1e-9
    assert ((every >= lower) & (every <= upper)).all()
    nearest = [np.abs(s - own).max(axis=-1).min() for s, own in zip(found, q, strict=True)]
    # the goal of 1e-9; the worst poses, with the tip near its singular line, reach some 1e-11.
    assert max(nearest) < 1e-9


def test_without_limits_all_eight_branches_are_found():
    q = draw(100, WIDE_LOWER, WIDE_UPPER, CENTRE, seed=2)
    q[:, 2] *= 0.9  # room for the same depth on the other side of the remote centre
    for own in q:
        found = inverse_rcm_arm(PSM, tip(own), WIDE_LOWER, WIDE_UPPER)
        assert len(found) == 8
        assert (found[:, 2] > CENTRE).sum() == 4  # the others have the wrist before the centre


def test_wrist_before_the_remote_centre_is_solved_inside_the_real_limits():
    q = [0.3, -0.4, 0.004, 1.0, 0.5, -0.7]
    found = inverse_rcm_arm(PSM, tip(q), LOWER, UPPER, q)
    assert np.abs(found[0] - q).max() < 1e-9


def test_poses_made_at_the_limits_are_inside_them():
    corners = np.array(np.meshgrid(*zip(LOWER, UPPER, strict=True))).reshape(6, -1).T
    for own in corners:
        found = inverse_rcm_arm(PSM, tip(own), LOWER, UPPER, own)
        assert np.abs(found[0] - own).max() < 1e-9
        assert ((found >= LOWER) & (found <= UPPER)).all()


def test_every_whole_turn_of_roll_inside_the_limits_is_there():
    q = np.array([0.1, 0.2, 0.1, 0.5, 0.3, -0.2])
    lower, upper = LOWER.copy(), UPPER.copy()
    lower[3], upper[3] = -20.0, 20.0
    found = inverse_rcm_arm(PSM, tip(q), lower, upper)
    rolls = np.sort(found[:, 3])
    assert np.allclose(rolls, 0.5 + 2 * np.pi * np.arange(-3, 4), atol=1e-12)
    assert np.abs(np.delete(found - q, 3, axis=1)).max() < 1e-12


def test_solutions_come_nearest_to_the_seed_first():
    q = np.array([0.1, 0.2, 0.1, 2.5, 0.3, -0.2])
    for seed in (q, q - [0, 0, 0, 2 * np.pi, 0, 0]):
        found = inverse_rcm_arm(PSM, tip(q), LOWER, UPPER, seed)
        assert len(found) == 2
        assert np.abs(found[0] - seed).max() < 1e-12


def test_without_a_seed_the_solution_nearest_to_the_middle_comes_first():
    q = np.array([0.1, 0.2, 0.1, 2.5, 0.3, -0.2])  # the other has roll 2.5 - 2 pi = -3.78
    assert inverse_rcm_arm(PSM, tip(q), LOWER, UPPER)[0, 3] == pytest.approx(2.5)


def test_a_pose_beyond_one_limit_says_which_and_by_how_much():
    pose = tip([0.3, -0.2, 0.2613, 0.4, 0.2, 0.1])
    message = r"insertion 0.2613 m is beyond its upper limit 0.24 by 0.0213"
    with pytest.raises(UnreachableError, match=message) as caught:
        inverse_rcm_arm(PSM, pose, LOWER, UPPER)
    assert caught.value.excess == {"insertion": pytest.approx(0.0213)}


def test_a_pose_beyond_two_limits_names_both():
    pose = tip([0.3, -1.0, 0.1, 0.4, 1.5, 0.1])
    with pytest.raises(UnreachableError) as caught:
        inverse_rcm_arm(PSM, pose, LOWER, UPPER)
    assert caught.value.excess == {
        "pitch": pytest.approx(1.0 - 0.925025),
        "wrist_pitch": pytest.approx(1.5 - 1.39626),
    }


def test_the_branch_that_comes_nearest_is_reported():
    pose = tip([0.3, -0.4, -0.003, 1.0, 0.5, -0.7])  # wrist before the remote centre
    with pytest.raises(UnreachableError) as caught:
        inverse_rcm_arm(PSM, pose, LOWER, UPPER)
    assert caught.value.excess == {"insertion": pytest.approx(0.003)}


def test_wrist_at_the_remote_centre_is_out_of_reach_where_the_insertion_cannot_take_it_there():
    pose = tip([0.3, -0.4, CENTRE, 1.0, 0.5, -0.7])
    lower = np.where(np.arange(6) == 2, 0.02, LOWER)
    with pytest.raises(UnreachableError, match="insertion"):
        inverse_rcm_arm(PSM, pose, lower, UPPER)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 9.9e-4, -9.9e-4])
def test_wrist_within_a_millimetre_of_the_remote_centre_is_singular(gap):
    pose = tip([0.3, -0.4, CENTRE + gap, 1.0, 0.5, -0.7])
    with pytest.raises(SingularError, match="wrist pitch axis is within 1 mm of the remote centre"):
        inverse_rcm_arm(PSM, pose, LOWER, UPPER)


def test_no_pose_of_that_millimetre_slips_through():
    q = np.random.default_rng(3).uniform(LOWER, UPPER, (1000, 6))
    q[:, 2] = CENTRE + np.random.default_rng(4).uniform(-9.99e-4, 9.99e-4, 1000)
    for T in tip(q):
        with pytest.raises(SingularError, match="wrist pitch axis"):
            inverse_rcm_arm(PSM, T, LOWER, UPPER)


@pytest.mark.parametrize("gap", [1.01e-3, -1.01e-3])
def test_wrist_just_over_a_millimetre_from_the_remote_centre_is_solved(gap):
    q = [0.3, -0.4, CENTRE + gap, 1.0, 0.5, -0.7]
    assert np.abs(inverse_rcm_arm(PSM, tip(q), LOWER, UPPER, q)[0] - q).max() < 1e-9


@pytest.mark.parametrize("wrist_pitch", [0.0, 0.6])
def test_tip_on_the_wrist_yaw_line_through_the_remote_centre_is_singular(wrist_pitch):
    before = WRIST / np.cos(wrist_pitch)
    pose = tip([0.3, -0.4, CENTRE - before, 1.0, wrist_pitch, -0.7])
    with pytest.raises(SingularError, match="about which the whole arm could turn"):
        inverse_rcm_arm(PSM, pose, LOWER, UPPER)


def test_tip_on_that_line_with_the_wrist_bent_too_far_is_out_of_reach():
    pose = tip([0.3, -0.4, CENTRE + 0.1, 1.0, np.arccos(-WRIST / 0.1), -0.7])
    with pytest.raises(UnreachableError, match="wrist_pitch"):
        inverse_rcm_arm(PSM, pose, LOWER, UPPER)


def test_shaft_along_the_yaw_axis_is_singular_where_the_limits_allow_it():
    pose = tip([0.3, np.pi / 2, 0.1, 1.0, 0.5, -0.7])
    upper = np.array([1.588, 2.0, 0.240, 4.53786, 1.39626, 1.39626])
    with pytest.raises(SingularError, match="shaft lies along the yaw axis"):
        inverse_rcm_arm(PSM, pose, LOWER, upper)
    with pytest.raises(UnreachableError, match="pitch"):
        inverse_rcm_arm(PSM, pose, LOWER, UPPER)


def test_bad_arguments_are_rejected():
    pose = tip(0.5 * (LOWER + UPPER))
    leaning = pose @ transform(2 * rotation_x(0.1), np.zeros(3))
    with pytest.raises(InputError, match="not orthonormal"):
        inverse_rcm_arm(PSM, leaning, LOWER, UPPER)
    with pytest.raises(InputError, match=r"limits: expected 6 joints \(yaw, .*\), got \(5,\)"):
        inverse_rcm_arm(PSM, pose, LOWER[:5], UPPER)
    with pytest.raises(InputError, match="seed: expected 6 finite numbers"):
        inverse_rcm_arm(PSM, pose, LOWER, UPPER, [0, 0, 0, 0, 0, np.nan])
