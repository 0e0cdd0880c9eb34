"""Textures of the surgical style: bumps, vessels and moisture of tissue, and metal's mirror.

Everything is generated; both textures are the same on every machine.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Texture = NDArray[np.uint8]

#: Edge of the tissue's texture, which repeats [m], and its pixels. Source: chosen by eye; a texel
#: is 0.09 mm, a pixel of 1280x720 at 80 mm about as much.
TILE_M, TEXELS = 0.048, 512
#: Map from points at rest to places in the texture: rows across a direction along which few
#: surfaces of tissue lie, so that walls are not smeared, scaled to one a tile. Source: our own
#: choice.
ACROSS = np.array([0.45, 0.35, 0.82]) / np.linalg.norm([0.45, 0.35, 0.82])
_U = np.cross([0.0, 1.0, 0.0], ACROSS)
PLACES = np.stack([_U, np.cross(ACROSS, _U)]) / np.linalg.norm(_U)
#: Slope of bumps at either end of the texture's range, four standard deviations. Source: chosen by
#: eye.
BUMP = 1.1
#: Vessels: number that begins in a tile, their first width [texels], and the ratio of it at which
#: they end. Source: chosen by eye, after photographs of peritoneum.
VESSELS, WIDTH, THIN = 9, 3.4, 0.22
#: Edge of metal's mirror map [px].
MIRROR = 128


def noise(rng: np.random.Generator, coarse: float, fine: float, fall: float) -> Array:
    """Return noise that repeats at its edges, of unit deviation, (TEXELS, TEXELS).

    Args:
        rng: random numbers
        coarse, fine: least and greatest frequency [1/tile]
        fall: power of the frequency with which the amplitude falls
    """
    f = np.hypot(np.fft.fftfreq(TEXELS)[:, None], np.fft.rfftfreq(TEXELS)) * TEXELS
    band = np.where((f >= coarse) & (f <= fine), np.maximum(f, 1.0) ** -fall, 0.0)
    found = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((TEXELS, TEXELS))) * band)
    return found / found.std()


@cache
def tissue(blood: float) -> Texture:
    """Return tissue: slopes along both axes, lightness and moisture, (TEXELS, TEXELS, 4).

    Args:
        blood: ratio of it that lies under blood, 0 to 1
    """
    rng = np.random.default_rng(7)
    height = noise(rng, 5, 60, 1.6) + 0.12 * noise(rng, 50, 200, 0.6)
    light = 0.62 + 0.11 * noise(rng, 2, 14, 1.2) + 0.035 * noise(rng, 20, 200, 0.5)
    light -= 0.34 * vessels(rng)
    moist = np.clip(0.35 + 0.33 * noise(rng, 3, 24, 1.0), 0.0, 1.0)
    if blood > 0.0:
        pool = noise(rng, 1, 12, 1.3)
        share = np.clip(2.5 * (pool - np.quantile(pool, 1.0 - blood)), 0.0, 1.0)
        height, light = height * (1.0 - 0.7 * share), light * (1.0 - share) + 0.05 * share
        moist = np.maximum(moist, 0.8 * share)
    rise = [0.5 * (np.roll(height, -1, axis) - np.roll(height, 1, axis)) for axis in (1, 0)]
    scale = 1.0 / (8.0 * np.std(rise))  # four deviations each way
    slopes = [0.5 + scale * each for each in rise]
    return _bytes(np.stack([*slopes, light, moist], axis=-1))


def vessels(rng: np.random.Generator) -> Array:
    """Draw vessels, curves that branch and thin out: covered ratio of each texel, 0 to 1."""
    begun = [(rng.uniform(0, TEXELS, 2), rng.uniform(0, 2 * np.pi), WIDTH) for _ in range(VESSELS)]
    points: list[tuple[float, float, float]] = []
    while begun:
        at, heading, width = begun.pop()
        bend = 0.0
        while width > THIN * WIDTH:
            points.append((*at, width))
            bend = 0.85 * bend + 0.028 * rng.standard_normal()
            heading += bend
            at = at + 1.2 * np.array([np.cos(heading), np.sin(heading)])
            width *= 0.9965
            if rng.random() < 0.012:
                side = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 0.9)
                begun.append((at, heading + side, width * rng.uniform(0.5, 0.8)))
    x, y, width = np.array(points).T[..., None, None]
    reach = np.arange(-8, 9)
    column, row = np.floor(x) + reach, np.floor(y) + reach[:, None]
    shade = np.exp(-((column - x) ** 2 + (row - y) ** 2) / width**2) * np.minimum(1.0, width / 2.0)
    found = np.zeros((TEXELS, TEXELS))
    where = row.astype(int) % TEXELS, column.astype(int) % TEXELS
    np.maximum.at(found, where, shade)
    return found


@cache
def mirrored() -> Texture:
    """Return the surroundings that metal mirrors: a sphere map seen from behind.

    In the middle the dark of the port with the light guide above the eyes; around it tissue, as
    grey as it is in pictures whose white balance is set on instruments.
    """
    y, x = np.meshgrid(*2 * (np.linspace(-1.0, 1.0, MIRROR),), indexing="ij")
    r = np.hypot(x, y)
    tissue_ = (
        np.array([0.57, 0.555, 0.55]) * (0.55 + 0.45 * np.clip(1.0 - np.abs(y), 0, 1))[..., None]
    )
    away = np.clip((r - 0.25) / 0.4, 0.0, 1.0)[..., None]
    found = np.array([0.10, 0.10, 0.11]) * (1.0 - away) + tissue_ * away
    rough = noise(np.random.default_rng(3), 2, 9, 1.0)[:: TEXELS // MIRROR, :: TEXELS // MIRROR]
    found *= (1.0 + 0.16 * rough * away[..., 0])[..., None]
    found += np.exp(-((x / 0.17) ** 2 + ((y + 0.12) / 0.12) ** 2))[..., None]
    return _bytes(np.concatenate([found, np.ones((MIRROR, MIRROR, 1))], axis=-1))


def _bytes(values: Array) -> Texture:
    return np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
