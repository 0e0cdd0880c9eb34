"""Needle tracking on images that no renderer of ours made: poses, covariance, losses, errors."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tasks.vision.drawn import NEEDLE, before_the_eyes, drawn, small_eyes
from trocar.cameras import StereoCalibration
from trocar.errors import InputError
from trocar.geometry import inverse, matrix_from_rotation_vector, transform_points
from trocar.geometry.se3 import transform
from trocar.tasks.vision import Holder, NeedleTracker
from trocar.tasks.vision.eyes import Eyes
from trocar.tasks.vision.needle_fit import NeedleFit, change, moved
from trocar.tasks.vision.needle_search import flipped

pytest.importorskip("cv2", reason="needs the extra vision")


@pytest.fixture(scope="module")
def eyes() -> StereoCalibration:
    return small_eyes()


def errors(T: np.ndarray | None, truth: np.ndarray) -> tuple[float, float]:
    """Return errors of the centre [mm] and of the rotation [deg]."""
    assert T is not None
    x = change(T, truth)
    return 1e3 * float(np.linalg.norm(x[:3])), float(np.degrees(np.linalg.norm(x[3:])))


def test_derivatives_of_the_projection_are_those_of_differences(eyes: StereoCalibration) -> None:
    both, point, step = Eyes(eyes), np.array([[0.004, -0.006, 0.07]]), 1e-7
    pixels, _, J = both.project_with_jacobian(point)
    for eye in range(2):
        np.testing.assert_allclose(pixels[eye], both.project(point, eye), atol=1e-9)
        numeric = [
            (both.project(point + step * d, eye) - both.project(point - step * d, eye))[0] / 2e-7
            for d in np.eye(3)
        ]
        np.testing.assert_allclose(J[eye, 0], np.transpose(numeric), rtol=1e-6, atol=1e-3)


def test_pixels_of_both_eyes_give_the_point_back(eyes: StereoCalibration) -> None:
    both, points = Eyes(eyes), np.array([[0.004, -0.006, 0.07], [0.0, 0.01, 0.12]])
    back = both.triangulate(both.project(points, 0), both.project(points, 1))
    np.testing.assert_allclose(back, points, atol=1e-10)
    with pytest.raises(InputError, match="are the eyes exchanged"):
        both.triangulate(both.project(points, 1), both.project(points, 0))


def test_a_pose_a_millimetre_off_is_refined(eyes: StereoCalibration) -> None:
    rng, truth = np.random.default_rng(1), before_the_eyes()
    images = drawn(eyes, truth, rng)
    x = np.array([6e-4, -5e-4, 7e-4, 0.04, -0.05, 0.04])
    T, quality, _ = NeedleFit(Eyes(eyes), NEEDLE).refine(images, moved(truth, x))
    shift, turn = errors(T, truth)
    # 0.05 px of 7 px/mm across, eight times that in depth; 1.2 degrees of roll are 0.2 mm.
    assert shift < 0.15 and turn < 1.5 and quality.share > 0.9


def test_the_other_way_round_is_the_same_arc() -> None:
    T = before_the_eyes()
    other = flipped(NEEDLE, T)
    angles = np.linspace(0.0, NEEDLE.arc, 7)
    there = NEEDLE.points(angles) @ T[:3, :3].T + T[:3, 3]
    back = NEEDLE.points(angles[::-1]) @ other[:3, :3].T + other[:3, 3]
    np.testing.assert_allclose(there, back, atol=1e-15)
    assert np.linalg.det(other) == pytest.approx(1.0)


def test_a_needle_is_found_from_nothing_tip_and_swage_the_right_way(
    eyes: StereoCalibration,
) -> None:
    rng, truth, tracker = np.random.default_rng(2), before_the_eyes(), NeedleTracker(eyes, NEEDLE)
    found = tracker.estimate
    for k in range(5):
        found = tracker.update(k / 30.0, *drawn(eyes, truth, rng))
    shift, turn = errors(found.T_left_needle, truth)
    assert found.status == "tracking" and shift < 0.3 and turn < 3.0


def test_it_follows_a_tool_and_survives_a_second_without_sight(eyes: StereoCalibration) -> None:
    rng, start = np.random.default_rng(3), before_the_eyes()
    grasp = transform(matrix_from_rotation_vector([0.3, 0.2, 0.9]), [0.002, 0.001, 0.009])
    tracker = NeedleTracker(eyes, NEEDLE)
    # The kinematics is a millimetre and a degree off, constantly.
    hand_eye = transform(matrix_from_rotation_vector([0.01, -0.01, 0.01]), [6e-4, 6e-4, -6e-4])
    first = moved(start, np.array([6e-4, -5e-4, 7e-4, 0.04, -0.05, 0.04]))
    tracker.start(-1.0, first, np.diag([1e-6] * 3 + [0.01] * 3))
    sigmas: list[float] = []
    found = tracker.estimate
    for k in range(30):
        shift = transform(np.eye(3), 0.02 * k / 30.0 * np.array([0.5, 0.2, 0.3]))
        turn = transform(matrix_from_rotation_vector([0.0, 0.3 * k / 30.0, 0.0]), np.zeros(3))
        truth = shift @ start @ turn
        hidden = 10 <= k < 24
        images = drawn(eyes, None if hidden else truth, rng)
        holder = Holder("PSM1", hand_eye @ truth @ inverse(grasp))
        found = tracker.update(k / 30.0, *images, holder)
        assert found.status == ("predicting" if hidden else "tracking")
        sigmas.append(found.position_sigma)
        shift_mm, turn_deg = errors(found.T_left_needle, truth)
        if k > 2:
            assert shift_mm < (2.0 if hidden else 0.4) and turn_deg < (6.0 if hidden else 3.0)
    assert (np.diff(sigmas[10:24]) > 0.0).all() and sigmas[24] < sigmas[23]
    assert found.normal_sigma < found.roll_sigma < 0.05


def test_half_an_arc_is_enough_to_follow(eyes: StereoCalibration) -> None:
    rng, truth, tracker = np.random.default_rng(4), before_the_eyes(), NeedleTracker(eyes, NEEDLE)
    found = tracker.estimate
    tracker.start(-1.0, truth, np.diag([1e-7] * 3 + [0.003] * 3))
    for k in range(6):
        found = tracker.update(k / 30.0, *drawn(eyes, truth, rng, hidden=(0.0, 0.5)))
    shift, turn = errors(found.T_left_needle, truth)
    # Source of the bounds: the project's goals.
    assert found.status == "tracking" and shift < 0.8 and turn < 4.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_shadow_beside_the_point_does_not_turn_the_needle(
    eyes: StereoCalibration, side: float
) -> None:
    rng, truth, both = np.random.default_rng(6), before_the_eyes(0.05), Eyes(eyes)
    images = drawn(eyes, truth, rng)
    angles = NEEDLE.arc * np.linspace(0.82, 1.0, 80)
    points = transform_points(truth, NEEDLE.points(angles))
    half = NEEDLE.half_width(angles) * both.focal / truth[2, 3]
    for eye, image in enumerate(images):
        pixels = both.project(points, eye)
        ahead = np.gradient(pixels, axis=0)
        across = np.stack([-ahead[:, 1], ahead[:, 0]], 1) / np.linalg.norm(ahead, axis=1)[:, None]
        for off in np.arange(0.7, 9.0, 0.3):
            u, v = np.round(pixels + side * (half + off)[:, None] * across).astype(int).T
            image[v, u] = (60, 35, 30)
    tracker = NeedleTracker(eyes, NEEDLE)
    tracker.start(-1.0, truth, np.diag([1e-6] * 3 + [0.01] * 3))
    T = [tracker.update(0.1 * k, *images).T_left_needle for k in range(8)][-1]
    assert T is not None
    assert np.degrees(np.arccos(T[:3, 2] @ truth[:3, 2])) < 0.4  # 0.7 and 0.5 if the point counts


def test_a_needle_that_is_never_seen_is_searched_on(eyes: StereoCalibration) -> None:
    rng, tracker = np.random.default_rng(5), NeedleTracker(eyes, NEEDLE)
    for k in range(3):
        found = tracker.update(k / 30.0, *drawn(eyes, None, rng))
        assert found.status == "searching" and found.T_left_needle is None
        assert np.isinf(found.covariance).any() and np.isinf(found.position_sigma)
    truth = before_the_eyes()
    tracker.start(0.1, truth, np.diag([1e-7] * 3 + [0.003] * 3))
    assert tracker.update(0.2, *drawn(eyes, None, rng)).status == "predicting"
    assert tracker.update(2.3, *drawn(eyes, None, rng)).status == "searching"


def test_a_needle_that_leaves_the_view_is_carried_on_with_growing_doubt(
    eyes: StereoCalibration,
) -> None:
    rng, truth, tracker = np.random.default_rng(8), before_the_eyes(), NeedleTracker(eyes, NEEDLE)
    tracker.start(-1.0, truth, np.diag([1e-7] * 3 + [0.003] * 3))
    sigmas: list[float] = []
    for k in range(6):
        T = moved(truth, np.array([0.08 if k > 1 else 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        holder = Holder("PSM1", T)
        found = tracker.update(k / 30.0, *drawn(eyes, None if k > 1 else T, rng), holder)
        assert found.status == ("predicting" if k > 1 else "tracking")
        sigmas.append(found.position_sigma)
    assert (np.diff(sigmas[1:]) > 0.0).all()


def test_images_that_cannot_be_used_are_rejected(eyes: StereoCalibration) -> None:
    rng, tracker = np.random.default_rng(6), NeedleTracker(eyes, NEEDLE)
    left, right = drawn(eyes, before_the_eyes(), rng)
    with pytest.raises(InputError, match=r"left image: got 390x300; allowed: 400x300"):
        tracker.update(0.0, left[:, :-10], right)
    with pytest.raises(InputError, match=r"right image: got float64 .*allowed: uint8"):
        tracker.update(0.0, left, right.astype(float))
    tracker.update(0.1, left, right)
    with pytest.raises(InputError, match=r"got 0.05 s after 0.1 s; allowed: in order"):
        tracker.update(0.05, left, right)


def test_poses_times_and_covariances_that_are_none_are_rejected(eyes: StereoCalibration) -> None:
    tracker, image = NeedleTracker(eyes, NEEDLE), np.full((300, 400, 3), 90, np.uint8)
    with pytest.raises(
        InputError, match=r"time of the images \[s\]: got 'soon'; allowed: a finite"
    ):
        tracker.update("soon", image, image)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="left image: got object"):
        tracker.update(0.0, [[1], [2, 3]], image)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match=r"T_left_holder of PSM1: got .*nan.*4 x 4 finite numbers"):
        Holder("PSM1", np.full((4, 4), np.nan), 0.0085)
    with pytest.raises(InputError, match=r"reach of PSM1 \[m\]: got nan"):
        Holder("PSM1", np.eye(4), np.nan)
    with pytest.raises(InputError, match=r"covariance: got .*; allowed: 6 x 6 finite numbers"):
        tracker.start(0.0, np.eye(4), np.eye(3))
    with pytest.raises(InputError, match=r"covariance: .*symmetric with positive eigenvalues"):
        tracker.start(0.0, np.eye(4), -np.eye(6))


def test_exchanged_eyes_are_named(eyes: StereoCalibration) -> None:
    rng, tracker = np.random.default_rng(7), NeedleTracker(eyes, NEEDLE)
    left, right = drawn(eyes, before_the_eyes(), rng)
    with pytest.raises(InputError, match=r"disparity -.* are the eyes exchanged"):
        tracker.update(0.0, right, left)
