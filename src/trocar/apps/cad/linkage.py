"""What the links of PSM and ECM have alike: long links, pairs of caps, the cannula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from build123d.topology import Shape

from trocar.apps.cad import kit
from trocar.apps.cad.kit import Hinge, hinge
from trocar.kinematics.forward import pose
from trocar.kinematics.mechanism import Mechanism


def bar(start: float, end: float, y: float, tall: float, wide: float) -> Shape:
    """Return the smooth cover of a long link along x, slimmer at its ends.

    Args:
        start, end: along x [mm]
        y: its middle, where it is thick [mm]
        tall, wide: along y and z [mm]
    """
    slim = (0.6 * y, 0.0, 0.8 * tall, 0.8 * wide, 0.27 * tall)
    full = (y, 0.0, tall, wide, 0.34 * tall)
    stations = [(start, *slim), (start + 26, *full), (end - 26, *full), (end, *slim)]
    return kit.together([kit.lofted(stations[k : k + 2]) for k in range(3)])


def bored(eye: Shape, axes: Sequence[Hinge], radius: float) -> Shape:
    """Return a link with a bore along each axis; half a millimetre of it is play."""
    for at in axes:
        eye = eye - kit.pin(at, -60.0, 60.0, radius + 0.5)
    return eye


def cap_pair(at: Hinge, layer: float, tall: float, radius: float) -> list[Shape]:
    """Return the two caps of a hinge, on the outside of plates that end at z = +-layer."""
    return [kit.cap(at, s * layer, s * (layer + tall), radius) for s in (-1.0, 1.0)]


@dataclass(frozen=True, eq=False)
class Cannula:
    """A cannula and what holds it: the mount (casting), bands and latches (joint), the tube."""

    mount: Shape
    dark: tuple[Shape, ...]
    tube: Shape


def remote_centre(m: Mechanism, shaft: Hinge) -> float:
    """Return how far along the shaft's axis, from its point, the remote centre lies [mm]."""
    at_zero = pose(m, np.zeros(len(m.joints)), m.reference, "pitch_end")
    return float((kit.MM * at_zero[:3, 3] - shaft.point) @ shaft.direction)


def cannula(m: Mechanism, radius: float, past: float, rail: tuple[float, float]) -> Cannula:
    """Return the cannula about the axis of insertion, in the frame pitch_end.

    Args:
        m: of the arm
        radius: of the tube [mm]; it is 0.8 mm thick
        past: how far it reaches beyond the remote centre [mm]
        rail: x of the middle and y of the lower end of the rail that the mount hangs on [mm]
    """
    shaft = hinge(m, "pitch_end", "insertion")
    rcm = remote_centre(m, shaft)
    bore, bowl = radius - 0.8, 2.4 * radius
    heights = ((bore, -84), (bowl, -84), (bowl, -79), (0.85 * bowl, -72), (radius, -58))
    profile = [*heights, (radius, past), (bore, past)]
    x, y, _ = shaft.point + (rcm - 70) * shaft.direction
    ring = kit.tube(shaft, rcm - 77, rcm - 63, bowl + 2.5, 0.8 * bowl)
    reach = x - 0.9 * bowl
    neck = kit.block((rail[0] - 8, y - 7, -12), (reach, y + 7, 12), 1.5)
    strut = kit.rounded_box((rail[0], (rail[1] + y) / 2, 0), (16, y - rail[1] + 14, 30), 5.0)
    # The remote centre is marked as on the real one: a broad band, with a narrow one on each side.
    marks = [(z, 3.5 if z == 0 else 1.3) for z in (-18, -9, 0, 9) if z + 4 < past]
    bands = [
        kit.tube(shaft, rcm + z - half, rcm + z + half, radius + 0.3, bore + 0.4)
        for z, half in marks
    ]
    latches = [
        kit.block((x - 16, y - 4, z - 4), (x - 2, y + 4, z + 4), 1.5)
        for z in (bowl + 4.5, -bowl - 4.5)
    ]
    turned = kit.turning(shaft, [(r, rcm + z) for r, z in profile])
    return Cannula(kit.together([ring, neck, strut]), (*bands, *latches), turned)
