"""The remote centre from shaft lines."""

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry import exp_twist, modified_dh, transform_points
from trocar.geometry.screws import remote_centre
from trocar.kinematics.inverse_rcm import shaft_angles, shaft_axes


def shaft_frame(q1, q2, q3):
    """Frame 3 of the PSM's DH rows (facts section 1) in the frame of the remote centre."""
    half = np.pi / 2
    return (
        modified_dh(0, half, 0, q1 + half)
        @ modified_dh(0, -half, 0, q2 - half)
        @ modified_dh(0, half, q3 - 0.4318, 0)
    )


@pytest.fixture
def frames():
    rng = np.random.default_rng(6)
    return shaft_frame(*rng.uniform([[-1.5], [-0.9], [0]], [[1.5], [0.9], [0.24]], (3, 60)))


def test_an_arm_s_shaft_lines_meet_in_the_remote_centre_wherever_the_arm_stands(frames):
    place = exp_twist(np.array([0.3, -0.2, 1.0, 0.4, 0.5, -0.6]))
    seen = place @ frames
    found = remote_centre(seen[..., :3, 3], seen[..., :3, 2])
    assert np.abs(found.point - place[:3, 3]).max() < 1e-14
    assert found.rms < 1e-14
    assert found.distances.shape == (60,)


def test_leading_axes_are_taken_together_in_their_order(frames):
    frames[7, :3, 3] += [0, 0.001, 0]
    flat = remote_centre(frames[..., :3, 3], frames[..., :3, 2])
    block = frames.reshape(3, 20, 4, 4)
    found = remote_centre(block[..., :3, 3], block[..., :3, 2])
    assert np.abs(found.point - flat.point).max() < 1e-15
    assert np.argmax(found.distances) == 7


def test_lines_that_miss_each_other_say_by_how_much():
    found = remote_centre([[0, 0, 0.002], [0, 0, -0.004]], [[1, 0, 0], [0, 3, 0]])
    assert np.allclose(found.point, [0, 0, -0.001])
    assert np.allclose(found.distances, 0.003)
    assert found.rms == pytest.approx(0.003)


def test_shaft_axes_are_those_of_the_dh_rows():
    rng = np.random.default_rng(7)
    q1, q2 = rng.uniform(-3, 3, (2, 100))
    axes = np.stack(shaft_axes(q1, q2), axis=-1)
    assert np.abs(axes - shaft_frame(q1, q2, 0.1)[..., :3, :3]).max() < 1e-15


def test_both_pairs_of_shaft_angles_point_where_they_are_told():
    rng = np.random.default_rng(8)
    direction = rng.standard_normal((100, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    yaw, pitch, level = shaft_angles(direction)
    _, _, z = shaft_axes(yaw, pitch)
    assert np.abs(z - direction[:, None]).max() < 1e-15
    assert np.abs(np.cos(pitch[:, 0]) - level).max() < 1e-15
    assert (np.abs(pitch[:, 0]) <= np.pi / 2).all()


def test_a_point_on_the_shaft_stays_on_its_line(frames):
    further = transform_points(frames, [0, 0, 0.123])
    found = remote_centre(further, -5 * frames[..., :3, 2])
    assert np.abs(found.point).max() < 1e-14


@pytest.mark.parametrize(
    ("points", "directions", "message"),
    [
        (
            np.zeros((2, 3)),
            np.zeros((3, 3)),
            r"expected two arrays of shape \(..., 3\), got \(2, 3\)",
        ),
        (np.zeros(2), np.zeros(2), r"expected two arrays of shape \(..., 3\)"),
        (np.full((2, 3), np.nan), np.eye(3)[:2], "expected finite points"),
        (np.zeros(3), np.ones(3), "expected at least two, got 1"),
        (np.eye(3), np.ones((3, 3)), "all are parallel"),
    ],
)
def test_lines_without_a_remote_centre_are_rejected(points, directions, message):
    with pytest.raises(InputError, match=message):
        remote_centre(points, directions)
