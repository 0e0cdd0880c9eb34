"""The EndoWrist instruments: housing, shaft, wrist and jaws, on the axes of the description.

Sizes that are no distance between axes are our own choice, after photographs; the shaft is 8.4 mm
thick (Source: today's description).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from build123d import Axis, Face, Location, Plane, Polyline, ThreePointArc, loft, make_face
from build123d.topology import Shape

from tools.cad.forms import (
    Corner,
    bevelled,
    both,
    box,
    common,
    cut,
    edges_at,
    flipped,
    fuse,
    mirrored,
    outline,
    prism,
    ring,
    rod,
    turned,
)
from tools.cad.links import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError
from trocar.kinematics.forward import pose

#: Half of the gap between the ears of the wrist, and what turning parts keep free. [mm]
HALF_GAP, AIR = 2.25, 0.05
#: Of the fingers' pulleys, and within which a finger fits between the ears. [mm]
HUB_RADIUS, ROOT_RADIUS = 2.3, 4.2


@dataclass(frozen=True, eq=False)
class Finger:
    """One finger: what is seen, and what touches."""

    parts: tuple[Part, ...]
    convex: tuple[Shape, ...]


Pair = tuple[Finger, Finger]


def hub(side: int) -> Shape:
    """Return the pulley of the left (1) or right (-1) finger on the hinge's axis."""
    r, low, high = HUB_RADIUS, AIR, HALF_GAP - AIR
    middle = 0.5 * (low + high)
    groove = [(r, middle - 0.5), (r - 0.45, middle), (r, middle + 0.5)]
    left = turned([(0, low), (r, low), *groove, (r, high), (0, high)])
    return left if side > 0 else left.rotate(Axis.X, 180.0)


def on_hub(blade: Shape, side: int) -> Shape:
    """Return a blade with its hub, clear of the other finger's hub and of the wrist's ears."""
    other = rod((0, 0, -12 * side), (0, 0, AIR * side), HUB_RADIUS + AIR)
    gap = HALF_GAP - AIR
    ears = [rod((0, 0, z * gap), (0, 0, z * 12), ROOT_RADIUS) for z in (1, -1)]
    return fuse(cut(blade, other, *ears), hub(side))


def needle_driver() -> Pair:
    """Return the short, strong, serrated jaws of the needle driver."""
    side: list[Corner] = [(0, -1.6), (0, -10.5), (0.9, -10.5, 0.6), (1.55, -8.6, 2.0)]
    side += [(1.95, -5.0, 2.0), (1.9, -2.2), (1.2, -1.2)]
    front: list[Corner] = [(-1, -1.8), (-8.4, -1.8, 1.0), (-10.5, -1.3, 0.5)]
    blade = _blade(side, both(front, 1))
    blade = cut(blade, *_teeth(-10.0, -3.8, 0.5, 0.14))
    pad = box((0, -10.5, -1.8), (1.7, -0.3, 1.8))
    return _alike([("steel", blade)], [pad])


def prograsp() -> Pair:
    """Return the long, broad jaws with a window and coarse teeth."""
    side: list[Corner] = [(0, -1.6), (0, -28), (0.9, -28, 0.8), (1.75, -24.5, 6.0)]
    side += [(1.95, -9.0, 6.0), (1.9, -2.2), (1.2, -1.2)]
    front: list[Corner] = [(-1, -2.0), (-4.3, -2.0, 1.0), (-6.0, -2.6, 1.5), (-25.6, -2.6, 1.5)]
    front += [(-28, -1.5, 1.4)]
    return _windowed(side, front, _window(-24.6, -7.6, 1.2), (-26.0, -6.0, 1.2, 2.6, 1.8), 1.4)


def fenestrated() -> Pair:
    """Return the bipolar jaws with a window and a round end, insulated at their root."""
    side: list[Corner] = [(0, -1.6), (0, -21), (0.55, -21, 0.5), (1.25, -18.6, 4.0)]
    side += [(1.45, -7.0, 3.0), (1.85, -4.4, 1.0), (1.9, -2.2), (1.2, -1.2)]
    front: list[Corner] = [(-1, -1.9), (-4.4, -1.9, 1.0), (-5.6, -2.0, 1.0), (-21, -2.0, 1.95)]
    slot = _window(-18.6, -6.6, 0.9)
    return _windowed(side, front, slot, (-19.5, -4.5, 0.9, 2.0, 1.4), 0.0, insulated=True)


def maryland() -> Pair:
    """Return the thin, curved, pointed bipolar jaws."""
    path = [(-1.8, 0.0, 1.75, 1.9), (-5.0, 0.0, 1.6, 1.6), (-9.0, 0.25, 1.35, 1.3)]
    path += [(-14.5, 1.3, 1.05, 1.05), (-18.4, 2.9, 0.75, 0.75), (-20.0, 3.75, 0.4, 0.45)]
    blade = _curved([_dome(*row) for row in path])
    pads = [_curved([_facets(*path[i]), _facets(*path[j])]) for i, j in ((2, 3), (3, 5))]
    return _alike([*_insulate(blade)], pads)


