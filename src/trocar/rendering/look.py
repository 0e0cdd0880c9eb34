"""How pictures look: light, exposure, what lens and sensor add."""

from __future__ import annotations

from dataclasses import dataclass, fields

from trocar.errors import InputError


@dataclass(frozen=True)
class Look:
    """What is asked of pictures beside where they are taken from.

    Attributes:
        shadows: whether the light throws them
        exposure: brighter by so many stops
        wet: how much more surfaces glitter, 0 to 1
        vignette: how much darker corners are, 0 to 1
        noise: standard deviation of the sensor's noise, as a share of white, 0 to 0.5
        seed: of that noise
        distortion: whether pictures are distorted as the calibration has it
        samples: of each pixel, 0 (one) or 2, 4, ...: edges without stairs, slower

    Raises:
        InputError: a value that is not allowed
    """

    shadows: bool = True
    exposure: float = 0.0
    wet: float = 0.5
    vignette: float = 0.0
    noise: float = 0.0
    seed: int = 0
    distortion: bool = False
    samples: int = 0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("exposure", -20.0, 20.0),
            ("wet", 0.0, 1.0),
            ("vignette", 0.0, 1.0),
            ("noise", 0.0, 0.5),
            ("seed", 0, 2**31 - 1),
            ("samples", 0, 64),
        ):
            value = getattr(self, name)
            kind = {f.name: f.type for f in fields(self)}[name]
            whole = kind == "int" and not isinstance(value, int)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or whole:
                raise InputError(f"{name}: got {value!r}; allowed: a number")
            if not low <= value <= high:
                raise InputError(f"{name}: got {value!r}; allowed: {low:g} to {high:g}")
