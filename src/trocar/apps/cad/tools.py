"""The EndoWrist instruments: housing, shaft, wrist and jaws, on the axes of the description.

Sizes that are no distance between axes are our own choice, after photographs; the shaft is 8.4 mm
thick (Source: today's description).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from build123d.topology import Shape

from trocar.apps.cad.forms import (
    Corner,
    bevelled,
    both,
    box,
    common,
    cut,
    edges_at,
    fuse,
    mirrored,
    prism,
    ring,
    rod,
    turned,
)
from trocar.apps.cad.jaws import AIR, FAMILIES, HALF_GAP, Pair
from trocar.apps.cad.link import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError
from trocar.kinematics.forward import pose

#: Where the shaft comes out of the housing's body, along the insertion's frame. [mm]
COLLAR = 66.0
SHAFT_RADIUS = 4.2
#: Half of the gap between the ears of the shaft's end; radius of the ears of both hinges. [mm]
SHAFT_GAP, EAR_RADIUS = 2.45, 2.6
#: Where the discs on the housing's back turn (x, z), and their radius. [mm]
DISCS, DISC_RADIUS = ((-10.5, -12.0), (10.5, -12.0), (-10.5, 14.0), (10.5, 14.0)), 6.5
#: The housing's back, towards the carriage, and the discs on it. [mm]
BACK, DISC_BACK = 2.6, 3.6


def links(arm: ArmDescription) -> tuple[Link, ...]:
    """Return the links of the tool that an arm carries; the same name means the same solid.

    Raises:
        InputError: no tool, or one whose jaws are not drawn
    """
    family = arm.tool.split(":")[0]
    if family not in FAMILIES:
        got = repr(arm.tool) if arm.tool else "no tool"
        raise InputError(f"{arm.name}: got {got}; allowed: {', '.join(FAMILIES)}")
    length = _distance(arm, "roll", arm.tool_frame)
    wrist = _distance(arm, "wrist_yaw", "wrist_pitch")
    left, right = _pair(family)
    name = family.lower()
    return (
        Link("housing", arm.tool_frame, housing(), (_housing_hull(),)),
        Link(f"shaft_{10 * length:.0f}", "roll", shaft(length), (_shaft_hull(length),)),
        Link(f"wrist_{10 * wrist:.0f}", "wrist_pitch", clevis(wrist)),
        Link("pin", "wrist_yaw", pin()),
        Link(f"{name}_left", "finger_left", left.parts, left.convex),
        Link(f"{name}_right", "finger_right", right.parts, right.convex),
    )


@cache
def housing() -> tuple[Part, ...]:
    """Return the housing: shell, latches, label, back plate with its four discs, collar."""
    shell = prism(_face(1.0), "y", -39.0, -1.0)
    shell = bevelled(edges_at(shell, "y", -39.0), 4.5)
    grip = prism([(20.8, -10.0, 3.0), (30, -10), (30, 18), (20.8, 18.0, 3.0)], "y", -31.0, -8.0)
    shell = cut(shell, grip, mirrored(grip, "x"))
    latches = [
        prism([(x, z, 1.5) for x, z in _square(22.1 * s, 4.0, 1.6, 11.0)], "y", -27.0, -12.0)
        for s in (1, -1)
    ]
    label = prism([(x, z, 2.0) for x, z in _square(0.0, 6.5, 13.0, 20.5)], "y", -39.5, -38.0)
    plate = prism(_face(0.97), "y", -1.0, BACK)
    discs = [
        prism([(x + u, z + v) for u, v in ring(DISC_RADIUS, 14)], "y", BACK, DISC_BACK)
        for x, z in DISCS
    ]
    neck = turned([(0, 47.5), (11, 47.5), (11, 54), (7.4, COLLAR), (0, COLLAR)])
    return (
        Part("accent", shell),
        Part("cover", label),
        Part("joint", fuse(plate, neck, *latches)),
        Part("steel", fuse(*discs)),
    )


def shaft(length: float) -> tuple[Part, ...]:
    """Return the tube from the housing to the wrist, and the fork that carries the wrist.

    Args:
        length: from the insertion's frame to the pitch axis [mm]
    """
    tube = rod((0, 0, COLLAR - length), (0, 0, -13.0), SHAFT_RADIUS)
    side: list[Corner] = [(-9, -13.0), (9, -13.0), (9, -7.0), (3.7, -5.0, 3.0), (EAR_RADIUS, -0.6)]
    side += [(-EAR_RADIUS, -0.6), (-3.7, -5.0, 3.0), (-9, -7.0)]
    ears = fuse(prism(side, "y", -9, 9), rod((0, -9, 0), (0, 9, 0), EAR_RADIUS))
    fork = common(ears, rod((0, 0, -13.0), (0, 0, 9), SHAFT_RADIUS))
    slot = prism([(-9, -3.9), (9, -3.9), (9, 9), (-9, 9)], "y", -SHAFT_GAP, SHAFT_GAP)
    fork = cut(fork, slot)
    caps = [rod((0, s * 3.0, 0), (0, s * 4.2, 0), 1.3) for s in (1, -1)]
    return Part("black", tube), Part("steel", fuse(fork, *caps))


def clevis(length: float) -> tuple[Part, ...]:
    """Return the wrist: a pulley between the fork's ears, and ears for the fingers.

    Args:
        length: from the pitch axis to the yaw axis, along -x [mm]
    """
    half = SHAFT_GAP - AIR
    wide, root = -2.9, -(length - 5.0)
    top: list[Corner] = [(1.0, 2.0), (wide, 3.3, 0.4), (root, 3.3, 0.5), (-(length - 3.6), 2.35)]
    top += [(-length, 2.35)]
    side: list[Corner] = [(0.0, 2.0), (wide, 3.75, 0.6), (-length - 9, 3.75)]
    plan = fuse(prism(both(top, 1), "y", -9, 9), rod((-length, -9, 0), (-length, 9, 0), 2.35))
    body = common(plan, prism(both(side, 1), "z", -9, 9), rod((2, 0, 0), (-length - 4, 0, 0), 4.1))
    fork = [box((-2.85, -9, min(s * half, s * 9)), (9, 9, max(s * half, s * 9))) for s in (1, -1)]
    floor = rod((-length, -HALF_GAP, 0), (-length, HALF_GAP, 0), 2.9)
    sweep = prism(
        both(
            [(-length + 2.4, 0.4), (-length + 4.0, 1.6), (root, 3.5), (root, 9), (-length - 9, 9)],
            1,
        ),
        "y",
        -HALF_GAP,
        HALF_GAP,
    )
    body = cut(body, *fork, floor, sweep)
    r, w = 2.4, half
    wheel = [(r, 0.2 * w), (r - 0.5, 0.5 * w), (r, 0.8 * w), (r, w), (0, w)]
    wheel = [*((a, -b) for a, b in reversed(wheel)), *wheel]
    caps = [rod((-length, s * 3.0, 0), (-length, s * 3.9, 0), 1.25) for s in (1, -1)]
    return (Part("steel", fuse(body, turned(wheel), *caps)),)


def pin() -> tuple[Part, ...]:
    """Return the pin that the fingers turn on."""
    return (Part("steel", rod((0, 0, -HALF_GAP), (0, 0, HALF_GAP), 0.8)),)


@cache
def _pair(family: str) -> Pair:
    return FAMILIES[family]()


def _face(scale: float) -> list[Corner]:
    """Return the housing's outline (x, z): rounded at the back, narrower at the shaft."""
    half = [(23, -26, 9), (23, 34, 14), (11, 48, 8)]
    return [(scale * x, 11 + scale * (z - 11), r) for x, z, r in both(half, 0)]


def _housing_hull() -> Shape:
    """Return what touches of the housing: its shell with plain corners."""
    return prism([(x, z) for x, z, *_ in _face(1.0)], "y", -39.0, DISC_BACK)


def _shaft_hull(length: float) -> Shape:
    """Return what touches of the shaft: an octagonal rod about the tube."""
    corners = ring(SHAFT_RADIUS / np.cos(np.pi / 8), 8)
    return prism(corners, "z", COLLAR - length, 2.0)


def _square(x: float, z: float, wide: float, tall: float) -> list[tuple[float, float]]:
    """Return the corners of a rectangle from its centre and half its edges."""
    return [(x - wide, z - tall), (x + wide, z - tall), (x + wide, z + tall), (x - wide, z + tall)]


def _distance(arm: ArmDescription, frame: str, other: str) -> float:
    """Return how far two frames are apart at zero [mm]."""
    zero = np.zeros(len(arm.mechanism.joints))
    return 1e3 * float(np.linalg.norm(pose(arm.mechanism, zero, frame, other)[:3, 3]))
