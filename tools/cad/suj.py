"""The setup joints that carry the arms: a carriage on the column, two long arms, what hangs there.

Heights of covers, drums and brackets are our own choice, after photographs and dvrk_env's sizes.
"""

from __future__ import annotations

import numpy as np
from build123d import Plane
from build123d.topology import Shape

from tools.cad import kit
from tools.cad.forms import bevelled, box, common, edges_at, fuse, prism, rounded
from tools.cad.kit import Hinge, hinge
from tools.cad.links import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.kinematics.forward import pose
from trocar.kinematics.mechanism import Mechanism

#: The lower and upper face of the first and of the second arm, in their frames. [mm]
LOWER_ARM, UPPER_ARM = (-39.0, 87.0), (-28.0, 96.0)
#: What moving faces keep free. [mm]
AIR = 2.0
#: How far the housing of the fifth joint reaches past its axis' crossing with the fourth. [mm]
DRUM_FRONT, DRUM_BACK = 61.0, 106.0
#: The top of the bracket under the sixth joint, and the flange on it, in that joint's frame. [mm]
BRACKET_TOP, FLANGE = -46.0, (-33.0, -6.0)


def links(arm: ArmDescription) -> tuple[Link, ...]:
    """Return the links of a setup arm; PSM1 and PSM2 have the same."""
    m = arm.mechanism
    group = arm.name.removeprefix("suj_").replace("psm1", "psm").replace("psm2", "psm")
    drawn = [_carriage(m), _lower_arm(m), _upper_arm(m)]
    if "suj_5" in m.frame_names and m.frame("suj_5").motion == "revolute":
        drawn += [_elbow(m), _bracket(m), _flange()]
    else:
        drawn += [_hanger(m)]
    return tuple(Link(f"{group}_{k.name}", k.frame, k.parts, k.convex) for k in drawn)


def _carriage(m: Mechanism) -> Link:
    """Return what slides on the column and carries the first arm on a brake drum."""
    axis = _upright(hinge(m, "suj_1", "suj_2"))
    low, top = 25.0, _origin(m, "suj_2", "suj_1")[2] + LOWER_ARM[0] - AIR
    plan = kit.hull([(0, 0, 58), (-112, 46, 14), (-112, -46, 14)])
    shell = kit.plate(plan, low, top - 46, 14.0, round_off=True)
    drum = kit.turning(
        axis,
        [(0, top - 50), (55, top - 50), (55, top - 24), (50, top - 21), (50, top), (0, top)],
    )
    shoes = [box((-135, -36, z), (-120, 36, z + 70), 6.0, "x") for z in (low + 20, top - 150)]
    parts = (Part("cover", shell), Part("joint", fuse(drum, *shoes)))
    return Link("carriage", "suj_1", parts, (kit.plate(plan, low, top),))


def _lower_arm(m: Mechanism) -> Link:
    """Return the arm from the carriage to the next upright axis."""
    near, far = _own(), _upright(hinge(m, "suj_2", "suj_3"))
    low, high = LOWER_ARM
    top = _origin(m, "suj_3", "suj_2")[2] + UPPER_ARM[0] - AIR
    drum = kit.turning(
        far, [(0, high - 2), (52, high - 2), (52, top - 7), (47, top - 4), (47, top), (0, top)]
    )
    parts = _boom(near, far, (66, 58), low, high)
    parts += (Part("joint", drum), Part("casting", kit.cap(near, high - 1, high + 7, 46)))
    return Link("lower_arm", "suj_2", parts, (_boom_hull(near, far, (66, 58), low, high),))


def _upper_arm(m: Mechanism) -> Link:
    """Return the arm to the axis that the rest hangs from, or stands on."""
    near, far = _own(), _upright(hinge(m, "suj_3", "suj_4"))
    low, high = UPPER_ARM
    parts = _boom(near, far, (58, 54), low, high)
    caps = [kit.cap(near, high - 1, high + 7, 42)]
    hangs = _origin(m, "suj_4", "suj_3")[2] < 0.0
    caps.append(kit.cap(far, *((high - 1, high + 7) if hangs else (low + 1, low - 7)), 40))
    parts += (Part("casting", fuse(*caps)),)
    return Link("upper_arm", "suj_3", parts, (_boom_hull(near, far, (58, 54), low, high),))


