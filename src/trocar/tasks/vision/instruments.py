"""Tips of instruments in both eyes' images, without markers; and coloured markers.

Without markers the image that kinematics predicts is rendered, and its edges about the tip are
registered to those of the real one by their directions, as doubled angles weighted by strength.
Both eyes share one shift along rows and columns and one disparity, so that a fix in the left image
that the right one contradicts is not taken. Source: doubled angles: Granlund 1978; the rest:
prototypes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import StereoCalibration
from trocar.errors import InputError, UnknownNameError
from trocar.inputs import check_numbers, check_type
from trocar.rendering import StereoFrame
from trocar.tasks.vision.eyes import Eyes, checked_image
from trocar.tasks.vision.images import opencv

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

#: Radius that is compared about the tip, and the largest error of its prediction [m]. Source: an
#: instrument's wrist and jaws, and hand-eye errors of 3 mm.
AROUND_M, OFF_M = 0.011, 0.0065
#: Largest error of the depth [m]. Source: as above.
DEPTH_M = 0.0045
#: Gradients below this are noise, smoothed by this [grey levels a pixel, px]. Source: prototypes.
FLOOR, SMOOTH = 4.0, 1.6
#: Weight of edges inside the outline. Source: prototypes.
INNER = 0.4
#: Least share of the prediction's edges that the image has. Source: our own choice.
LEAST = 0.15
#: A marker: least difference of its pixels from grey [grey levels], the same by the clearest
#: pixel, ratio of the difference in its own direction to that across, least number of pixels, and
#: largest disagreement of both eyes on its place [px]. Source: our own choice.
PALE, CLEAR, PURE, LEAST_PX, APART_PX = 12.0, 0.5, 1.5, 12, 3.0
#: Parts of an instrument that are compared.
PARTS = ("wrist_pitch", "wrist_yaw", "finger_left", "finger_right")


class TipFix(NamedTuple):
    """A found tip: pixels in both eyes (2, 2), point in the left eye's frame (3,), score."""

    pixels: Array
    point: Array
    score: float


def instrument_masks(frame: StereoFrame, arm: str) -> list[NDArray[np.bool_]]:
    """Return the pixels of an arm's wrist and jaws in each eye of a rendered frame with ids.

    Raises:
        InputError: a frame without ids
        UnknownNameError: no such arm in it; the known ones are listed
    """
    ids_of_eyes = check_type(frame, StereoFrame, "frame").ids
    if ids_of_eyes is None:
        raise InputError("the predicted frame was rendered without ids; allowed: with ids = True")
    keys = [k for k, name in frame.names.items() if name in [f"{arm}/{part}" for part in PARTS]]
    if not keys:
        last = f"/{PARTS[-1]}"
        known = [name.removesuffix(last) for name in frame.names.values() if name.endswith(last)]
        raise UnknownNameError("instrument", arm, known, "the predicted frame")
    return [np.isin(ids, keys) for ids in ids_of_eyes]


