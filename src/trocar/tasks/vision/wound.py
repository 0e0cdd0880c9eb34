"""A wound's edges from both eyes, as polylines in space with covariance.

A wound is a dark gap in paler tissue, near a rough guess of its line. Profiles of red light across
it show both edges as steps in the left image. Their depth is that of the tissue about them, a
smooth surface through the disparities of both images: edges that run along the baseline have no
disparity of their own.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import StereoCalibration
from trocar.cameras.rectification import rectified
from trocar.errors import InputError
from trocar.geometry import transform_points
from trocar.inputs import check_numbers, check_whole
from trocar.tasks.vision.eyes import Eyes, checked_pose
from trocar.tasks.vision.images import between, opencv

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

#: Standard deviations of a step's place and of the surface's disparity beside what its fit says
#: [px]. Source: measured on images of a plane; StereoSGBM is 0.1 px off between whole disparities.
SIGMA_PX, SURFACE_PX = 0.3, 0.15
#: Spacing of a profile's samples [px], and the least contrast of a step as a share of the profile's
#: brightness. Source: our own choice.
STEP_PX, CONTRAST = 0.5, 0.12
#: Least share of the profiles that must show both edges, and of the pixels that must have a
#: disparity. Source: our own choice.
SHARE, MATCHED = 0.3, 0.05
#: Widest search and most profiles. Source: our own choice. [m]
WIDEST_M, MOST_PROFILES = 0.05, 1000
#: Edge of the squares that are compared [px]; disparities of one square are one measurement.
#: Source: OpenCV's StereoSGBM, "normally 3 to 11".
BLOCK = 9


class Edge(NamedTuple):
    """Points along an edge, (n, 3) [m], and the covariance of each, (n, 3, 3) [m^2]."""

    points: Array
    covariance: Array


class Wound(NamedTuple):
    """Both edges, point by point opposite each other, and the line midway."""

    edges: tuple[Edge, Edge]
    middle: Edge


def find_wound(
    calibration: StereoCalibration,
    left: ArrayLike,
    right: ArrayLike,
    guess: ArrayLike,
    *,
    half_width: float = 0.006,
    count: int = 24,
    T_world_left: ArrayLike | None = None,
) -> Wound:
    """Return the edges of a wound.

    Args:
        calibration: of both eyes
        left, right: images, (h, w, 3)
        guess: the wound's line, roughly, (k, 3) in the frame of the result [m]
        half_width: how far from the guess edges are looked for [m]
        count: of profiles along the guess
        T_world_left: left eye's pose in the frame of the guess and the result; the left eye's own
            frame when omitted, (4, 4)

    Raises:
        InputError: images of another size, a guess that is no line ahead of the eyes, tissue in
            which both images have nothing in common, or a wound that too few profiles show
    """
    eyes = Eyes(calibration)
    images = eyes.check(left, right)
    pose = np.eye(4) if T_world_left is None else checked_pose(T_world_left, "T_world_left")
    line = check_numbers(guess, (-1, 3), "guess [m]")
    if not np.ptp(line, axis=0).any():
        raise InputError(f"guess [m]: got {line.tolist()}; allowed: two points or more")
    check_numbers(half_width, (), "half_width [m]", 0.0, WIDEST_M)
    check_whole(count, "count", 3, MOST_PROFILES)
    line = (line - pose[:3, 3]) @ pose[:3, :3]
    if (line[:, 2] <= 0.01).any():
        raise InputError("guess: lies behind the eyes; allowed: points ahead of both")
    turns = rectified(calibration)
    P, flat = turns[0].P, [_rectified(eyes, images[k], turns[k].R, turns[k].P, k) for k in range(2)]
    R, f, base = turns[0].R, float(P[0, 0]), -float(turns[1].P[0, 3] / turns[1].P[0, 0])
    ahead = line @ R.T
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ahead, axis=0), axis=1))])
    places = np.linspace(0.0, float(way[-1]), count)
    points = np.stack([cast(Array, np.interp(places, way, axis)) for axis in ahead.T], axis=1)
    pixels = points[:, :2] / points[:, 2:] * f + P[:2, 2]
    reach = half_width * f / points[:, 2]
    surface = _surface(flat[0], flat[1], pixels, float(reach.max()), f * base / points[:, 2])
    found: list[tuple[Array, Array]] = []
    along = np.gradient(pixels, axis=0)
    for pixel, tangent, limit in zip(pixels, along, reach, strict=True):
        way_ahead = np.asarray(tangent / max(float(np.linalg.norm(tangent)), 1e-9), np.float64)
        steps = _steps(flat[0], pixel, way_ahead, float(limit))
        if steps is not None:
            found.append(steps)
    least = max(3, round(SHARE * count))
    if len(found) < least:
        raise InputError(
            f"wound: {len(found)} of {count} profiles show both edges; allowed: {least} or more. Is"
            " the guess near it, and the wound darker than the tissue?"
        )
    T = pose.copy()
    T[:3, :3] = pose[:3, :3] @ R.T
    one, other = (
        _placed(np.array([steps[side] for steps in found]), surface, P, base, T) for side in (0, 1)
    )
    middle = Edge(0.5 * (one.points + other.points), 0.25 * (one.covariance + other.covariance))
    return Wound((one, other), middle)


class _DisparitySurface(NamedTuple):
    """Disparity as a polynomial of pixels about a middle, and its covariance."""

    middle: Array
    scale: float
    factors: Array
    covariance: Array

    def at(self, pixels: Array) -> tuple[Array, Array, Array]:
        """Return disparities (n,), their slopes (n, 2) and variances (n,)."""
        rows = _terms((pixels - self.middle) / self.scale)
        step = self.scale * 1e-3
        slopes = [
            (_terms((pixels + step * d - self.middle) / self.scale) - rows) @ self.factors / step
            for d in np.eye(2)
        ]
        spread = np.einsum("ni,ij,nj->n", rows, self.covariance, rows) + SURFACE_PX**2
        return rows @ self.factors, np.stack(slopes, axis=1), spread


def _terms(x: Array) -> Array:
    u, v = x[:, 0], x[:, 1]
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


def _rectified(eyes: Eyes, image: NDArray[np.uint8], R: Array, P: Array, eye: int) -> Floats:
    """Return red light where rows of both eyes agree, (h, w)."""
    width, height = eyes.size
    v, u = np.mgrid[:height, :width]
    rays = np.stack([(u - P[0, 2]) / P[0, 0], (v - P[1, 2]) / P[1, 1], np.ones(u.shape)], axis=-1)
    own = (rays @ R).reshape(-1, 3)
    T = eyes.T_eye_left[eye]
    pixels = eyes.project((own - T[:3, 3]) @ T[:3, :3], eye)
    return between(image[..., 0].astype(np.float32), pixels.reshape(height, width, 2))


def _surface(
    left: Floats, right: Floats, pixels: Array, reach: float, expected: Array
) -> _DisparitySurface:
    """Return the tissue's disparities about a line of pixels, (n, 2), fitted robustly.

    Raises:
        InputError: too few pixels have one
    """
    cv2 = opencv()
    height, width = left.shape
    margin = 3.0 * reach + BLOCK
    low = np.clip(np.floor(pixels.min(axis=0) - margin), 0, (width - 2, height - 2)).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0) + margin), low + 2, (width, height)).astype(int)
    least = int(max(0.6 * expected.min(), 0.0))
    span = 16 * int(np.ceil((1.6 * expected.max() - least) / 16.0))
    # The matcher leaves out the first columns; it gets those to the left as well.
    start = max(low[0] - least - span, 0)
    parts = [
        np.clip(cv2.GaussianBlur(i[low[1] : high[1], start : high[0]], (0, 0), 1.0), 0, 255)
        for i in (left, right)
    ]
    matcher = cv2.StereoSGBM_create(
        minDisparity=least, numDisparities=span, blockSize=BLOCK, P1=8 * BLOCK**2,
        P2=32 * BLOCK**2, uniquenessRatio=5, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    disparity = matcher.compute(*(part.astype(np.uint8) for part in parts)) / 16.0
    v, u = np.nonzero(disparity > least)
    d = disparity[v, u]
    at = np.stack([u + start, v + low[1]], axis=1).astype(np.float64)
    area = (high - low).prod()
    if len(d) < max(MATCHED * area, 60):
        raise InputError(
            f"wound: {len(d)} of {area} pixels about the guess look alike in both images; allowed:"
            f" {MATCHED:.0%}. Are the images of one moment, and is the tissue in view?"
        )
    middle, scale = at.mean(axis=0), float(np.abs(at - at.mean(axis=0)).max())
    rows = _terms((at - middle) / scale)
    weight = np.ones(len(d))
    factors, spread = np.zeros(6), 1.0
    for _ in range(8):
        matrix = (rows * weight[:, None]).T @ rows + 1e-9 * np.eye(6)
        factors = np.asarray(np.linalg.solve(matrix, (rows * weight[:, None]).T @ d), np.float64)
        rest = np.abs(d - rows @ factors)
        spread = max(1.4826 * float(np.median(rest)), 0.02)
        weight = np.where(rest < 3.0 * spread, 1.0, (3.0 * spread / np.maximum(rest, 1e-9)) ** 2)
    matrix = (rows * weight[:, None]).T @ rows + 1e-9 * np.eye(6)
    covariance = np.asarray(np.linalg.inv(matrix), np.float64)
    covariance *= spread**2 * BLOCK**2
    return _DisparitySurface(middle, scale, factors, covariance)


def _steps(red: Floats, pixel: Array, tangent: Array, reach: float) -> tuple[Array, Array] | None:
    """Return pixels of both edges on a profile across a line, None where it shows none."""
    normal = np.array([tangent[1], -tangent[0]])
    places = np.arange(-reach, reach + STEP_PX, STEP_PX)
    lanes = np.linspace(-3.0, 3.0, 7)
    at = pixel + places[:, None, None] * normal + lanes[None, :, None] * tangent
    values = between(red, at).astype(np.float64).mean(axis=1)
    kernel = np.exp(-0.5 * (np.arange(-6, 7) / 2.5) ** 2)
    smooth = np.convolve(np.pad(values, 6, mode="edge"), kernel / kernel.sum(), mode="valid")
    slope = np.gradient(smooth, places)
    inner = np.arange(1, len(slope) - 1)
    falls = inner[(slope[1:-1] < 0) & (slope[1:-1] <= np.minimum(slope[:-2], slope[2:]))]
    rises = inner[(slope[1:-1] > 0) & (slope[1:-1] >= np.maximum(slope[:-2], slope[2:]))]
    best, pair = 0.0, None
    for fall in falls:
        for rise in rises[rises > fall]:
            depth = min(smooth[max(fall - 6, 0)], smooth[min(rise + 6, len(smooth) - 1)])
            depth -= smooth[fall : rise + 1].min()
            score = min(-slope[fall], slope[rise])
            if depth > CONTRAST * np.median(smooth) and score > best:
                best, pair = score, (int(fall), int(rise))
    if pair is None:
        return None
    one, other = _peak(-slope, pair[0], places), _peak(slope, pair[1], places)
    return pixel + one * normal, pixel + other * normal


def _peak(values: Array, k: int, places: Array) -> float:
    a, b, c = values[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return float(places[k] + STEP_PX * (0.5 * (a - c) / bend if bend < 0.0 else 0.0))


def _placed(pixels: Array, surface: _DisparitySurface, P: Array, base: float, T: Array) -> Edge:
    """Return pixels of the rectified left image on the surface, in the frame that T leads to."""
    disparity, slopes, spread = surface.at(pixels)
    flat = np.concatenate([(pixels - P[:2, 2]) / P[0, 0], np.ones((len(pixels), 1))], axis=1)
    depth = P[0, 0] * base / disparity
    points = depth[:, None] * flat
    by_disparity = -points / disparity[:, None]
    by_pixel = np.zeros((len(pixels), 3, 2))
    by_pixel[:, 0, 0] = by_pixel[:, 1, 1] = depth / P[0, 0]
    by_pixel += by_disparity[:, :, None] * slopes[:, None, :]
    covariance = SIGMA_PX**2 * by_pixel @ by_pixel.swapaxes(1, 2)
    covariance += spread[:, None, None] * by_disparity[:, :, None] * by_disparity[:, None, :]
    return Edge(transform_points(T, points), T[:3, :3] @ covariance @ T[:3, :3].T)
