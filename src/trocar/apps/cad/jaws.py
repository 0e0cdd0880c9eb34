"""The jaws of the EndoWrist instruments: a pair of fingers for each family.

A finger is drawn in the frame of its axis: the jaws lie along -y and meet where x = 0. The left one
has x > 0 and the upper half of the hub (z > 0), the right one the rest. Sizes: our own choice,
after photographs; the gripping faces are flat, as far as the pads reach that touch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from build123d import Axis, Face, Location, Plane, Polyline, ThreePointArc, loft, make_face
from build123d.topology import Shape

from trocar.apps.cad.forms import (
    Corner,
    both,
    box,
    common,
    cut,
    flipped,
    fuse,
    mirrored,
    outline,
    prism,
    rod,
    turned,
)
from trocar.apps.cad.link import Part

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
