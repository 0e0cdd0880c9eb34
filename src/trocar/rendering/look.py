"""The look of pictures: light, exposure, effects of lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import ceil, pi, sqrt
from typing import Literal

import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.inputs import check_numbers
from trocar.simulation.cavity import top_of_tissue

#: Widest narrow picture, and edge of the soft shadow map of narrow and of wider pictures [px].
#: Source: our own choice; a pixel of the map for one or two of the picture.
NARROW, SMALL_MAP, LARGE_MAP = 800, 512, 1024
#: Hard shadows (one look-up): pixels of the map's edge over those of the picture's width, their
#: step, their maximum. Source: our own choice; edges of shadows have no larger stairs than others.
FINE, STEP, MOST = 1.0, 256, 4096
#: Automatic exposure, as of a scope's video processor.
AUTO: Literal["auto"] = "auto"
STYLES = "plain", "surgical"
#: Vignette of pictures in a body's cavity. Source: chosen by eye.
CAVITY_VIGNETTE = 0.6
#: Largest rate of bleeding [ml/min], thickness of the blood on tissue, and largest radius that it
#: reaches [m]. Source: our own choice: an oozing vessel has 1 ml/min.
MOST_ML_MIN, BLOOD_M, POOL_M = 60.0, 2e-4, 0.022


def style_of(rig: RigDescription) -> Literal["plain", "surgical"]:
    """Return the style of a rig's pictures unless another is chosen: surgical if it has tissue."""
    return "plain" if rig.tissue is None else "surgical"


def vignette_of(rig: RigDescription) -> float:
    """Return the vignette of a rig's pictures unless another is chosen."""
    return CAVITY_VIGNETTE if rig.surroundings == "cavity" else 0.0


def bleeding_place(rig: RigDescription) -> tuple[float, float, float]:
    """Return the place that bleeds unless another is chosen: the middle of the tissue's top [m]."""
    x, y, z = (np.zeros(3) if rig.tissue is None else top_of_tissue(rig)).tolist()
    return x, y, z


@dataclass(frozen=True)
class Look:
    """Settings of pictures beside the camera's pose.

    Attributes:
        style: "plain", or "surgical": an endoscope's pictures have tissue with structure, moisture
            and light from below its surface, metal that mirrors light, and soft shadows; slower;
            `style_of` has the one for a rig
        shadows: whether the light throws them
        shadow_size: pixels along the edge of their map; 0: by the picture's width
        exposure: brighter by so many stops, or "auto": an endoscope's pictures are made as bright
            as those of a video processor, views are left as they are
        wet: additional glitter of surfaces, 0 to 1
        vignette: darkening of corners, 0 to 1
        noise: standard deviation of the sensor's noise, as a share of white, 0 to 0.5
        seed: of that noise
        distortion: whether pictures are distorted as the calibration has it
        samples: of each pixel, 0 (one) or 2, 4, ...: edges without stairs, slower
        smoke: its density, 0 to 1; of the surgical style, as is
        blood: share of tissue's surface that lies under it, 0 to 1
        bleeding: of a point of the tissue, from time 0 on: blood spreads over what is below, or at
            most 2 mm above it, 0 to 60 [ml/min]; of the surgical style
        bleeding_at: this point, in the world; `bleeding_place` has the one for a rig [m]
        jpeg: quality to which pictures are compressed as a video's are, 0 (not at all) to 95

    Raises:
        InputError: a value that is not allowed
    """

    style: Literal["plain", "surgical"] = "plain"
    shadows: bool = True
    shadow_size: int = 0
    exposure: float | Literal["auto"] = AUTO
    wet: float = 0.5
    vignette: float = 0.0
    noise: float = 0.0
    seed: int = 0
    distortion: bool = False
    samples: int = 0
    smoke: float = 0.0
    blood: float = 0.0
    bleeding: float = 0.0
    bleeding_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    jpeg: int = 0

    def __post_init__(self) -> None:
        if self.style not in STYLES:
            raise InputError(f"style: got {self.style!r}; allowed: {', '.join(STYLES)}")
        for name, low, high in (
            ("shadow_size", 0, MOST),
            ("exposure", -20.0, 20.0),
            ("wet", 0.0, 1.0),
            ("vignette", 0.0, 1.0),
            ("noise", 0.0, 0.5),
            ("seed", 0, 2**31 - 1),
            ("samples", 0, 64),
            ("smoke", 0.0, 1.0),
            ("blood", 0.0, 1.0),
            ("bleeding", 0.0, MOST_ML_MIN),
            ("jpeg", 0, 95),
        ):
            value = getattr(self, name)
            if name == "exposure" and value == AUTO:
                continue
            kind = {f.name: f.type for f in fields(self)}[name]
            whole = kind == "int" and not isinstance(value, int)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or whole:
                or_auto = ' or "auto"' if name == "exposure" else ""
                raise InputError(f"{name}: got {value!r}; allowed: a number{or_auto}")
            if not low <= value <= high:
                raise InputError(f"{name}: got {value!r}; allowed: {low:g} to {high:g}")
        check_numbers(self.bleeding_at, (3,), "bleeding_at [m]")

    def pool(self, time: float) -> float:
        """Return the radius over which blood has spread flat after a time [m, s]."""
        volume = self.bleeding * 1e-6 / 60.0 * max(time, 0.0)
        return min(sqrt(volume / (pi * BLOOD_M)), POOL_M)

    def shadow_map(self, width: int, *, hard: bool) -> int:
        """Return the pixels along the edge of the shadow map of pictures that are this wide."""
        fine = min(STEP * ceil(FINE * width / STEP), MOST)
        own = fine if hard else SMALL_MAP if width <= NARROW else LARGE_MAP
        return self.shadow_size or own
