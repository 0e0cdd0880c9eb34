"""Automatic exposure, as a scope's video processor has it.

The measure is the median brightness of what is lit: a white board or a black corner is not half of
the picture, and leaves the rest as it is.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Calibration
from trocar.rendering.frames import Picture

#: Median brightness that is aimed at, as a share of white. Source: chosen by eye.
TARGET = 0.38
#: In the surgical style: as a share of white, and at most as a share of the brightness in endless
#: light, so that dark tissue stays dark and shaded. Source: chosen by eye.
SURGICAL_TARGET, SHARE = 0.48, 0.8
#: A series measures that brightness anew so often [s]. Source: our own choice.
AIMED_S = 0.25
#: Fewest and most stops. Source: chosen by eye: beyond, light is all from the curve's flat end.
LEAST, MOST = -3.0, 4.0
#: So many stops shows what something is like in endless light.
ENDLESS = 20.0
#: A picture with a smaller share that is lit says nothing. Source: our own choice.
LIT = 0.02
#: Pixels between two that are looked at, and the height of a picture that is drawn to be measured.
#: Source: our own choice: a thousand pixels and more.
APART, MEASURED_HEIGHT = 16, 60
#: How fast exposure follows [s]. Source: our own choice; those of cameras take about half a second.
SETTLING_S = 0.25
#: A picture that is so near to it is left as it is [stops]. Source: our own choice, not seen.
STEADY = 0.1
#: Stops from one picture to the next of a series, for each of light: what is shown grows with the
#: root of light at first, and ever slower. Source: `shaders`.
GAIN = 2.0
#: How bright red, green and blue are. Source: ITU-R BT.601.
LUMA = np.array([0.299, 0.587, 0.114])

Array = NDArray[np.float64]


def luma(picture: Picture, apart: int = 1) -> Array:
    """Return the brightness of every so-manieth pixel as a share of white, (n,)."""
    return (picture[apart // 2 :: apart, apart // 2 :: apart] @ LUMA).ravel() / 255.0


def aim_at(endless: Picture) -> float:
    """Return the median brightness that a picture of the surgical style is to have.

    Args:
        endless: taken with ENDLESS, (h, w, 3)
    """
    shown = luma(endless)
    seen = shown[shown > 0.0]
    return min(SURGICAL_TARGET, SHARE * float(np.median(seen))) if len(seen) else TARGET


def stops_of(plain: Picture, endless: Picture, aim: float = TARGET) -> float:
    """Return the stops at which a picture is as bright as it is to be.

    Light a is shown as c sqrt(a / (1 + a)), c in endless light, so two pictures tell of each pixel
    how it is shown at any exposure.

    Args:
        plain: taken with 0 stops, (h, w, 3)
        endless: the same with ENDLESS
        aim: median brightness
    """
    least, most = luma(plain), luma(endless)
    seen = most > 0.0
    if seen.mean() < LIT:
        return 0.0
    share = np.clip((least[seen] / most[seen]) ** 2, 1e-6, 1.0 - 1e-6)
    light = share / (1.0 - share)
    stops = np.arange(LEAST, MOST + 0.125, 0.25)
    shown = light * 2.0 ** stops[:, None]
    medians = np.median(most[seen] * np.sqrt(shown / (1.0 + shown)), axis=1)
    return float(np.interp(aim, medians, stops))


def followed(stops: float, picture: Picture, passed_s: float, aim: float = TARGET) -> float:
    """Return the stops of the picture after one that was taken with some.

    Args:
        stops: that it was taken with
        picture: what it shows, (h, w, 3)
        passed_s: time between the two [s]
        aim: median brightness
    """
    shown = luma(picture, APART)
    seen = shown[shown > 0.0]
    if len(seen) < LIT * len(shown):
        return stops
    off = GAIN * float(np.log2(aim / np.median(seen)))
    if abs(off) < STEADY:
        return stops
    share = 1.0 - float(np.exp(-passed_s / SETTLING_S))
    return float(np.clip(stops + share * off, LEAST, MOST))


@lru_cache(maxsize=16)
def to_be_measured(calibration: Calibration) -> Calibration:
    """Return eyes whose pictures are small and show the same."""
    width, height = calibration.eyes[0].size
    small = max(1, round(width * MEASURED_HEIGHT / height)), MEASURED_HEIGHT
    return calibration.undistorted().resized(*small)