def scissors() -> Pair:
    """Return the curved blades, which slide along each other on a surface about the hinge."""
    shear = [(0, 0.0), (7.5, 0.0), (10.0, 0.3), (12.0, 0.8), (14.4, 1.65)]
    thick = [0.95, 0.95, 0.85, 0.75, 0.6]
    edge: list[Corner] = [
        (-0.5, -1.0),
        (-0.85, -8.6, 3.0),
        (-0.35, -14.0, 0.25),
        (0.35, -14.1, 0.3),
    ]
    edge += [(1.55, -9.6, 4.0), (1.9, -4.5, 2.0), (1.9, -1.0)]
    fingers: list[Finger] = []
    for side in (1, -1):
        face = [(r, z + side * 0.02) for r, z in shear]
        back = [(r, z + side * t) for (r, z), t in zip(shear, thick, strict=True)]
        corners = edge if side > 0 else flipped(edge, 0)
        blade = common(prism(corners, "z", -12, 12), turned([*face, *reversed(back)]))
        fingers.append(Finger((Part("steel", on_hub(blade, side)),), _shears(side)))
    return fingers[0], fingers[1]


#: Each family by the first words of its instruments' names.
FAMILIES: dict[str, Callable[[], Pair]] = {
    "LARGE_NEEDLE_DRIVER": needle_driver,
    "PROGRASP_FORCEPS": prograsp,
    "FENESTRATED_BIPOLAR_FORCEPS": fenestrated,
    "MARYLAND_BIPOLAR_FORCEPS": maryland,
    "MONOPOLAR_CURVED_SCISSORS": scissors,
}


def _blade(side: Sequence[Corner], front: Sequence[Corner]) -> Shape:
    """Return what two outlines have in common: (x, y) seen along the hinge, (y, z) from x."""
    return common(prism(side, "z", -12, 12), prism(front, "x", -12, 12))


def _alike(blades: Sequence[tuple[str, Shape]], pads: Sequence[Shape]) -> Pair:
    """Return a pair whose right blade mirrors the left; the first blade stands on the hub."""
    fingers: list[Finger] = []
    for side in (1, -1):
        drawn = [(m, b if side > 0 else mirrored(b, "x")) for m, b in blades]
        parts = tuple(Part(m, on_hub(b, side) if i == 0 else b) for i, (m, b) in enumerate(drawn))
        fingers.append(Finger(parts, tuple(p if side > 0 else mirrored(p, "x") for p in pads)))
    return fingers[0], fingers[1]


def _windowed(
    side: list[Corner],
    front: list[Corner],
    window: Shape,
    rail: tuple[float, float, float, float, float],
    pitch: float,
    *,
    insulated: bool = False,
) -> Pair:
    """Return jaws with a window; the rails beside it touch."""
    blade = cut(_blade(side, both(front, 1)), window)
    start, end, inner, outer, thickness = rail
    if pitch:
        blade = cut(blade, *_teeth(start, end, pitch, 0.3))
    pads = [
        box((0, start, min(a, b)), (thickness, end, max(a, b)))
        for a, b in ((inner, outer), (-inner, -outer))
    ]
    return _alike(_insulate(blade) if insulated else [("steel", blade)], pads)


def _insulate(blade: Shape) -> list[tuple[str, Shape]]:
    """Return the black root and the steel jaw of a bipolar blade."""
    near = box((-9, -5.2, -9), (9, 9, 9))
    return [("black", common(blade, near)), ("steel", cut(blade, near))]


def _teeth(start: float, end: float, pitch: float, depth: float) -> list[Shape]:
    """Return notches across the gripping face from `start` to `end` along y."""
    count = int((end - start) / pitch)
    half = 0.3 * pitch
    return [
        prism(
            [(-1, y - half), (0, y - half), (depth, y), (0, y + half), (-1, y + half)], "z", -9, 9
        )
        for y in (start + (k + 0.5) * pitch for k in range(count))
    ]


def _window(start: float, end: float, half: float) -> Shape:
    """Return a slot along y with round ends, through the blade."""
    side = [(start, -half, 0.98 * half), (end, -half, 0.98 * half)]
    return prism(both(side, 1), "x", -9, 9)


def _dome(y: float, z: float, height: float, half: float) -> Face:
    """Return a section of a blade: flat at x = 0, round on its back."""
    arc = ThreePointArc((0, -half), (height, 0), (0, half))
    face: Any = make_face(Polyline((0, half), (0, -half)) + arc)
    return _across(face, y, z)


def _facets(y: float, z: float, height: float, half: float) -> Face:
    """Return the same section with five corners, inside the round one."""
    side = [(0, -half), (0.7 * height, -0.7 * half), (height, 0)]
    face = outline([*side, *flipped(side[:2], 1)])
    return _across(face, y, z)


def _across(face: Any, y: float, z: float) -> Face:
    """Return a face of (x, z) in the plane across y."""
    return Plane(origin=(0, y, z), x_dir=(1, 0, 0), z_dir=(0, 1, 0)).location * face


def _curved(sections: Sequence[Face]) -> Shape:
    return loft(sections, ruled=len(sections) == 2)


def _shears(side: int) -> tuple[Shape, ...]:
    """Return what touches of a scissor blade: two slabs, the outer one bent up by 14 deg."""
    near = box((-1.3, -3.3, -0.4), (1.3, 3.3, 0.4)).moved(Location((0.5 * side, -6.2, 0.45 * side)))
    far = box((-0.85, -2.7, -0.35), (0.85, 2.7, 0.35)).rotate(Axis.X, -14.0)
    return near, far.moved(Location((0.4 * side, -11.4, 0.65 + 0.45 * side)))


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