def find_tip(
    calibration: StereoCalibration,
    left: ArrayLike,
    right: ArrayLike,
    predicted: Sequence[Picture],
    masks: Sequence[NDArray[np.bool_]],
    tip: ArrayLike,
) -> TipFix:
    """Find an instrument's tip in both eyes' images, near its place by kinematics.

    Args:
        calibration: of both eyes
        left, right: images
        predicted: both eyes' images, rendered with the instrument at its place by kinematics
        masks: the instrument's pixels in these, see `instrument_masks`
        tip: predicted, in the left eye's frame, (3,) [m]

    Raises:
        InputError: images of another size, a tip out of view, or an instrument that the images do
            not show
    """
    eyes = Eyes(calibration)
    images = eyes.check(left, right)
    at = check_numbers(tip, (3,), "tip [m]")
    if not at[2] > 0.01:
        raise InputError(f"tip: got {at.tolist()}; allowed: a point ahead of the eyes")
    scale = eyes.focal / float(at[2])
    around, slack = int(AROUND_M * scale), int(OFF_M * scale)
    for name, given in (("predicted", predicted), ("masks", masks)):
        if not isinstance(given, Sequence | np.ndarray) or len(given) != 2:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
            raise InputError(f"{name}: allowed: one image of each eye")
    predicted = [checked_image(one, eyes.size, "predicted image") for one in predicted]
    masks = [np.asarray(mask, np.bool_) for mask in masks]
    for mask in masks:
        if mask.shape[::-1] != eyes.size:
            raise InputError(f"mask: got shape {mask.shape}; allowed: {eyes.size[::-1]}")
    centres = [eyes.project(at[None], eye)[0] for eye in range(2)]
    maps: list[Floats] = []
    for eye in range(2):
        if not ((centres[eye] >= 0) & (centres[eye] < eyes.size)).all():
            raise InputError(f"tip: at {np.round(centres[eye])} px, out of the {eyes.size} images")
        maps.append(
            _agreement(images[eye], predicted[eye], masks[eye], centres[eye], around, slack)
        )
    baseline = float(np.linalg.norm(calibration.T_left_right[:3, 3]))
    most = int(np.ceil(DEPTH_M / at[2] * baseline * scale)) + 2
    best, place = -np.inf, (0, 0, 0)
    one, other = maps
    near = np.maximum(other, np.maximum(np.roll(other, 1, 0), np.roll(other, -1, 0)))
    width = one.shape[1]
    for disparity in range(-most, most + 1):
        low, high = max(0, -disparity), min(width, width - disparity)
        both = one[:, low:high] + near[:, low + disparity : high + disparity]
        row, column = np.unravel_index(int(both.argmax()), both.shape)
        if both[row, column] > best:
            best, place = float(both[row, column]), (int(row), int(column) + low, disparity)
    if 0.5 * best < LEAST:
        raise InputError(
            f"tip: the images have {0.5 * best:.2f} of the instrument's edges near where it is"
            f" predicted; allowed: {LEAST:g} or more. Is it in view?"
        )
    row, column, disparity = place
    shifts = [_peak(one, row, column) - slack, _peak(other, row, column + disparity) - slack]
    pixels = np.stack([centre + shift for centre, shift in zip(centres, shifts, strict=True)])
    return TipFix(pixels, eyes.triangulate(pixels[0], pixels[1]), 0.5 * best)


def find_marker(
    calibration: StereoCalibration, left: ArrayLike, right: ArrayLike, colour: ArrayLike
) -> TipFix:
    """Find the middle of a marker, such as a dot or band of paint on an instrument.

    Args:
        calibration: of both eyes
        left, right: images
        colour: of the marker, which nothing else of its size has: red, green, blue, 0 to 255

    Raises:
        InputError: images of another size, a grey colour, or images without the marker
    """
    eyes = Eyes(calibration)
    own = check_numbers(colour, (3,), "colour", 0, 255)
    own = own - own.mean()
    if not np.linalg.norm(own) > PALE:
        raise InputError(
            f"colour: got {np.asarray(colour).tolist()}; allowed: one that is not grey"
        )
    own /= np.linalg.norm(own)
    spots = [_spot(image, own) for image in eyes.check(left, right)]
    for name, spot in zip(("left", "right"), spots, strict=True):
        if spot is None:
            raise InputError(f"marker: the {name} image has nothing of its colour. Is it in view?")
    pixels = np.array([spot[0] for spot in spots if spot is not None])
    point = eyes.triangulate(pixels[0], pixels[1])
    apart = max(float(np.linalg.norm(eyes.project(point, k) - pixels[k])) for k in range(2))
    if apart > APART_PX:
        raise InputError(
            f"marker: the rays of both eyes miss each other by {apart:.1f} px; allowed: up to"
            f" {APART_PX:g}. Has something else its colour?"
        )
    return TipFix(pixels, point, min(spot[1] for spot in spots if spot is not None))