def _boom(
    near: Hinge, far: Hinge, radii: tuple[float, float], low: float, high: float
) -> tuple[Part, ...]:
    """Return a long arm: a cast tray, and a rounded cover on it."""
    seam = low + 0.24 * (high - low)
    discs = [near.disc(radii[0]), far.disc(radii[1])]
    tray = [near.disc(radii[0] - 3), far.disc(radii[1] - 3)]
    cover = kit.plate(kit.hull(discs), seam, high)
    return (
        Part("casting", kit.plate(kit.hull(tray), low, seam)),
        Part("cover", rounded(edges_at(cover, "z", high), 18.0)),
    )


def _boom_hull(
    near: Hinge, far: Hinge, radii: tuple[float, float], low: float, high: float
) -> Shape:
    """Return what touches of a long arm: an eight-cornered plate about it."""
    (x0, y0, a), (x1, y1, b) = near.disc(radii[0]), far.disc(radii[1])
    half = 0.42
    points = [(x0 - a, -half * a + y0), (x0 - half * a, y0 - a), (x1 + half * b, y1 - b)]
    points += [(x1 + b, y1 - half * b), (x1 + b, y1 + half * b), (x1 + half * b, y1 + b)]
    points += [(x0 - half * a, y0 + a), (x0 - a, y0 + half * a)]
    return kit.plate(kit.polygon(points), low, high)


def _elbow(m: Mechanism) -> Link:
    """Return the post under (or on) the upper arm and the drum of the fifth joint across it."""
    start = _face_of_upper_arm(m)
    toward = 1.0 if start > 0.0 else -1.0
    across = _through_origin(hinge(m, "suj_4", "suj_5"))
    drum = [(0, -DRUM_BACK), (34, -DRUM_BACK), (48, -DRUM_BACK + 7), (52, -DRUM_BACK + 22)]
    drum += [(52, DRUM_FRONT - 14), (47, DRUM_FRONT - 9), (0, DRUM_FRONT - 9)]
    front = [
        (0, DRUM_FRONT - 10),
        (44, DRUM_FRONT - 10),
        (44, DRUM_FRONT - AIR),
        (0, DRUM_FRONT - AIR),
    ]
    end = toward * 28.0
    post = [(0, start), (47, start), (47, start - toward * 16), (41, start - toward * 20)]
    post += [(41, end), (0, end)]
    parts = (
        Part("cover", kit.turning(across, drum)),
        Part("joint", fuse(kit.turning(_own(), post), kit.turning(across, front))),
    )
    block = kit.prism(across, -DRUM_BACK, DRUM_FRONT - AIR, 52.0, 8)
    return Link(
        "elbow",
        "suj_4",
        parts,
        (block, kit.prism(_own(), min(start, end), max(start, end), 44.0, 8)),
    )


def _bracket(m: Mechanism) -> Link:
    """Return the bracket that leads from the drum down and along, under the sixth joint."""
    back = DRUM_FRONT - _depth(m)
    top = float(_origin(m, "suj_6", "suj_5")[1]) + BRACKET_TOP
    bottom, front = top - 40.0, back + 36.0
    side = [(54, back, 16), (54, front, 16), (top + 34, front, 8), (top, front + 34, 12)]
    side += [(top, 62), (bottom, 62), (bottom, back + 60, 30), (bottom + 60, back, 30)]
    body = prism(side, "x", -46, 46)
    body = rounded([e for f in body.faces().filter_by(Plane.YZ) for e in f.edges()], 8.0)
    plan = prism([(-46, back - 1), (46, back - 1), (46, 45, 44), (-46, 45, 44)], "y", -400, 90)
    rear = prism([(-46, 53, 44), (46, 53, 44), (46, bottom - 1), (-46, bottom - 1)], "z", -900, 90)
    shell = common(body, plan, rear)
    below = _through_origin(hinge(m, "suj_5", "suj_6"))
    drum = kit.pin(below, top - 1, top + 8, 40.0)
    ring = kit.pin(_own(), back - AIR + 1, back + 1, 44.0)
    parts = (Part("cover", shell), Part("joint", fuse(drum, ring)))
    upright = box((-46, bottom, back), (46, 54, front))
    return Link("bracket", "suj_5", parts, (upright, box((-46, bottom, back), (46, top, 46))))


