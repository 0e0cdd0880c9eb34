"""Appearance of surfaces: colour and gloss by the name that shapes use."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """Colour (r, g, b, a) in 0..1, and how glossy and metallic it is, 0..1."""

    rgba: tuple[float, float, float, float]
    gloss: float = 0.3
    metal: float = 0.0


class Materials(dict[str, Material]):
    """Materials by name; one of a free colour is called "color_" and six digits, red first."""

    def __missing__(self, name: str) -> Material:
        digits = name.removeprefix("color_")
        if digits == name or len(digits) != 6:
            raise KeyError(name)
        red, green, blue = (int(digits[k : k + 2], 16) / 255.0 for k in (0, 2, 4))
        return Material((red, green, blue, 1.0), 0.35)


#: Our own choice, after photographs of the da Vinci Classic.
MATERIALS = Materials({
    "cover": Material((0.90, 0.91, 0.92, 1.0), 0.35),
    "casting": Material((0.66, 0.69, 0.73, 1.0), 0.4, 0.2),
    "joint": Material((0.24, 0.26, 0.30, 1.0), 0.3),
    "steel": Material((0.74, 0.76, 0.79, 1.0), 0.7, 0.8),
    "black": Material((0.10, 0.10, 0.12, 1.0), 0.5),
    "accent": Material((0.18, 0.42, 0.66, 1.0), 0.35),
    "red": Material((0.78, 0.14, 0.12, 1.0), 0.35),
    "yellow": Material((0.93, 0.75, 0.16, 1.0), 0.35),
    "green": Material((0.25, 0.58, 0.30, 1.0), 0.3),
    "drape": Material((0.35, 0.58, 0.62, 1.0), 0.1),
    "floor": Material((0.80, 0.81, 0.83, 1.0), 0.1),
    "tissue": Material((0.76, 0.40, 0.36, 1.0), 0.45),
    "membrane": Material((0.86, 0.62, 0.54, 1.0), 0.45),
    "gauze": Material((0.84, 0.81, 0.76, 1.0), 0.05),
})  # fmt: skip
