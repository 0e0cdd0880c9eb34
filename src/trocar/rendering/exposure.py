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

#: Target of the median brightness, over white. Source: chosen by eye.
TARGET = 0.38
#: The same in the surgical style, and its maximum over the brightness in endless light, so that
#: dark tissue stays dark and shaded. Source: chosen by eye.
SURGICAL_TARGET, SHARE = 0.48, 0.8
#: Interval at which a series measures that brightness anew [s]. Source: our own choice.
AIMED_S = 0.25
#: Range of automatic exposure [stops]. Source: chosen by eye: beyond it the curve is flat.
LEAST, MOST = -3.0, 4.0
#: Exposure of endless light [stops]: each pixel has its largest brightness.
ENDLESS = 20.0
#: Least ratio of lit pixels that is measured. Source: our own choice.
LIT = 0.02
#: Spacing of the pixels that are measured, and height of a picture drawn to be measured [px].
#: Source: our own choice: a thousand pixels and more.
APART, MEASURED_HEIGHT = 16, 60
#: Time constant of automatic exposure [s]. Source: our own choice; those of cameras take about half
#: a second.
SETTLING_S = 0.25
#: Dead band of automatic exposure [stops]. Source: our own choice, not visible.
STEADY = 0.1
#: Stops from one picture to the next for each stop of brightness: brightness grows with the root of
#: light at first, and ever slower. Source: `shaders`.
GAIN = 2.0
#: Weights of red, green and blue in brightness. Source: ITU-R BT.601.
LUMA = np.array([0.299, 0.587, 0.114])

Array = NDArray[np.float64]


def luma(picture: Picture, apart: int = 1) -> Array:
    """Return the brightness of pixels, every `apart` across and down, over white, (n,)."""
    return (picture[apart // 2 :: apart, apart // 2 :: apart] @ LUMA).ravel() / 255.0


def aim_at(endless: Picture) -> float:
    """Return the target of the median brightness of a picture in the surgical style.

    Args:
        endless: taken with ENDLESS, (h, w, 3)
    """
    shown = luma(endless)
    seen = shown[shown > 0.0]
    return min(SURGICAL_TARGET, SHARE * float(np.median(seen))) if len(seen) else TARGET


def stops_of(plain: Picture, endless: Picture, aim: float = TARGET) -> float:
    """Return the exposure at which a picture has the target brightness [stops].

    Light a is shown as c sqrt(a / (1 + a)), c in endless light, so two pictures give the
    brightness of each pixel at any exposure.

    Args:
        plain: taken with 0 stops, (h, w, 3)
        endless: the same with ENDLESS
        aim: target of the median brightness
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
    """Return the exposure of the next picture of a series [stops].

    Args:
        stops: exposure of this one
        picture: this one, (h, w, 3)
        passed_s: time between the two [s]
        aim: target of the median brightness
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
    """Return the calibration of small pictures with the same view."""
    width, height = calibration.eyes[0].size
    small = max(1, round(width * MEASURED_HEIGHT / height)), MEASURED_HEIGHT
    return calibration.undistorted().resized(*small)
