"""The surgeon's masters: yoke, upper arm and forearm with its parallelogram, gimbal, gripper.

Drawn for the left hand in each link's own frame; the right hand's is the mirror image in the plane
that the arm lies in at zero. Across that plane the links lie side by side: yoke (negative side),
upper arm, rod, crank (positive side). Widths and covers are our own choice, after photographs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from build123d import Plane
from build123d.topology import Shape

from tools.cad import kit
from tools.cad.forms import Direction, bevelled, box, cut, edges_at, fuse, mirrored, outline
from tools.cad.kit import Hinge, hinge
from tools.cad.links import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism

#: Across the arm's plane: the yoke's cheek, half the upper arm, its eye, the rod, the crank. [mm]
CHEEK, ARM, EYE, ROD, CRANK = (-46.0, -28.0), 14.0, 8.5, (21.0, 33.0), (40.0, 54.0)
#: The hub under the panel, from the shoulder up: its lower and upper face. [mm]
HUB = (204.0, 254.0)

#: A finger's lever from its hinge to its tip: out, along, radius of the corner. [mm]
LEVER = [(4, -4), (8.5, -4, 3), (10.5, 16, 8), (11.5, 56, 2), (6.5, 56, 2), (6.0, 18, 8), (4, 6)]

Drawing = tuple[tuple[Part, ...], tuple[Shape, ...]]


def links(arm: ArmDescription) -> tuple[Link, ...]:
    """Return the links of a master; those of MTMR mirror those of MTML."""
    m = arm.mechanism
    across = _across(m)
    found: list[Link] = []
    for frame, draw in DRAWINGS.items():
        parts, convex = draw(m)
        if arm.name == "mtmr":
            parts = tuple(Part(p.material, mirrored(p.solid, across[frame])) for p in parts)
            convex = tuple(mirrored(solid, across[frame]) for solid in convex)
        found.append(Link(f"{arm.name}_{frame}", frame, parts, convex))
    return tuple(found)


def _across(m: Mechanism) -> dict[str, Direction]:
    """Return which axis of each frame lies across the arm's plane at zero."""
    axes: tuple[Direction, ...] = ("x", "y", "z")
    at = poses(m, np.zeros(len(m.joints)), m.frames[0].name)
    return {name: axes[int(np.argmax(np.abs(at[name][0, :3])))] for name in m.frame_names}


def _base(m: Mechanism) -> Drawing:
    """Return the panel that the arm hangs from."""
    axis = _line(hinge(m, "base", "outer_yaw"))
    low = HUB[1] + 2.0
    panel = box((-88, -88, low), (88, 88, low + 32), 24.0, "z")
    panel = bevelled(edges_at(panel, "z", low), 5.0)
    motor = kit.turning(
        axis, [(0, low + 30), (52, low + 30), (52, low + 62), (44, low + 72), (0, low + 72)]
    )
    parts = (Part("casting", panel), Part("joint", motor))
    return parts, (box((-88, -88, low), (88, 88, low + 32)),)


def _yoke(m: Mechanism) -> Drawing:
    """Return the hub of the outer yaw, with one cheek down to the shoulder."""
    yaw, shoulder = (
        _line(hinge(m, "outer_yaw", "outer_yaw")),
        _line(hinge(m, "outer_yaw", "shoulder_pitch")),
    )
    low, high = HUB
    hub = kit.turning(
        yaw, [(0, low), (38, low), (46, low + 8), (46, high - 5), (42, high), (0, high)]
    )
    cheek = kit.plate(kit.hull([(0, 0, 32), (0, low - 20, 40)]), *CHEEK, 6.0, round_off=True)
    bridge = box((-34, low - 16, CHEEK[0] + 6), (34, low + 12, 28), 10.0, "z")
    ring = kit.pin(yaw, high - 16, high - 10, 47.0)
    caps = [
        kit.cap(shoulder, CHEEK[0] + 1, CHEEK[0] - 9, 27),
        kit.pin(shoulder, CHEEK[1] - 1, -ARM - 1, 22),
    ]
    pin = kit.pin(shoulder, CHEEK[1], CRANK[1] + 2, 11.0, 1.5)
    parts = (
        Part("cover", fuse(cheek, bridge, hub)),
        Part("joint", fuse(ring, *caps)),
        Part("steel", pin),
    )
    touch = (
        kit.prism(yaw, low - 16, high, 46.0, 8),
        box((-36, -30, CHEEK[0]), (36, low, CHEEK[1])),
    )
    return parts, touch


