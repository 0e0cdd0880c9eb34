"""Which calibrations no camera can have."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError
from trocar.geometry.lens import check_distortion, fold_in_view

Array = NDArray[np.float64]

#: The principal point lies in this middle part of the picture; else K is that of another size.
#: Source: our own choice; K of a picture half as wide has it at 1/4, and of calibrations of real
#: endoscopes and webcams that we looked at, all that fitted their pictures lie within.
MIDDLE = (0.3, 0.7)
#: A pixel is not this much wider than high. Source: our own choice; those of
#: television are 1.09, those of one of its half pictures 2.2.
SQUARENESS = 2.5
#: Eyes that are nearer or farther than this are not a scope's [m]. Source: our own choice; known
#: baselines are 1 to 20 mm, a person's 65 mm, and a wrong unit makes them a thousand times that.
NEAREST_EYES, FARTHEST_EYES = 1e-4, 0.2
#: Eyes look at the same things: their axes are no farther apart. Source: our own choice. [rad]
WIDEST_SQUINT = np.deg2rad(45.0)


def check_intrinsics(
    width: Any, height: Any, K: ArrayLike, distortion: ArrayLike
) -> tuple[Array, Array]:
    """Return K (3, 3) and eight distortion coefficients of a picture of this size.

    Raises:
        InputError: what is wrong, what was got and what is allowed
    """
    for value, key in ((width, "width"), (height, "height")):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
            raise InputError(f"{key}: got {value!r}; allowed: a whole number of pixels above 0")
    k = _check_matrix(K)
    _check_focal_lengths(k)
    for i, (size, key, name) in enumerate(((width, "width", "cx"), (height, "height", "cy"))):
        share = (k[i, 2] + 0.5) / size
        if not MIDDLE[0] < share < MIDDLE[1]:
            low, high = (edge * size - 0.5 for edge in MIDDLE)
            raise InputError(
                f"K: {name} = {k[i, 2]:g} does not match a {key} of {size}; allowed: {low:.1f} to"
                f" {high:.1f}. Is K that of another size?"
            )
    coefficients = check_distortion(distortion)
    fold = fold_in_view(k, width, height, coefficients)
    if fold is not None:
        raise InputError(
            f"distortion: {_shown(coefficients)} folds the image inside the view, at pixel"
            f" ({fold[0]:.0f}, {fold[1]:.0f}) of {width}x{height}; allowed: one point to one pixel"
        )
    return k, coefficients


def check_baseline(T_left_right: Array) -> None:
    """Refuse two eyes that cannot be those of one scope.

    Raises:
        InputError: what is wrong, what was got and what is allowed
    """
    shift = T_left_right[:3, 3]
    baseline = float(np.linalg.norm(shift))
    span = f"{1e3 * NEAREST_EYES:g} to {1e3 * FARTHEST_EYES:g} mm"
    if baseline == 0.0:
        raise InputError(f"baseline: got 0: both eyes are in one place; allowed: {span}")
    if not NEAREST_EYES <= baseline <= FARTHEST_EYES:
        raise InputError(
            f"baseline: got {1e3 * baseline:g} mm; allowed: {span}. Is the calibration in another"
            " unit?"
        )
    if shift[0] <= 0.0:
        raise InputError(
            f"baseline: the right eye is {-1e3 * shift[0]:g} mm left of the left one; allowed: to"
            " its right. Are the eyes exchanged?"
        )
    if shift[0] < 0.5 * baseline:
        raise InputError(
            f"baseline: the right eye is at {(1e3 * shift).tolist()} mm; allowed: mostly to the"
            " right, along x"
        )
    squint = float(np.arccos(np.clip(T_left_right[2, 2], -1.0, 1.0)))
    if squint > WIDEST_SQUINT:
        raise InputError(
            f"T_left_right: the eyes look {np.degrees(squint):.0f} deg apart; allowed: up to"
            f" {np.degrees(WIDEST_SQUINT):.0f} deg"
        )


def check_alike(left: tuple[int, int], right: tuple[int, int]) -> None:
    """Refuse eyes whose pictures differ in size.

    Raises:
        InputError: both sizes are named
    """
    if left != right:
        one, other = (f"{width}x{height}" for width, height in (left, right))
        raise InputError(
            f"size: the left eye's picture is {one}, the right one's {other}; allowed: the same"
        )


def _check_matrix(K: ArrayLike) -> Array:
    try:
        k = np.array(K, dtype=np.float64)
    except (TypeError, ValueError):
        k = np.array(np.nan)
    if k.shape != (3, 3) or not np.isfinite(k).all():
        told: object = K.tolist() if isinstance(K, np.ndarray) else K
        raise InputError(f"K: got {told!r}; allowed: 3 x 3 finite numbers")
    if k[0, 1] != 0.0 or k[1, 0] != 0.0 or (k[2] != [0.0, 0.0, 1.0]).any():
        raise InputError(
            f"K: got {k.tolist()}; allowed: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] (no skew)"
        )
    return k


def _check_focal_lengths(k: Array) -> None:
    for value, name in ((k[0, 0], "fx"), (k[1, 1], "fy")):
        if value <= 0.0:
            raise InputError(f"K: focal length {name} = {value:g}; allowed: above 0")
    ratio = float(k[0, 0] / k[1, 1])
    if not 1.0 / SQUARENESS < ratio < SQUARENESS:
        raise InputError(
            f"K: fx = {k[0, 0]:g} and fy = {k[1, 1]:g} differ by {ratio:.3g}; allowed: up to"
            f" {SQUARENESS:g}"
        )


def _shown(coefficients: Array) -> str:
    last = 5 if not coefficients[5:].any() else 8
    return ", ".join(f"{value:g}" for value in coefficients[:last])