def _spot(image: Picture, own: Array) -> tuple[Array, float] | None:
    """Return the middle of the largest spot of a colour, and how pure its colour is."""
    cv2 = opencv()
    smooth = cv2.GaussianBlur(image, (0, 0), SMOOTH).astype(np.float32)
    beside = smooth - smooth.mean(axis=2, keepdims=True)
    along = beside @ own.astype(np.float32)
    across = np.sqrt(np.maximum((beside**2).sum(axis=2) - along**2, 0.0))
    there = (along > max(PALE, CLEAR * float(along.max()))) & (along > PURE * across)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(there.astype(np.uint8))
    if count < 2:
        return None
    best = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    if stats[best, cv2.CC_STAT_AREA] < LEAST_PX:
        return None
    v, u = np.nonzero(labels == best)
    pure = float((along[v, u] / np.hypot(along[v, u], across[v, u])).mean())
    return np.array([u.mean(), v.mean()]), pure


def _agreement(
    image: Picture,
    predicted: Picture,
    mask: NDArray[np.bool_],
    centre: Array,
    around: int,
    slack: int,
) -> Floats:
    """Return the share of predicted edges that agree, for shifts of up to `slack`, (n, n)."""
    cv2 = opencv()
    pad = around + slack + 4
    u, v = (int(c) + pad for c in centre)

    def part(values: NDArray[np.uint8], reach: int) -> NDArray[np.uint8]:
        wide = cv2.copyMakeBorder(values, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
        return np.asarray(wide[v - reach : v + reach, u - reach : u + reach])

    inside = part(mask.astype(np.uint8), around)
    if inside.sum() < 60:
        raise InputError("tip: the predicted image does not show the instrument near its tip")
    square = np.ones((5, 5), np.uint8)
    outline = cv2.morphologyEx(inside, cv2.MORPH_GRADIENT, square) > 0
    weight = np.where(outline, 1.0, INNER) * (cv2.dilate(inside, square) > 0)
    cosine, sine, strength = _directions(part(predicted, around))
    there = _directions(part(image, around + slack))
    found = sum(
        cv2.matchTemplate(values, (own * weight).astype(np.float32), cv2.TM_CCORR)
        for values, own in zip(there[:2], (cosine, sine), strict=True)
    )
    return np.asarray(found / max(float((weight * strength).sum()), 1e-6), np.float32)


def _directions(image: Picture) -> tuple[Floats, Floats, Floats]:
    """Return cosine and sine of twice the gradient's direction times its weight, and the weight."""
    cv2 = opencv()
    g = cv2.GaussianBlur(image.astype(np.float32), (0, 0), SMOOTH)
    dx, dy = (cv2.Sobel(g, -1, *order, scale=0.125) for order in ((1, 0), (0, 1)))
    power = dx**2 + dy**2
    strongest = power.argmax(axis=2)[..., None]
    dx, dy, power = (np.take_along_axis(x, strongest, 2)[..., 0] for x in (dx, dy, power))
    weight = power / (power + FLOOR**2)
    scale = weight / (power + 1e-6)
    found = (dx * dx - dy * dy) * scale, 2.0 * dx * dy * scale, weight
    cosine, sine, strength = (values.astype(np.float32) for values in found)
    return cosine, sine, strength


def _peak(values: Floats, row: int, column: int) -> Array:
    """Return the sub-pixel column and row of a maximum, (2,)."""
    r = int(np.clip(row, 1, values.shape[0] - 2))
    c = int(np.clip(column, 1, values.shape[1] - 2))

    def vertex(a: float, b: float, d: float) -> float:
        bend = a - 2.0 * b + d
        return float(np.clip(0.5 * (a - d) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0

    return np.array(
        [c + vertex(*values[r, c - 1 : c + 2]), r + vertex(*values[r - 1 : r + 2, c])], np.float64
    )
