"""How surfaces answer to light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.rendering.look import Look
from trocar.rendering.scenery import Scenery

#: Sharpness of a glint without gloss and with all of it. Source: chosen by eye.
SHARPNESS = 5.0, 260.0
#: Strength of glints by gloss: of plastic and cloth, of metal; and of a wet film on them. Source:
#: chosen by eye.
DIELECTRIC, METAL, FILM = 0.45, 0.75, 0.25
#: Of metal, which mirrors what is around it, of which we draw nothing: how much broader its glints
#: are, its share of diffuse light, and how much of that looks back to where it came from. Source:
#: chosen by eye.
BROADER, METAL_DIFFUSE, BACKWARDS = 0.45, 0.75, 0.85
#: A wet film is this much smoother than what is under it. Source: chosen by eye.
SMOOTHER = 0.3


def shades(things: Scenery) -> NDArray[np.float32]:
    """Return colours as the shaders want them: roots of red, green, blue; and 1, (m, 4)."""
    metal = things.colours[:, 3:]
    share = 1.0 - (1.0 - METAL_DIFFUSE) * metal
    roots = np.sqrt(np.hstack([things.colours[:, :3] * share, np.ones_like(metal)]))
    return roots.astype(np.float32)


def finishes(things: Scenery, look: Look) -> NDArray[np.float32]:
    """Return sharpness and strength of glints, how metallic objects are, and their ids, (m, 4)."""
    metal = things.colours[:, 3].astype(np.float64)
    film = look.wet * (1.0 - metal)
    gloss = np.clip(things.gloss + SMOOTHER * film, 0.0, 1.0)
    low, high = SHARPNESS
    sharp = low * (high / low) ** (gloss * (1.0 - BROADER * metal))
    strength = gloss * (DIELECTRIC + (METAL - DIELECTRIC) * metal) + FILM * film
    return np.stack([sharp, strength, BACKWARDS * metal, things.ids], axis=1).astype(np.float32)
