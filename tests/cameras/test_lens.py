"""What a lens does agrees with OpenCV, is undone by its inverse, and folds are found."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.cameras.lens import (
    check_distortion,
    distort,
    edge_pixels,
    fold_in_view,
    pixels_from_plane,
    plane_from_pixels,
    project,
    undistort,
    view_bounds,
)
from trocar.errors import InputError, SingularError

K = np.array([[588.776, 0.0, 325.305], [0.0, 589.725, 251.666], [0.0, 0.0, 1.0]])
SIZE = (640, 480)
LENSES = {
    "none": (),
    "barrel": (-0.38, 0.15, 0.001, -0.002),
    "barrel and more": (-0.33, 0.12, 0.002, -0.001, 0.01),
    "cushion": (0.25, -0.1, -0.001, 0.0005, 0.03),
    "rational": (0.5, -0.3, 0.001, 0.0005, 0.02, 0.7, -0.1, 0.03),
}
EACH_LENS = pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)


def points(n: int = 400) -> np.ndarray:
    """Points that the camera sees, 20 to 300 mm ahead of it."""
    rng = np.random.default_rng(1)
    plane = np.stack([rng.uniform(-0.5, 0.5, n), rng.uniform(-0.4, 0.4, n), np.ones(n)], axis=1)
    return plane * rng.uniform(0.02, 0.3, (n, 1))


@EACH_LENS
def test_points_land_where_opencv_says(lens: tuple[float, ...]) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is the judge here")
    seen = points()
    coefficients = np.array(lens) if lens else None
    judged, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), K, coefficients)
    # Both compute in float64; 0.05 px is what is asked for.
    np.testing.assert_allclose(project(seen, K, lens), judged[:, 0], atol=1e-9)


@EACH_LENS
def test_the_inverse_undoes_the_lens_everywhere_in_the_view(lens: tuple[float, ...]) -> None:
    across, down = np.meshgrid(np.linspace(-0.5, 639.5, 41), np.linspace(-0.5, 479.5, 31))
    pixels = np.stack([across, down], axis=-1)
    seen = undistort(plane_from_pixels(pixels, K), lens)
    np.testing.assert_allclose(pixels_from_plane(distort(seen, lens), K), pixels, atol=1e-6)
    plane = points()[:, :2] / points()[:, 2:]
    np.testing.assert_allclose(undistort(distort(plane, lens), lens), plane, atol=1e-9)


@EACH_LENS
def test_the_bounds_hold_all_that_is_seen_and_no_more(lens: tuple[float, ...]) -> None:
    left, right, top, bottom = view_bounds(K, *SIZE, lens)
    assert left < 0.0 < right and top < 0.0 < bottom
    edge = undistort(plane_from_pixels(edge_pixels(*SIZE), K), lens)
    assert edge[:, 0].min() == left and edge[:, 1].max() == bottom


def test_a_barrel_shows_more_than_a_pinhole() -> None:
    pinhole, barrel = view_bounds(K, *SIZE), view_bounds(K, *SIZE, LENSES["barrel"])
    assert barrel[0] < pinhole[0] and barrel[1] > pinhole[1]


def test_what_is_not_ahead_lands_nowhere() -> None:
    found = project([[0.0, 0.0, 0.1], [0.0, 0.0, 0.0], [0.0, 0.0, -0.1]], K)
    np.testing.assert_allclose(found[0], K[:2, 2])
    assert np.isnan(found[1:]).all()


@pytest.mark.parametrize("k1", [-0.9, -1.5])
def test_a_fold_is_where_the_radius_stops_growing(k1: float) -> None:
    # d(r + k1 r^3) / dr = 0 at r = 1 / sqrt(-3 k1), which lands at 2/3 of it.
    pixel = fold_in_view(K, *SIZE, (k1, 0.0, 0.0, 0.0))
    assert pixel is not None
    radius = float(np.linalg.norm(plane_from_pixels(pixel, K)))
    # Looked for in 64 steps to the corner, whose radius is below 0.7.
    assert radius == pytest.approx(2.0 / 3.0 / np.sqrt(-3.0 * k1), abs=0.7 / 64)


@EACH_LENS
def test_good_lenses_fold_nowhere_in_the_view(lens: tuple[float, ...]) -> None:
    assert fold_in_view(K, *SIZE, lens) is None


@pytest.mark.parametrize("lens", [(1e308, 0, 0, 0), (0, 0, 0, 0, 0, -8.0, 0, 1e300)])
def test_coefficients_without_measure_fold(lens: tuple[float, ...]) -> None:
    assert fold_in_view(K, *SIZE, lens) is not None


def test_a_fold_outside_the_view_is_none_of_its_business() -> None:
    assert fold_in_view(K, *SIZE, (-0.9, 0.0, 0.0, 0.0)) is not None
    narrow = np.diag([4.0, 4.0, 1.0]) @ K
    narrow[:2, 2] = K[:2, 2]
    assert fold_in_view(narrow, *SIZE, (-0.9, 0.0, 0.0, 0.0)) is None


def test_the_inverse_says_where_nothing_lands() -> None:
    with pytest.raises(SingularError, match=r"folds before it reaches \(0\.9, 0\)"):
        undistort([[0.1, 0.0], [0.9, 0.0]], (-0.9, 0.0, 0.0, 0.0))


def test_coefficients_are_counted() -> None:
    np.testing.assert_array_equal(check_distortion([1.0, 2.0, 3.0, 4.0]), [1, 2, 3, 4, 0, 0, 0, 0])
    assert check_distortion(np.zeros((1, 14))).shape == (8,)
    for wrong in ([0.1], [0.1] * 6, [0.0] * 11 + [0.1]):
        with pytest.raises(InputError, match="allowed: none, 4, 5 or 8"):
            check_distortion(wrong)
    with pytest.raises(InputError, match="allowed: finite numbers"):
        check_distortion([np.nan, 0.0, 0.0, 0.0])
