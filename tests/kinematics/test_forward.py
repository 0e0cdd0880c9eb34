"""Forward kinematics: every frame is where independent computations have it."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.screws import remote_centre
from trocar.geometry.se3 import inverse
from trocar.kinematics import forward

EXACT = 1e-12  # a product of fifteen transforms of metre size

#: Positions at q = 0 in the paper's frame 0 [m], computed from the mended rows independently of
#: this project; rounded to 10 um there. Source: closed-loop paper, Table 4 with its errata.
PSM_AT_ZERO = {
    "yaw": (0, 0, 0),
    "pitch_back": (0, -0.0296, 0),
    "pitch_front": (0, 0.0664, 0),
    "pitch_bottom": (0, -0.07261, 0.14370),
    "pitch_top": (0, -0.06872, 0.18000),
    "pitch_end": (0, 0.44339, 0.14370),
    "insertion": (0, 0.48639, 0.43180),
    "counterweight": (0, -0.1296, 0),
    "wrist_pitch": (0, 0.48639, 0.01560),
    "finger_left": (0, 0.48639, 0.00650),
    "finger_right": (0, 0.48639, 0.00650),
    "c1": (0, 0.02339, 0.14370),
    "c2": (0, 0.44728, 0.18000),
}


@pytest.mark.parametrize("frame", PSM_AT_ZERO)
def test_the_psm_at_zero_is_where_the_mended_table_has_it(frame):
    arm = load_arm("psm")
    at = forward.pose(arm.mechanism, np.zeros(7), frame, "base")
    # 10 um of rounding, and 8 um by which the printed rows miss the remote centre
    np.testing.assert_allclose(at[:3, 3], PSM_AT_ZERO[frame], rtol=0, atol=2e-5)


@pytest.mark.parametrize("name", ["psm", "ecm", "suj_psm1", "mtml"])
def test_all_poses_at_once_are_those_of_one_frame_after_the_other(name, rng, random_positions):
    mechanism = load_arm(name).mechanism
    q = random_positions(load_arm(name), rng, 6).reshape(2, 3, -1)
    together = forward.poses(mechanism, q)
    for frame in mechanism.frame_names:
        for row in range(2):
            for column in range(3):
                alone = forward.pose(mechanism, q[row, column], frame)
                np.testing.assert_allclose(together[frame][row, column], alone, atol=EXACT)


@pytest.mark.parametrize("name", ["psm", "ecm", "mtmr"])
def test_poses_relative_to_another_frame_compose(name, rng, random_positions):
    arm = load_arm(name)
    q = random_positions(arm, rng, 5)
    frames = arm.mechanism.frame_names
    first, second = frames[3], frames[-3]
    T_ab = forward.pose(arm.mechanism, q, second, first)
    T_0a, T_0b = (forward.pose(arm.mechanism, q, f) for f in (first, second))
    np.testing.assert_allclose(T_ab, inverse(T_0a) @ T_0b, atol=EXACT)


@pytest.mark.parametrize("name", ["psm", "ecm", "mtml", "mtmr"])
def test_closing_points_are_the_same_on_both_links(name, rng, random_positions):
    arm = load_arm(name)
    at = forward.poses(arm.mechanism, random_positions(arm, rng, 200))
    for closure in arm.mechanism.closures:
        a = at[closure.frame_a] @ [*closure.point_a, 1.0]
        b = at[closure.frame_b] @ [*closure.point_b, 1.0]
        np.testing.assert_allclose(a, b, atol=EXACT)


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_shaft_lines_meet_in_the_remote_centre(name, rng, random_positions):
    arm = load_arm(name)
    shaft = forward.pose(arm.mechanism, random_positions(arm, rng, 300), "insertion")
    found = remote_centre(shaft[:, :3, 3], shaft[:, :3, 2])
    np.testing.assert_allclose(found.point, np.zeros(3), atol=EXACT)
    assert found.rms < EXACT


def test_the_bars_of_the_parallelogram_only_translate(rng, random_positions):
    arm = load_arm("psm")
    q = random_positions(arm, rng, 50)
    q[:, 0] = 0.0
    at = forward.poses(arm.mechanism, q, "base")
    for frame in ("pitch_bottom", "pitch_top"):
        turns = at[frame][:, :3, :3]
        np.testing.assert_allclose(turns, np.broadcast_to(turns[0], turns.shape), atol=EXACT)


def test_the_counterweight_moves_against_the_instrument():
    mechanism = load_arm("psm").mechanism
    q = np.zeros((2, 7))
    q[1, 2] = 0.1
    weight = forward.pose(mechanism, q, "counterweight", "pitch_back")[:, :3, 3]
    tool = forward.pose(mechanism, q, "insertion", "pitch_end")[:, :3, 3]
    assert np.linalg.norm(weight[1] - weight[0]) == pytest.approx(0.06025, abs=EXACT)
    assert np.linalg.norm(tool[1] - tool[0]) == pytest.approx(0.1, abs=EXACT)
    base = forward.pose(mechanism, q, "counterweight", "base")[:, 2, 3]
    assert base[1] > base[0]  # up, while the instrument goes down


def test_the_jaws_open_by_half_the_angle_each():
    mechanism = load_arm("psm").mechanism
    at = forward.poses(mechanism, [0, 0, 0.1, 0, 0.2, 0.3, 0.5], "wrist_yaw")
    left = np.arctan2(at["finger_left"][1, 0], at["finger_left"][0, 0])
    right = np.arctan2(at["finger_right"][1, 0], at["finger_right"][0, 0])
    assert left == pytest.approx(0.25, abs=EXACT)
    assert right == pytest.approx(-0.25, abs=EXACT)


@pytest.mark.parametrize("bad", [[0.0] * 6, 0.0, [[0.0] * 8]])
def test_a_wrong_number_of_joints_is_rejected(bad):
    with pytest.raises(InputError, match=r"got joint positions of shape .*allowed \(\.\.\., 7\)"):
        forward.pose(load_arm("psm").mechanism, bad)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_joint_positions_that_are_no_numbers_are_rejected(bad):
    with pytest.raises(InputError, match="must be finite"):
        forward.pose(load_arm("ecm").mechanism, [0, bad, 0, 0])


def test_an_unknown_frame_is_rejected_with_the_known_ones():
    with pytest.raises(UnknownNameError, match=r"did you mean 'pitch_back'.*counterweight"):
        forward.pose(load_arm("psm").mechanism, np.zeros(7), "pitch_bak")
