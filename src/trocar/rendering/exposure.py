"""Automatic exposure, as a scope's video processor has it.

Two measures of what is lit: its median brightness, and that of its highlights. Where highlights are
white surfaces, as a peg board, they are shown white, so the median is brighter then.
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
#: Highlights: the percentile of brightness that stands for them, its target where they are white,
#: and their brightness in endless light from which they count as white; the target falls with a
#: power of that brightness, so grey and coloured surfaces are left to the median. Source: chosen by
#: eye; white is 214 of 255 then, below the flat end of the curve.
HIGHLIGHT, BRIGHT, WHITE, FALL = 90.0, 0.84, 0.88, 8.0
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


def metered(plain: Picture, endless: Picture, style: str = "plain") -> tuple[float, float]:
    """Return the exposure of a picture [stops], and its median brightness then, over white.

    Light a is shown as c sqrt(a / (1 + a)), c in endless light, so two pictures give the
    brightness of each pixel at any exposure. The exposure is the larger of those at which the
    median and the highlights reach their targets.

    Args:
        plain: taken with 0 stops, (h, w, 3)
        endless: the same with ENDLESS
        style: of the look
    """
    least, most = luma(plain), luma(endless)
    seen = most > 0.0
    if seen.mean() < LIT:
        return 0.0, TARGET
    least, most = least[seen], most[seen]
    aim = TARGET if style == "plain" else min(SURGICAL_TARGET, SHARE * float(np.median(most)))
    white = float(np.percentile(most, HIGHLIGHT)) / WHITE
    share = np.clip((least / most) ** 2, 1e-6, 1.0 - 1e-6)
    light = share / (1.0 - share)
    stops = np.arange(LEAST, MOST + 0.125, 0.25)
    lit = light * 2.0 ** stops[:, None]
    shown = most * np.sqrt(lit / (1.0 + lit))
    medians = np.median(shown, axis=1)
    highlights: Array = np.percentile(shown, HIGHLIGHT, axis=1)
    found = float(np.interp(aim, medians, stops))
    target: float = BRIGHT * min(float(np.power(white, FALL)), 1.0)
    bright = float(np.interp(target, highlights, stops))
    if bright <= found:
        return found, aim
    return bright, float(np.interp(bright, stops, medians))


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