def _upper_arm(m: Mechanism) -> Drawing:
    """Return the upper arm: a slim beam, an eye at the elbow, the weight behind the shoulder."""
    shoulder, elbow = (
        hinge(m, "shoulder_pitch", "shoulder_pitch"),
        _line(hinge(m, "shoulder_pitch", "elbow_pitch")),
    )
    back, x, y = shoulder.disc(27.0), float(shoulder.point[0]), float(shoulder.point[1])
    beam = kit.plate(kit.hull([back, (-86.0, 0.0, 18.0)]), -ARM + 1, ARM - 1, 6.0, round_off=True)
    neck = kit.plate(kit.hull([(-98.0, 0.0, 12.0), elbow.disc(12.0)]), -EYE, EYE)
    eye = kit.pin(elbow, -EYE, EYE, 21.0)
    tail = kit.plate(kit.hull([(x, y, 20.0), (x - 120, y, 16.0)]), -ARM + 2, ARM - 2, 3.0)
    weight = kit.plate(
        kit.polygon(
            [(x - 182, y - 52), (x - 104, y - 58), (x - 104, y + 58), (x - 182, y + 52)], 16.0
        ),
        -ARM - 4,
        ARM + 2,
        5.0,
        round_off=True,
    )
    caps = [kit.cap(shoulder, ARM - 2, ARM + 3, 22)]
    pin = kit.pin(elbow, -19.0, 19.0, 7.0, 1.0)
    parts = (
        Part("cover", fuse(beam, neck, eye)),
        Part("casting", tail),
        Part("joint", fuse(weight, *caps)),
        Part("steel", pin),
    )
    lever = box((x - 30, y - 22, -ARM), (20, y + 22, ARM))
    return parts, (lever, box((x - 182, y - 58, -ARM - 4), (x - 104, y + 58, ARM + 2)))


def _forearm(m: Mechanism) -> Drawing:
    """Return the forearm: a fork about the upper arm, a tail for the rod, a hub at its end."""
    elbow, wrist = (
        hinge(m, "elbow_pitch", "elbow_pitch"),
        _line(hinge(m, "elbow_pitch", "wrist_platform")),
    )
    x = float(elbow.point[0])
    end = float(next(c.point_b[0] for c in m.closures)) * kit.MM
    turn = Plane(origin=(0, 0, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0)).location  # x, z up, across -y
    fork = turn * kit.plate(kit.hull([(x, 0, 21), (x + 90, 0, 18)]), -17, 17, 4.0)
    beam = turn * kit.plate(kit.hull([(x + 70, 0, 17), (-30, 0, 13)]), -12, 12, 5.0, round_off=True)
    tail = turn * kit.plate(kit.hull([(x, 0, 17), (end, 0, 12)]), -15, 17, 3.0)
    slot = box((x - 46, -EYE - 1, -30), (x + 38, EYE + 1, 30))
    lug = turn * kit.plate(kit.hull([(end, 0, 12), (end + 30, 0, 12)]), 8, ROD[0] - 1)
    hub = kit.turning(wrist, [(0, -22), (15, -22), (22, -16), (22, 22), (19, 25), (0, 25)])
    at_end = Hinge(np.array([end, 0.0, 0.0]), np.array([0.0, -1.0, 0.0]))
    pin = kit.pin(at_end, 12.0, ROD[1] + 3, 5.0, 1.0)
    caps = [kit.cap(Hinge(elbow.point, np.array([0.0, s, 0.0])), 16, 21, 15) for s in (1.0, -1.0)]
    body = fuse(cut(fuse(fork, tail), slot), beam, lug)
    parts = (
        Part("cover", body),
        Part("joint", fuse(hub, *caps)),
        Part("steel", pin),
    )
    touch = (box((end - 12, -17, -18), (0, 17, 18)), kit.prism(wrist, -22, 25, 22.0, 8))
    return parts, touch


