"""Solids that several tests look at, each drawn once, and what they share and stand on."""

from __future__ import annotations

from functools import cache
from importlib import import_module

import numpy as np
from build123d import GeomType
from build123d.topology import Shape

from tools.cad.links import Link
from tools.cad.sets import solid_sets
from trocar.descriptions import load_arm


@cache
def links_of(name: str) -> tuple[Link, ...]:
    """Return the links of an arm, or of the cart or the table."""
    draw = import_module(f"tools.cad.{set_of(name)}").links
    return draw(load_arm(name)) if solid_sets()[set_of(name)].arms else draw()


def set_of(name: str) -> str:
    """Return the set of solids that an arm is drawn in, or the name of a set itself."""
    return next((k for k, one in solid_sets().items() if (name, "none") in one.arms), name)


def off_axis(solids: list[Shape], point: np.ndarray, way: np.ndarray) -> float:
    """Return how far the nearest parallel cylinder lies from an axis through a point [mm]."""
    best = np.inf
    for face in [f for s in solids for f in s.faces().filter_by(GeomType.CYLINDER)]:
        axis = face.axis_of_rotation
        if axis is not None and abs(np.array([*axis.direction]) @ way) > 1.0 - 1e-12:
            away = np.array([*axis.position]) - point
            best = min(best, float(np.linalg.norm(away - way * (away @ way))))
    return best


def parts(link: Link) -> list[Shape]:
    """Return the solids of a link."""
    return [part.solid for part in link.parts]


def shared(a: Shape, b: Shape) -> float:
    """Return the volume that two solids share; 0 without a look where their boxes are apart."""
    one, other = a.bounding_box(), b.bounding_box()
    for axis in "XYZ":
        if getattr(one.min, axis) > getattr(other.max, axis):
            return 0.0
        if getattr(other.min, axis) > getattr(one.max, axis):
            return 0.0
    both = a.intersect(b)
    return sum(s.volume for piece in both for s in piece.solids()) if both else 0.0