def _flange() -> Link:
    """Return the plate that turns on the bracket and holds the arm's base behind its yaw axis."""
    low, high = FLANGE
    plan = kit.hull([(0, 0, 46), (-266, 0, 42)])
    plate = kit.plate(plan, low, high)
    parts = (
        Part("casting", bevelled(edges_at(plate, "z", high), 5.0)),
        Part("joint", kit.pin(_own(), BRACKET_TOP + 9, low + 1, 44.0)),
        Part("cover", kit.cap(_own(), high, high + 8, 34.0)),
    )
    return Link("flange", "suj_6", parts, (plate,))


def _hanger(m: Mechanism) -> Link:
    """Return the bent post that the endoscope's arm hangs from, and the plate that it stands on."""
    start = _face_of_upper_arm(m)
    seat = pose(m, np.zeros(len(m.joints)), "suj_6", "suj_4")
    plate = kit.rounded_box((-14, 0, -13), (124, 104, 26), 8.0, 20.0)
    at = kit.location(seat)
    bends = [(0.0, start - 56.0, 42.0)]
    for x, z, radius in ((-146.0, 52.0, 31.0), (-116.0, -22.0, 30.0), (-30.0, -34.0, 24.0)):
        y, up = (kit.MM * seat[:3, 3] + seat[:3, 0] * x + seat[:3, 2] * z)[1:]
        bends.append((float(y), float(up), radius))
    turn = Plane.YZ.location
    post = turn * kit.plate(kit.outline(bends), -33, 33, 9.0, round_off=True)
    drum = [
        (0, start),
        (47, start),
        (47, start - 16),
        (42, start - 20),
        (42, start - 60),
        (0, start - 60),
    ]
    parts = (
        Part("cover", post),
        Part("joint", kit.turning(_own(), drum)),
        Part("casting", at * plate),
    )
    touch = [turn * kit.plate(kit.hull(bends[k : k + 2]), -33, 33) for k in (0, 1, 2)]
    return Link("hanger", "suj_4", parts, (*touch, at * plate))


def _own() -> Hinge:
    return Hinge(np.zeros(3), np.array([0.0, 0.0, 1.0]))


def _upright(axis: Hinge) -> Hinge:
    """Return the axis with its point in the plane z = 0."""
    return Hinge(axis.at(0.0), axis.direction)


def _through_origin(axis: Hinge) -> Hinge:
    """Return the axis with its point nearest to the origin."""
    return Hinge(axis.point - axis.direction * (axis.point @ axis.direction), axis.direction)


def _origin(m: Mechanism, frame: str, link: str) -> np.ndarray:
    """Return the origin of a frame in another at zero, (3,) [mm]."""
    return kit.MM * pose(m, np.zeros(len(m.joints)), frame, link)[:3, 3]


def _depth(m: Mechanism) -> float:
    """Return how far the fifth frame lies from the fourth along the fifth axis [mm]."""
    return -float(_origin(m, "suj_4", "suj_5")[2])


def _face_of_upper_arm(m: Mechanism) -> float:
    """Return the height of the upper arm's nearer face in the fourth frame [mm]."""
    rise = float(_origin(m, "suj_4", "suj_3")[2])
    return (UPPER_ARM[0] - AIR if rise < 0.0 else UPPER_ARM[1] + AIR) - rise
