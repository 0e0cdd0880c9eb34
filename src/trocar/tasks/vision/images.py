"""Bright lines and values between pixels; with `overlay` and `streams` the home of OpenCV here."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.errors import MissingExtraError

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

#: Largest distance of a line point from its pixel's middle. Source: Steger 1998, with slack. [px]
SUBPIXEL = 0.6


def opencv() -> Any:
    """Return OpenCV.

    Raises:
        MissingExtraError: the extra `vision` is not installed
    """
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("cv2", "vision", "looking at pictures") from error
    return cv2


class Lines(NamedTuple):
    """Points of bright lines: pixels (n, 2), directions modulo pi (n,), their pixels' (u, v)."""

    points: Array
    angles: Array
    columns: NDArray[np.int64]
    rows: NDArray[np.int64]


def metal(image: Picture) -> Floats:
    """Return (G + B - R) / 2, (h, w): half the brightness of grey things, about 0 on tissue."""
    f = image.astype(np.float32)
    return 0.5 * (f[..., 1] + f[..., 2] - f[..., 0])


def bright_lines(values: Floats, sigma: float, share: float, least: int) -> Lines:
    """Return sub-pixel points of bright lines.

    Source: Steger, "An unbiased detector of curvilinear structures", 1998.

    Args:
        values: one channel, (h, w)
        sigma: of the smoothing [px]; half the lines' width over sqrt 3
        share: of the pixels that are strongest
        least: pixels of a connected line, at least
    """
    cv2 = opencv()
    g = cv2.GaussianBlur(values, (0, 0), sigma)
    dx, dy = (cv2.Sobel(g, cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1)))
    dxx = cv2.filter2D(g, -1, np.array([[1, -2, 1]], np.float32))
    dyy = cv2.filter2D(g, -1, np.array([[1], [-2], [1]], np.float32))
    cross = np.array([[0.25, 0, -0.25], [0, 0, 0], [-0.25, 0, 0.25]], np.float32)
    dxy = cv2.filter2D(g, -1, cross)
    least_curved = 0.5 * (dxx + dyy) - np.sqrt((0.5 * (dxx - dyy)) ** 2 + dxy * dxy)
    strength = -least_curved
    threshold = max(float(np.quantile(strength[::4, ::4], 1.0 - share)), 1e-3)
    v, u = np.nonzero(strength > threshold)
    a, b, c, low = dxx[v, u], dxy[v, u], dyy[v, u], least_curved[v, u]
    one, other = np.stack([b, low - a]), np.stack([low - c, b])
    across = np.where((other**2).sum(0) > (one**2).sum(0), other, one).astype(np.float64)
    across /= np.linalg.norm(across, axis=0) + 1e-12
    nx, ny = across
    t = -(dx[v, u] * nx + dy[v, u] * ny) / (a * nx * nx + 2 * b * nx * ny + c * ny * ny)
    near = (np.abs(t * nx) <= SUBPIXEL) & (np.abs(t * ny) <= SUBPIXEL)
    u, v, t, nx, ny = u[near], v[near], t[near], nx[near], ny[near]
    mask = np.zeros(values.shape, np.uint8)
    mask[v, u] = 1
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    long = stats[labels[v, u], cv2.CC_STAT_AREA] >= least
    points = np.stack([u + t * nx, v + t * ny], axis=1)
    return Lines(points[long], np.arctan2(nx, -ny)[long] % np.pi, u[long], v[long])


def distances(lines: Lines, shape: tuple[int, int]) -> Floats:
    """Return the distance of every pixel to the nearest line point, (h, w) [px]."""
    cv2 = opencv()
    there = np.full(shape, 255, np.uint8)
    there[lines.rows, lines.columns] = 0
    return cv2.distanceTransform(there, cv2.DIST_L2, 3)


def between(image: NDArray[Any], pixels: Array) -> NDArray[Any]:
    """Return values at pixels (..., 2), interpolated; beyond the edge those of the edge."""
    cv2 = opencv()
    at = pixels.reshape(len(pixels), -1, 2).astype(np.float32)
    found = cv2.remap(image, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(*pixels.shape[:-1], *image.shape[2:])


def filtered_rows(values: Floats, kernel: Array) -> Floats:
    """Return each row of values (n, k) correlated with a kernel of odd length, (n, k)."""
    cv2 = opencv()
    return cv2.filter2D(
        values, -1, kernel[None].astype(np.float32), borderType=cv2.BORDER_REPLICATE
    )


def smoothed_columns(values: Floats, count: int) -> Floats:
    """Return means of `count` rows, (n, k)."""
    cv2 = opencv()
    return cv2.blur(values, (1, count), borderType=cv2.BORDER_REPLICATE)


def weighed(image: Picture, weights: Array, offset: float) -> Floats:
    """Return weights (3,) times colours plus an offset, (h, w)."""
    row = np.append(weights, offset).astype(np.float32)[None]
    return opencv().transform(image.astype(np.float32), row)
