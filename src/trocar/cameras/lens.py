"""Projection of points to pixels and back, with OpenCV's distortion.

A point (x, y, 1) in a camera's frame (x right, y down, z ahead) lands at K (x', y', 1) with

    x' = x g + 2 p1 x y + p2 (r^2 + 2 x^2),    y' = y g + p1 (r^2 + 2 y^2) + 2 p2 x y,
    g = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6),    r^2 = x^2 + y^2.

The middle of the upper left pixel is (0, 0), so a picture reaches from -1/2 to width - 1/2.
Coefficients are in OpenCV's order (k1, k2, p1, p2, k3, k4, k5, k6); what is left out is 0. ROS
calls the first five plumb_bob and all eight rational_polynomial.

Source: OpenCV 4, "Camera Calibration and 3D Reconstruction"; ROS, sensor_msgs/CameraInfo.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, SingularError

Array = NDArray[np.float64]

#: Allowed numbers of coefficients. Source: OpenCV; 12 and 14 would be thin prisms and tilt.
COUNTS = (0, 4, 5, 8)
#: Distorted points are followed from the middle outwards in so many steps, so that the inverse
#: stays on the branch that the middle lies on; the finer to look for folds. Source: our own choice.
STEPS, FINE_STEPS = 8, 64
#: Newton's steps at each of these, and at the last. Source: they square the error, which begins
#: below a tenth; six leave rounding.
ITERATIONS, LAST_ITERATIONS = 3, 8
#: An inverse is right to this, in focal lengths. Source: our own choice; a millionth of a pixel.
TOLERANCE = 1e-9
#: Points on each side of a picture's edge. Source: our own choice.
EDGE_POINTS = 33


def check_distortion(coefficients: ArrayLike) -> Array:
    """Return distortion coefficients as eight numbers, zeros appended.

    Args:
        coefficients: none, 4, 5 or 8, or more where what follows is 0

    Raises:
        InputError: another number of them, or one that is not finite
    """
    given = np.asarray(coefficients, dtype=np.float64).ravel()
    if not np.isfinite(given).all():
        raise InputError(f"distortion: got {given.tolist()}; allowed: finite numbers")
    if given.size > 8 and not given[8:].any():
        given = given[:8]
    if given.size not in COUNTS:
        raise InputError(
            f"distortion: got {given.size} coefficients; allowed: none, 4, 5 or 8 (k1 k2 p1 p2 k3"
            " k4 k5 k6)"
        )
    return np.concatenate([given, np.zeros(8 - given.size)])


def distort(points: ArrayLike, coefficients: ArrayLike) -> Array:
    """Distort points of the plane z = 1 as a lens does.

    Args:
        points: (..., 2)
        coefficients: as for `check_distortion`

    Returns:
        (..., 2)
    """
    xy, c = np.asarray(points, dtype=np.float64), check_distortion(coefficients)
    return _distorted(xy, c) if c.any() else xy.copy()


def distortion_jacobian(points: ArrayLike, coefficients: ArrayLike) -> Array:
    """Return d distort / d points, (..., 2, 2), of points (..., 2) of the plane z = 1."""
    return _jacobian(np.asarray(points, dtype=np.float64), check_distortion(coefficients))


def distort_with_jacobian(points: Array, coefficients: Array) -> tuple[Array, Array]:
    """Distort points (..., 2) of the plane z = 1; return them and the derivative (..., 2, 2).

    Args:
        points: (..., 2)
        coefficients: as `check_distortion` returns them, first axis of 8; further axes are those of
            the points, so that each may have a lens of its own
    """
    return _distorted(points, coefficients), _jacobian(points, coefficients)


def undistort(points: ArrayLike, coefficients: ArrayLike) -> Array:
    """Return the points of the plane z = 1 that a lens moves to these; undoes `distort`.

    Args:
        points: (..., 2)
        coefficients: as for `check_distortion`

    Returns:
        (..., 2)

    Raises:
        SingularError: the image folds before it reaches a point, so that nothing lands there
    """
    target, c = np.asarray(points, dtype=np.float64), check_distortion(coefficients)
    if not c.any():
        return target.copy()
    found, reached = _followed(target.reshape(-1, 2), c, STEPS)
    if (reached < 1.0).any():
        first = target.reshape(-1, 2)[np.argmin(reached)]
        raise SingularError(
            f"distortion {c.tolist()}: the image folds before it reaches"
            f" ({first[0]:.4g}, {first[1]:.4g})"
        )
    return found.reshape(target.shape)


def project(points: ArrayLike, K: ArrayLike, coefficients: ArrayLike = ()) -> Array:
    """Return the pixels that points ahead of a camera land on.

    Args:
        points: in the camera's frame, (..., 3) [m]; NaN comes of those that are not ahead of it
        K: (3, 3) [px]
        coefficients: as for `check_distortion`

    Returns:
        (..., 2) [px]
    """
    p, k = np.asarray(points, dtype=np.float64), np.asarray(K, dtype=np.float64)
    depth = np.where(p[..., 2:] > 0.0, p[..., 2:], np.nan)
    return pixels_from_plane(distort(p[..., :2] / depth, coefficients), k)


def pixels_from_plane(points: ArrayLike, K: ArrayLike) -> Array:
    """Return the pixels of (distorted) points of the plane z = 1, (..., 2) [px]."""
    xy, k = np.asarray(points, dtype=np.float64), np.asarray(K, dtype=np.float64)
    return xy @ k[:2, :2].T + k[:2, 2]


def plane_from_pixels(pixels: ArrayLike, K: ArrayLike) -> Array:
    """Return the (distorted) points of the plane z = 1 of pixels, (..., 2)."""
    uv, k = np.asarray(pixels, dtype=np.float64), np.asarray(K, dtype=np.float64)
    return (uv - k[:2, 2]) @ np.linalg.inv(k[:2, :2]).T


def edge_pixels(width: int, height: int) -> Array:
    """Return points all along the outer edge of a picture, (n, 2) [px]."""
    across = np.linspace(-0.5, width - 0.5, EDGE_POINTS)
    down = np.linspace(-0.5, height - 0.5, EDGE_POINTS)
    sides = [(across, -0.5), (across, height - 0.5), (-0.5, down), (width - 0.5, down)]
    return np.concatenate([np.stack(np.broadcast_arrays(u, v), axis=-1) for u, v in sides])


def view_bounds(
    K: ArrayLike, width: int, height: int, coefficients: ArrayLike = ()
) -> tuple[float, float, float, float]:
    """Return a box about what a picture shows of the plane z = 1: left, right, top, bottom.

    Raises:
        SingularError: the distortion folds the image inside the view
    """
    seen = undistort(plane_from_pixels(edge_pixels(width, height), K), coefficients)
    (left, top), (right, bottom) = seen.min(axis=0), seen.max(axis=0)
    return float(left), float(right), float(top), float(bottom)


def fold_in_view(
    K: ArrayLike, width: int, height: int, coefficients: ArrayLike
) -> tuple[float, float] | None:
    """Return a pixel at which the distortion folds the image, None where it does not in the view.

    Where it folds, two points of the scene land on one pixel, or none lands beyond.

    Args:
        K: (3, 3) [px], its principal point inside the picture
        width, height: [px]
        coefficients: as for `check_distortion`
    """
    c = check_distortion(coefficients)
    if not c.any():
        return None
    edge = plane_from_pixels(edge_pixels(width, height), K)
    _, reached = _followed(edge, c, FINE_STEPS)
    if (reached == 1.0).all():
        return None
    nearest = int(np.argmin(reached))
    u, v = pixels_from_plane(reached[nearest] * edge[nearest], K)
    return float(u), float(v)


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what is not finite has folded
def _followed(target: Array, c: Array, steps: int) -> tuple[Array, Array]:
    """Follow points from the middle out to these, (n, 2).

    Returns:
        the points that are distorted to `target` (n, 2), and the share of the way (n,) that each
        came without a fold: 1 for all of it
    """
    found, reached = np.zeros_like(target), np.ones(len(target))
    going = np.ones(len(target), dtype=np.bool_)
    for step in range(1, steps + 1):
        goal = target * (step / steps)
        found = found * (step / max(step - 1, 1))
        for _ in range(ITERATIONS if step < steps else LAST_ITERATIONS):
            J = _jacobian(found, c)
            det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
            lost = going & ~(det > 0.0)
            reached[lost], going = (step - 1) / steps, going & ~lost
            miss = goal - _distorted(found, c)
            safe = np.where(going, det, 1.0)
            dx = (J[:, 1, 1] * miss[:, 0] - J[:, 0, 1] * miss[:, 1]) / safe
            dy = (J[:, 0, 0] * miss[:, 1] - J[:, 1, 0] * miss[:, 0]) / safe
            found = np.where(going[:, None], found + np.stack([dx, dy], axis=-1), 0.0)
    off = np.abs(target - _distorted(found, c)).max(axis=-1)
    allowed = TOLERANCE * (1.0 + np.abs(target).max(axis=-1))
    reached[going & ~(off <= allowed)] = (steps - 1) / steps
    return found, reached


def _factors(r2: Array, c: Array) -> tuple[Array, Array]:
    """Return the radial factor g and dg / d(r^2)."""
    k1, k2, _, _, k3, k4, k5, k6 = c
    above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    rise = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    fall = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6)
    g = above / below
    return g, (rise - g * fall) / below


def _distorted(xy: Array, c: Array) -> Array:
    p1, p2 = c[2], c[3]
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    g, _ = _factors(r2, c)
    moved_x = x * g + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    moved_y = y * g + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.stack([moved_x, moved_y], axis=-1)


def _jacobian(xy: Array, c: Array) -> Array:
    """Return d distort / d (x, y), (..., 2, 2)."""
    p1, p2 = c[2], c[3]
    x, y = xy[..., 0], xy[..., 1]
    g, slope = _factors(x * x + y * y, c)
    cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    across = g + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    down = g + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return np.stack([np.stack([across, cross], axis=-1), np.stack([cross, down], axis=-1)], axis=-2)