def _crank(m: Mechanism) -> Drawing:
    """Return the crank beside the shoulder, with its weight."""
    own, rod = _line(hinge(m, "elbow_bar", "elbow_bar")), hinge(m, "elbow_bar", "elbow_rod")
    low, high = CRANK
    lever = kit.plate(kit.hull([own.disc(26), rod.disc(17)]), low, high, 4.0, round_off=True)
    x = float(rod.point[0])
    weight = kit.plate(
        kit.polygon([(x - 36, -38), (x + 44, -44), (x + 44, 44), (x - 36, 38)], 14.0),
        high + 2,
        high + 34,
        5.0,
        round_off=True,
    )
    neck = kit.pin(rod, high - 1, high + 4, 14.0)
    pin = kit.pin(rod, ROD[0] - 2, low + 1, 6.0, 1.0)
    cap = kit.cap(own, high - 1, high + 6, 18)
    parts = (Part("casting", lever), Part("joint", fuse(weight, neck, cap)), Part("steel", pin))
    return parts, (box((-24, -22, low), (x + 16, 22, high)), weight)


def _rod(m: Mechanism) -> Drawing:
    """Return the rod from the crank to the forearm's tail."""
    near, far = _line(hinge(m, "elbow_rod", "elbow_rod")), hinge(m, "elbow_rod", "c1")
    low, high = ROD
    body = kit.plate(kit.hull([near.disc(9), far.disc(9)]), low + 2, high - 2, 3.0, round_off=True)
    eyes = [kit.pin(at, low, high, 13.0, 1.5) for at in (near, far)]
    parts = (Part("cover", body), Part("casting", fuse(*eyes)))
    return parts, (box((0, -9, low), (float(far.point[0]), 9, high)),)


def _bracket(
    own: Hinge,
    following: Hinge,
    along: tuple[float, float],
    out: tuple[float, float],
    radii: tuple[float, float],
) -> Shape:
    """Return an angle that turns about one axis and carries the next, which crosses it.

    Args:
        own, following: axes through the origin
        along: where its first leg lies along its own axis, on one side of the crossing [mm]
        out: where its second leg lies along the following axis [mm]
        radii: of the eyes about the two axes [mm]
    """
    side = 1.0 if along[0] > 0 else -1.0
    far, near = (along[1], along[0]) if side > 0 else along
    corners = [
        (far, 0.0),
        (far, out[1], 16.0),
        (0.0, out[1]),
        (0.0, out[0]),
        (near, out[0], 7.0),
        (near, 0.0),
    ]
    plane = Plane(
        origin=(0, 0, 0),
        x_dir=tuple(own.direction),
        z_dir=tuple(np.cross(own.direction, following.direction)),
    )
    half = 0.86 * radii[1]
    blank = kit.plate(outline(corners), -half, half)
    leg = plane.location * blank
    ends = [
        kit.pin(own, min(along), max(along), radii[0], 1.5),
        kit.pin(following, *out, radii[1], 1.5),
    ]
    return fuse(leg, *ends)


def _gimbal(
    frame: str,
    following: str,
    along: tuple[float, float],
    out: tuple[float, float],
    hub: float,
    radii: tuple[float, float],
) -> Callable[[Mechanism], Drawing]:
    """Return what draws one of the three angles; `hub`: where its bearing ends on its own axis."""

    def draw(m: Mechanism) -> Drawing:
        own, nxt = _line(hinge(m, frame, frame)), _line(hinge(m, frame, following))
        angle = _bracket(own, nxt, along, out, radii)
        edge = along[1] if along[0] > 0 else along[0]
        bearing = kit.pin(own, min(edge, hub), max(edge, hub), radii[0] - 1.5)
        rim = kit.cap(nxt, out[1] - 1, out[1] + 3, radii[1] - 3)
        legs = _legs(own, nxt, along, out, radii)
        return (Part("casting", angle), Part("joint", fuse(bearing, rim))), legs

    return draw


