"""Closed-form inverse of the RCM scope, judged by the ECM's DH product."""

import numpy as np
import pytest

from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry import modified_dh, pose_difference, rotation_x, transform, translation
from trocar.kinematics.inverse_rcm import RcmScopeGeometry, inverse_rcm_scope

# The dVRK's numbers: facts section 3.
ECM = RcmScopeGeometry(insertion_offset=0.3822, scope_length=0.3829)
LOWER = np.array([-1.5708, -0.76794, 0.0, -1.552])
UPPER = np.array([1.5708, 1.1344, 0.255, 1.552])
WIDE_LOWER = np.array([-np.pi, -np.pi, -0.3, -np.pi])
WIDE_UPPER = np.array([np.pi, np.pi, 0.3, np.pi])


def tip(q):
    q1, q2, q3, q4 = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    half = np.pi / 2
    return (
        modified_dh(0, half, 0, q1 + half)
        @ modified_dh(0, -half, 0, q2 - half)
        @ modified_dh(0, half, q3 - 0.3822, 0)
        @ modified_dh(0, 0, 0.3829, q4)
    )


@pytest.mark.parametrize(
    ("n", "lower", "upper"),
    [(1000, LOWER, UPPER), (500, WIDE_LOWER, WIDE_UPPER)],
    ids=["ecm", "no_limits"],
)
def test_every_solution_makes_the_pose_and_the_generating_one_is_among_them(n, lower, upper):
    q = np.random.default_rng(1).uniform(lower, upper, (n, 4))
    poses = tip(q)
    found = [inverse_rcm_scope(ECM, T, lower, upper) for T in poses]
    which = np.repeat(np.arange(n), [len(s) for s in found])
    every = np.concatenate(found)
    metres, radians = pose_difference(tip(every), poses[which])
    assert max(metres.max(), radians.max()) < 1e-9
    assert ((every >= lower) & (every <= upper)).all()
    nearest = [np.abs(s - own).max(axis=-1).min() for s, own in zip(found, q, strict=True)]
    assert max(nearest) < 1e-9


def test_without_limits_both_ways_over_the_top_are_found():
    found = inverse_rcm_scope(ECM, tip([0.3, 0.4, 0.1, 0.5]), WIDE_LOWER, WIDE_UPPER)
    assert len(found) == 2
    assert np.allclose(found[0, :3], [0.3, 0.4, 0.1])
    assert np.allclose(found[1, :3], [0.3 - np.pi, np.pi - 0.4, 0.1])


@pytest.mark.parametrize("insertion", [0.0, -0.0007, -0.1])
def test_tip_at_or_before_the_remote_centre_is_solved_too(insertion):
    q = [0.3, 0.4, insertion, 0.5]
    found = inverse_rcm_scope(ECM, tip(q), WIDE_LOWER, WIDE_UPPER, q)
    assert np.abs(found[0] - q).max() < 1e-9


def test_poses_made_at_the_limits_are_inside_them():
    corners = np.array(np.meshgrid(*zip(LOWER, UPPER, strict=True))).reshape(4, -1).T
    for own in corners:
        found = inverse_rcm_scope(ECM, tip(own), LOWER, UPPER, own)
        assert np.abs(found[0] - own).max() < 1e-9


def test_a_direction_that_misses_a_little_is_taken_and_the_position_kept():
    pose = tip([0.3, 0.4, 0.1, 0.5]) @ transform(rotation_x(9e-7), np.zeros(3))
    made = tip(inverse_rcm_scope(ECM, pose, LOWER, UPPER)[0])
    metres, radians = pose_difference(made, pose)
    assert metres < 1e-15
    assert radians < 1e-6


def test_a_direction_that_misses_is_out_of_reach_and_says_by_how_much():
    pose = tip([0.3, 0.4, 0.1, 0.5]) @ transform(rotation_x(0.02), np.zeros(3))
    message = r"misses the line through the remote centre and the tip by 0.02 rad"
    with pytest.raises(UnreachableError, match=message) as caught:
        inverse_rcm_scope(ECM, pose, LOWER, UPPER)
    assert caught.value.excess == {"direction": pytest.approx(0.02)}


def test_a_tip_beside_the_remote_centre_is_out_of_reach():
    pose = tip([0.3, 0.4, 0.0, 0.5]) @ translation([2e-9, 0, 0])
    with pytest.raises(UnreachableError, match="misses the line"):
        inverse_rcm_scope(ECM, pose, LOWER, UPPER)


def test_a_pose_beyond_a_limit_says_which_and_by_how_much():
    message = "pitch -0.8 rad is beyond its lower limit -0.76794 by 0.0321"
    with pytest.raises(UnreachableError, match=message):
        inverse_rcm_scope(ECM, tip([0.3, -0.8, 0.1, 0.5]), LOWER, UPPER)


def test_scope_along_the_yaw_axis_is_singular_where_the_limits_allow_it():
    pose = tip([0.3, np.pi / 2, 0.1, 1.0])
    with pytest.raises(SingularError, match="yaw and roll are not determined"):
        inverse_rcm_scope(ECM, pose, WIDE_LOWER, WIDE_UPPER)
    with pytest.raises(UnreachableError, match="pitch"):
        inverse_rcm_scope(ECM, pose, LOWER, UPPER)


def test_bad_arguments_are_rejected():
    with pytest.raises(InputError, match="pose: expected last row"):
        inverse_rcm_scope(ECM, np.zeros((4, 4)), LOWER, UPPER)
    with pytest.raises(InputError, match="seed: expected 4 finite numbers"):
        inverse_rcm_scope(ECM, tip([0, 0, 0.1, 0]), LOWER, UPPER, [0, 0])
