"""A frame as one picture: colours as they are, depth and ids as people can read them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.rendering.frames import anaglyph, side_by_side

Picture = NDArray[np.uint8]
Array = NDArray[np.float64]

EYES = ("both", "left", "right", "anaglyph")
SHOWN = ("colour", "depth", "ids", "normals")
#: From near to far. Source: our own choice: bright near, dark far, and no hue twice.
NEAR_TO_FAR = np.array(
    [
        [255, 247, 214],
        [253, 190, 105],
        [222, 92, 78],
        [150, 50, 135],
        [72, 66, 178],
        [34, 104, 130],
    ],
    dtype=np.float64,
)
#: What is not hit by any ray.
NOTHING = 0
#: Ids that follow one another are spread over all hues by it. Source: D. E. Knuth, The Art of
#: Computer Programming 3, 6.4: multiplicative hashing.
SPREAD = np.uint32(2654435761)
#: Share of white in colours of ids. Source: by eye.
PALE = 0.38


def picture(frame: Any, eye: str, show: str) -> Picture:
    """Return a frame as a picture (h, w, 3), (h, 2 w, 3) of both eyes.

    Args:
        frame: with `left`, `right` (None of a camera with one eye), `depth`, `ids`, `normals`
        eye: one of EYES; of a camera with one eye it makes no difference
        show: one of SHOWN

    Raises:
        UnknownNameError: no such eye, or nothing of that name to show
        InputError: depth, ids or normals as an anaglyph, or that were not rendered
    """
    if eye not in EYES:
        raise UnknownNameError("eye", eye, EYES)
    if show not in SHOWN:
        raise UnknownNameError("show", show, SHOWN)
    pictures = _eyes(frame, show)
    if len(pictures) == 1 or eye == "left":
        return pictures[0]
    if eye == "right":
        return pictures[1]
    if eye == "anaglyph" and show != "colour":
        raise InputError(f"--eye anaglyph: got --show {show}; allowed: colour")
    together: Callable[[Picture, Picture], Picture] = (
        anaglyph if eye == "anaglyph" else side_by_side
    )
    return together(*pictures)


def _eyes(frame: Any, show: str) -> list[Picture]:
    if show == "colour":
        return [frame.left] if frame.right is None else [frame.left, frame.right]
    layers = getattr(frame, show)
    if layers is None:
        raise InputError(f"the frame was rendered without {show}")
    if show == "depth":
        seen = layers[np.isfinite(layers) & (layers > 0.0)]
        ends = (float(seen.min()), float(seen.max())) if seen.size else (0.0, 1.0)
        return [depth_picture(layer, ends) for layer in layers]
    make = ids_picture if show == "ids" else normals_picture
    return [make(layer) for layer in layers]


def depth_picture(depth: NDArray[np.float32], ends: tuple[float, float]) -> Picture:
    """Return depths (h, w) [m] in colours, by their logarithm between the ends [m]."""
    hit = np.isfinite(depth) & (depth > 0.0)
    near, far = np.log(ends[0]), np.log(max(ends[1], ends[0] * 1.001))
    share = (np.log(np.where(hit, depth, ends[1])) - near) / (far - near)
    places = np.linspace(0.0, 1.0, len(NEAR_TO_FAR))
    found = np.stack([np.interp(share, places, channel) for channel in NEAR_TO_FAR.T], axis=-1)
    found[~hit] = NOTHING
    return found.astype(np.uint8)


def ids_picture(ids: NDArray[np.int32]) -> Picture:
    """Return ids (h, w) in colours, each its own; 0 is nothing."""
    spread = (ids.astype(np.uint32) * SPREAD).astype(np.float64) / 2.0**32
    hue, light = spread % 1.0, 0.62 + 0.36 * ((spread * 64.0) % 1.0)
    channels = [np.abs((6.0 * hue + shift) % 6.0 - 3.0) - 1.0 for shift in (0.0, 4.0, 2.0)]
    pure = np.clip(np.stack(channels, axis=-1), 0.0, 1.0)
    found = light[..., None] * (PALE + (1.0 - PALE) * pure)
    found[ids == 0] = NOTHING
    return (255.0 * found).astype(np.uint8)


def normals_picture(normals: NDArray[np.float32]) -> Picture:
    """Return normals (h, w, 3) in colours: x red, y green, z blue, from -1 to 1."""
    return np.clip(127.5 * (normals + 1.0), 0.0, 255.0).astype(np.uint8)