def _legs(
    own: Hinge,
    following: Hinge,
    along: tuple[float, float],
    out: tuple[float, float],
    radii: tuple[float, float],
) -> tuple[Shape, Shape]:
    """Return boxes about the two legs of an angle."""
    width = np.cross(own.direction, following.direction)
    boxes: list[Shape] = []
    low, high = min(0.0, *along), max(0.0, *along)
    for a, b in ((along, (-radii[0], out[1])), ((low, high), out)):
        corners = [
            p * own.direction + q * following.direction + s * 0.86 * radii[1] * width
            for p in a
            for q in b
            for s in (-1.0, 1.0)
        ]
        boxes.append(box(np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()))
    return boxes[0], boxes[1]


def _handle(m: Mechanism) -> Drawing:
    """Return the handle between the fingers, on its bearing."""
    own = _line(hinge(m, "wrist_roll", "wrist_roll"))
    bearing = kit.turning(own, [(0, 40), (11, 40), (11, 52), (9.5, 54.5), (0, 54.5)])
    grip = [(0, -26), (5, -26), (7.5, -22), (7.5, -4), (6.2, 6), (6.2, 22), (5, 26), (5, 34)]
    grip += [(8.5, 36), (8.5, 40), (0, 40)]
    band = kit.turning(own, [(0, 36.5), (8.9, 36.5), (8.9, 39.5), (0, 39.5)])
    parts = (Part("joint", bearing), Part("black", kit.turning(own, grip)), Part("accent", band))
    return parts, (kit.prism(own, -26, 40, 8.0, 8), kit.prism(own, 40, 54.5, 11.0, 8))


def _finger(frame: str, side: float) -> Callable[[Mechanism], Drawing]:
    """Return what draws a finger's lever: hinge, spring arm, pad with its strap's slots."""

    def draw(m: Mechanism) -> Drawing:
        own = _line(hinge(m, frame, frame))
        arm = kit.plate(
            outline([(side * x, y, *r) for x, y, *r in LEVER]),
            -5.5,
            5.5,
        )
        pad = kit.rounded_box((side * 9.6, 38, 0), (4.6, 36, 17), 1.6, 1.9)
        eye = kit.pin(own, -7, 7, 3.8)
        return (Part("steel", arm), Part("black", pad), Part("joint", eye)), (
            box((min(side * 6.5, side * 11.9), 0, -8.5), (max(side * 6.5, side * 11.9), 56, 8.5)),
        )

    return draw


def _line(axis: Hinge) -> Hinge:
    """Return the axis through its point nearest to the origin, along the positive direction."""
    way = axis.direction * np.sign(axis.direction[np.argmax(np.abs(axis.direction))])
    return Hinge(axis.point - way * (axis.point @ way), np.round(way, 12) + 0.0)


#: What draws each link, in the order of the description.
DRAWINGS: dict[str, Callable[[Mechanism], Drawing]] = {
    "base": _base,
    "outer_yaw": _yoke,
    "shoulder_pitch": _upper_arm,
    "elbow_pitch": _forearm,
    "elbow_bar": _crank,
    "elbow_rod": _rod,
    "wrist_platform": _gimbal(
        "wrist_platform", "wrist_pitch", (-107, -95), (80, 92), -124.0, (20, 17)
    ),
    "wrist_pitch": _gimbal("wrist_pitch", "wrist_yaw", (-67, -57), (71, 81), -78.5, (17, 14)),
    "wrist_yaw": _gimbal("wrist_yaw", "wrist_roll", (48, 56), (56, 64), 69.5, (13, 11)),
    "wrist_roll": _handle,
    "gripper_left": _finger("gripper_left", -1.0),
    "gripper_right": _finger("gripper_right", 1.0),
}
