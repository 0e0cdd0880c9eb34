"""Two eyes' pictures in one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

GREY = (77, 150, 29)
"""Weights of red, green and blue in 256ths. Source: ITU-R BT.601."""


def side_by_side(left: Picture, right: Picture) -> Picture:
    """Return both pictures in one, (h, 2 w, 3), the left eye's on the left."""
    return np.concatenate([left, right], axis=1)


def anaglyph(left: Picture, right: Picture) -> Picture:
    """Return both in one, (h, w, 3), for glasses that are red on the left and cyan on the right.

    The left eye's picture is grey, which hurts less than colours where tissue is red.
    """
    found = right.copy()
    r, g, b = (left[..., k].astype(np.uint16) for k in range(3))
    found[..., 0] = (GREY[0] * r + GREY[1] * g + GREY[2] * b) >> 8
    return found
