"""The setup joints of the Si cart: a carriage on the column, long arms one over another, a knuckle.

Source: axes from the description; thicknesses and looks our own choice, after photographs of the
da Vinci Si.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from build123d import Plane

from tools.cad import kit
from tools.cad.forms import box, edges_at, rounded
from tools.cad.kit import Hinge, cap, hinge
from tools.cad.links import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.kinematics.mechanism import Mechanism

#: The lower and upper face of an arm in its frame, and what moving faces keep free [mm].
LOWER, UPPER, AIR = -56.0, 44.0, 2.0
#: Radii of an arm at its two axes, and of the drum between two arms [mm].
NEAR, FAR, DRUM = 64.0, 58.0, 50.0
#: Radius of the knuckle that an arm's base sits on, and half its width [mm].
KNUCKLE, WIDE = 52.0, 46.0
#: Where the seat of the arm's base begins and ends, from the knuckle's axis [mm].
SEAT = (36.0, 58.0)


def links(arm: ArmDescription) -> tuple[Link, ...]:
    """Return the links of a setup arm; PSM1 and PSM2 have the same."""
    m = arm.mechanism
    group = arm.name.removeprefix("suj_si_").replace("psm1", "psm").replace("psm2", "psm")
    names = [joint.name for joint in m.joints]
    drawn = [_carriage(m)]
    drawn += [_arm(m, *three) for three in zip(names, names[1:], names[2:], strict=False)]
    drawn += [_knuckle(m, names[-2], names[-1])]
    return tuple(Link(f"{group}_{k.name}", k.frame, k.parts, k.convex) for k in drawn)


def _faces(m: Mechanism, before: str, link: str) -> tuple[float, float]:
    """Return the lower and upper face of the last link, as seen in its frame [mm]."""
    rise = _rise(m, before, link)
    if rise < 0.0:
        return -KNUCKLE, KNUCKLE
    low = UPPER + AIR + 44.0 - rise
    return low, low + 80.0


def _rise(m: Mechanism, link: str, after: str) -> float:
    """Return how far the next frame lies above one [mm]."""
    return float(hinge(m, link, after).point[2])


def _reach(m: Mechanism, link: str, after: str) -> tuple[float, float]:
    """Return where the drum on the next axis begins and ends, in the frame of `link` [mm]."""
    rise = _rise(m, link, after)
    last = after == m.joints[-1].name
    low, high = _faces(m, link, after) if last else (LOWER, UPPER)
    if rise > 0.0:
        return UPPER - 2.0, rise + low - AIR
    return LOWER + 2.0, rise + high + AIR


def _carriage(m: Mechanism) -> Link:
    """Return what slides on the column: a tall cover, and the drum of the first arm on its top."""
    axis = hinge(m, "suj_1", "suj_2")
    top = float(axis.point[2]) + LOWER - AIR
    plan = kit.hull([(0, 0, 57), (-74, 40, 16), (-74, -40, 16)])
    shell = rounded(edges_at(kit.plate(plan, 30.0, top - 38), "z", top - 38), 16.0)
    drum = kit.turning(
        axis,
        [(radius, height - float(axis.point[2])) for radius, height in _drum(top)],
    )
    shoes = [box((-100, -34, z), (-84, 34, z + 80), 6.0, "x") for z in (60, top - 180)]
    parts = (Part("cover", shell), Part("joint", kit.together([drum, *shoes])))
    return Link("carriage", "suj_1", parts, (kit.plate(plan, 30.0, top),))


def _drum(top: float) -> list[tuple[float, float]]:
    """Return the profile of the drum on the carriage, (radius, height) [mm]."""
    foot = top - 42
    return [(0, foot), (55, foot), (55, top - 20), (DRUM, top - 16), (DRUM, top), (0, top)]


def _arm(m: Mechanism, before: str, link: str, after: str) -> Link:
    """Return a long arm from one upright axis to the next, with the drum that carries the next."""
    near, far = Hinge(np.zeros(3), np.array([0.0, 0.0, 1.0])), hinge(m, link, after)
    far = Hinge(far.at(0.0), far.direction)
    x = float(far.point[0])
    start, end = _reach(m, link, after)
    plan = kit.hull([near.disc(NEAR), (0.5 * x, 0, 50), far.disc(FAR)])
    seam = LOWER + 26
    cover = rounded(edges_at(kit.plate(plan, seam, UPPER), "z", UPPER), 20.0)
    tray = kit.plate(kit.hull([near.disc(NEAR - 3), far.disc(FAR - 3)]), LOWER, seam)
    low, high = sorted((start, end))
    drum = kit.turning(far, [(0, low), (DRUM, low), (DRUM, high), (0, high)])
    above, below = (UPPER - 1, UPPER + 6), (LOWER + 1, LOWER - 6)
    caps = [
        cap(far, *(above if end < start else below), 40.0),
        cap(near, *(above if _rise(m, before, link) > 0.0 else below), 44.0),
    ]
    parts = (
        Part("cover", cover),
        Part("casting", kit.together([tray, *caps])),
        Part("joint", drum),
    )
    touch = (kit.plate(kit.polygon(_around(x)), LOWER, UPPER), kit.prism(far, low, high, DRUM, 8))
    return Link(f"arm_{link[-1]}", link, parts, touch)


def _around(x: float) -> list[tuple[float, float]]:
    """Return eight corners about an arm of length x."""
    half = 0.4142
    corners = [(-NEAR, -half * NEAR), (-half * NEAR, -NEAR), (x + half * FAR, -FAR)]
    corners += [(x + FAR, -half * FAR)]
    return corners + [(u, -v) for u, v in reversed(corners)]


def _knuckle(m: Mechanism, before: str, link: str) -> Link:
    """Return the last link: a head under (or on) the last arm and the seat of the arm's base."""
    low, high = _faces(m, before, link)
    own = Hinge(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    seat = kit.axis_pose(m, link, "upright")
    at = kit.MM * seat[:3, 3]
    out = seat[:3, 0]  # the base's axis
    across = Hinge(at, np.array([0.0, 1.0, 0.0]))
    turn = Plane(origin=(0, 0, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0)).location  # x along, y up
    if _rise(m, before, link) > 0.0:
        up = low + 40.0
        chain, neck = [(0.0, up, 36.0), (float(at[0]), up, 38.0)], (low, up)
    else:
        chain, neck = [(0.0, 0.0, DRUM)], (0.0, high)
    chain.append((float(at[0]), 0.0, KNUCKLE))
    head = turn * kit.plate(kit.outline(chain), -WIDE, WIDE, 14.0, round_off=True)
    drum = kit.pin(own, *neck, DRUM - 4)
    ring = kit.pin(Hinge(at, out), *SEAT, 45.0)
    caps = [cap(across, s * (WIDE - 1), s * (WIDE + 6), KNUCKLE - 16) for s in (1.0, -1.0)]
    parts = (
        Part("cover", head),
        Part("joint", kit.together([drum, ring])),
        Part("casting", kit.together(caps)),
    )
    touch = tuple(turn * kit.plate(kit.hull(pair), -WIDE, WIDE) for pair in pairwise(chain))
    return Link("knuckle", link, parts, touch)
