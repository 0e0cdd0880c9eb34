"""The links of the Patient Side Manipulator.

Side by side along the hinges (z of the pitch frames), from the middle outwards: the two long links
(to 17 mm), the plates of pitch back, pitch front and pitch end (18.5 to 28 mm), the fork of the yaw
link (34 to 47 mm). So no link runs through its neighbour, however far the arm leans.

Source: axes from the description; thicknesses and looks our own choice, after photographs of the
da Vinci Classic.
"""

from __future__ import annotations

from build123d import Plane

from tools.cad import kit
from tools.cad.kit import bar, bored, cannula, cap_pair, hinge
from tools.cad.links import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.kinematics.mechanism import Mechanism

#: Layers along the hinges, half widths [mm].
BAR, INNER, OUTER, SLOT, FORK = 17.0, 18.5, 28.0, 34.0, 47.0
#: The wall of the yaw link's fork stands this far behind the remote centre's normal [mm]: what
#: leans back most (the counterweight at its end) comes 2 mm near.
WALL, BACK, FLANGE, REAR = 238.0, 262.0, 265.0, 302.0
#: Front of the insertion rail and of the strip on it, x in pitch_end [mm].
RAIL, STRIP = 30.0, 32.0


def links(arm: ArmDescription) -> tuple[Link, ...]:
    """Return the links of a PSM without its instrument."""
    m = arm.mechanism
    return (
        _base(m),
        _yaw(m),
        _pitch_back(m),
        _pitch_front(m),
        _pitch_bottom(m),
        _pitch_top(m),
        _pitch_end(m),
        _insertion(m),
        _counterweight(),
    )


def _base(m: Mechanism) -> Link:
    """Return the flange that the setup joints hold: its axis is the yaw axis."""
    axis = hinge(m, "base", "yaw")
    turn = Plane(origin=(0, 0, 0), x_dir=(1, 0, 0), z_dir=(0, -1, 0)).location
    face = kit.hull([(0, 0, 60), (-36, -142, 14), (36, -142, 14)])
    flange = turn * kit.plate(face, FLANGE, REAR, 9.0, round_off=True)
    foot = kit.rounded_box((0, -(FLANGE + REAR) / 2, -147), (104, 44, 22), 5.0)
    seam = kit.pin(axis, BACK - 0.5, FLANGE + 1.0, 52.0)
    touch = turn * kit.plate(
        kit.polygon([(-60, 40), (-30, 62), (30, 62), (60, 40), (52, -158), (-52, -158)]),
        FLANGE,
        REAR,
    )
    parts = (Part("cover", flange), Part("casting", foot), Part("joint", seam))
    return Link("base", "base", parts, (touch,))


def _yaw(m: Mechanism) -> Link:
    """Return the fork that carries the pitch linkage between its arms."""
    back, front = hinge(m, "yaw", "pitch_back"), hinge(m, "yaw", "pitch_front")
    side = Plane(origin=(0, 0, 0), x_dir=(0, 0, -1), z_dir=(0, -1, 0))  # x forward, y up
    nose = -float(front.point[2])
    shape = kit.hull([(24 - BACK, 34, 24), (24 - BACK, -36, 24), (nose, 0, 26)])
    body = kit.plate(shape, -FORK, FORK, 9.0, round_off=True)
    opening = kit.box((-WALL, -90, -SLOT), (nose + 60, 90, SLOT))
    oval = kit.hull([(-196, 0, 34), (-112, 0, 27)])
    pods = [kit.pad(oval, t * (FORK - 4), t * (FORK + 10), 7.0, round_off=True) for t in (-1, 1)]
    shell = side.location * (body - opening + pods[0] + pods[1])
    pins = []
    for at, radius in ((back, 21.0), (front, 17.0)):
        pins += cap_pair(at, FORK, 5.0, radius)
        for t in (-1.0, 1.0):
            middle = t * (OUTER + SLOT + 1) / 2
            half = (SLOT + 1 - OUTER) / 2
            pins.append(kit.pin(at, middle - half, middle + half, 0.6 * radius))
    touch = [
        side.location
        * kit.plate(
            kit.polygon([(-BACK, 58), (-BACK, -60), (nose + 26, -26), (nose + 26, 26)]), low, high
        )
        for low, high in ((SLOT, FORK + 8), (-FORK - 8, -SLOT))
    ]
    touch.append(side.location * kit.box((-BACK, -58, -SLOT), (-WALL, 58, SLOT)))
    return Link(
        "yaw", "yaw", (Part("cover", shell), Part("joint", kit.together(pins))), tuple(touch)
    )


def _pitch_back(m: Mechanism) -> Link:
    """Return the rear rocker: two plates, the drive pack under the hinge, the weight's rail."""
    own = hinge(m, "pitch_back", "pitch_back")
    low, top = hinge(m, "pitch_back", "pitch_bottom"), hinge(m, "pitch_back", "pitch_top")
    guide = kit.axis_pose(m, "pitch_back", "counterweight")
    foot, head = (kit.point(guide, 31, 0, z)[:2] for z in (-27, 165))
    frame = kit.outline(
        [
            own.disc(20),
            low.disc(15),
            top.disc(13),
            (*head, 9.0),
            (*foot, 9.0),
            own.disc(13),
        ]
    )
    plates = kit.mirrored(kit.plate(frame, INNER, OUTER, 2.5))
    web = kit.plate(kit.hull([(26, -3, 10), (78, -7, 8)]), -INNER, INNER)
    hub = kit.pin(own, -INNER, INNER, 18.0)
    collar = kit.rounded_box((-40, -20, 0), (48, 60, 54), 4.0, 10.0)
    pack = kit.rounded_box((-100, -23, 0), (84, 74, 62), 13.0, 22.0)
    rail = kit.location(guide) * kit.block((22, -OUTER, -40), (27, OUTER, 178), 1.5)
    pins = []
    for at, radius in ((low, 13.5), (top, 11.5)):
        pins.append(kit.pin(at, -OUTER, OUTER, 5.0))
        pins += cap_pair(at, OUTER, 4.5, radius)
    parts = (
        Part("casting", plates + web + hub + collar),
        Part("cover", pack),
        Part("joint", kit.together(pins)),
        Part("steel", rail),
    )
    touch = (
        pack,
        kit.plate(kit.polygon([(-20, -20), (-20, 20), (196, 27), (196, -16)]), -OUTER, OUTER),
    )
    return Link("pitch_back", "pitch_back", parts, touch)


def _pitch_front(m: Mechanism) -> Link:
    """Return the front rocker, parallel to the rear one."""
    own, far = hinge(m, "pitch_front", "pitch_front"), hinge(m, "pitch_front", "c1")
    x, y, _ = far.at(0.0)
    waist = (x / 2, y / 2, 9.0)
    plates = kit.mirrored(
        kit.plate(kit.outline([own.disc(15), waist, far.disc(12.5)]), INNER, OUTER, 2.5)
    )
    web = kit.plate(kit.hull([(20, 0, 9), (54, 0, 8)]), -INNER, INNER)
    pins = [kit.pin(far, -OUTER, OUTER, 5.0)]
    pins += cap_pair(far, OUTER, 4.5, 11.0)
    touch = kit.box((-15, -11, -OUTER), (x + 12, 11, OUTER))
    return Link(
        "pitch_front",
        "pitch_front",
        (Part("cover", plates + web), Part("joint", kit.together(pins))),
        (touch,),
    )


def _pitch_bottom(m: Mechanism) -> Link:
    """Return the lower long link; it leaves 8 mm to the upper one when the arm leans most."""
    own, coupled = hinge(m, "pitch_bottom", "pitch_bottom"), hinge(m, "pitch_bottom", "c1")
    end = hinge(m, "pitch_bottom", "pitch_end")
    a, b = float(coupled.point[0]) + 26, float(end.point[0]) - 34
    rear = kit.plate(kit.outline([own.disc(10.5), coupled.disc(10.5), (a, 0, 10.5)]), -13, 13, 3.0)
    front = kit.plate(kit.outline([(b, 0, 10.5), end.disc(10.5)]), -13, 13, 3.0)
    cover = bar(a, b, 3.0, 26.0, 2 * BAR)
    touch = (
        kit.box((-10, -10, -13), (a, 12, 13)),
        kit.box((a, -10, -BAR), (b, 16, BAR)),
        kit.box((b, -10, -13), (b + 44, 12, 13)),
    )
    return Link(
        "pitch_bottom",
        "pitch_bottom",
        (Part("casting", bored(rear + front, (own, coupled, end), 5.0)), Part("cover", cover)),
        touch,
    )


def _pitch_top(m: Mechanism) -> Link:
    """Return the upper long link."""
    own, end = hinge(m, "pitch_top", "pitch_top"), hinge(m, "pitch_top", "c2")
    a, b = 30.0, float(end.point[0]) - 30
    rear = kit.plate(kit.outline([own.disc(7.5), (a, 0, 7.5)]), -12, 12, 2.5)
    front = kit.plate(kit.outline([(b, 0, 7.5), end.disc(7.5)]), -12, 12, 2.5)
    cover = bar(a, b, -2.5, 20.0, 28.0)
    touch = (kit.box((-8, -12, -14), (b + 38, 7.5, 14)),)
    return Link(
        "pitch_top", "pitch_top", (Part("casting", rear + front), Part("cover", cover)), touch
    )


def _pitch_end(m: Mechanism) -> Link:
    """Return the end link: the insertion rail, its cheeks on the long links, the cannula."""
    own, upper = hinge(m, "pitch_end", "pitch_end"), hinge(m, "pitch_end", "c2")
    side = [(RAIL, -358), (-4, -358), (-12, -110), (-17, -30), (-17, 10), (2, 64), (RAIL, 64)]
    whole = kit.plate(kit.polygon(side, 11.0), -OUTER, OUTER, 9.0, round_off=True)
    body, crown = kit.split(whole, kit.box((-40, -360, -40), (40, -330, 40)))
    panel = kit.hull([(6, -312, 8), (2, -88, 9)])
    panels = [kit.pad(panel, t * (OUTER - 2), t * (OUTER + 1), 1.0) for t in (-1, 1)]
    uy = float(upper.at(0.0)[1])
    gap = [(16, 10), (16, uy - 9), (-24, uy - 62), (-60, uy - 62), (-60, 66), (-24, 61)]
    body = body - kit.plate(kit.polygon(gap), -INNER + 0.5, INNER - 0.5)
    strip = kit.box((RAIL - 1, -326, -12), (STRIP, 46, 12))
    pins = [kit.pin(own, -INNER, INNER, 5.0), kit.pin(upper, -INNER, INNER, 4.5)]
    for at, radius in ((own, 12.0), (upper, 10.0)):
        pins += cap_pair(at, OUTER, 4.0, radius)
    tube = cannula(m, "pitch_end", 5.4, 38.0, (21.0, 58.0))
    parts = (
        Part("cover", kit.together([body, *panels])),
        Part("steel", strip + tube.tube),
        Part("joint", kit.together([*pins, *tube.dark, crown])),
        Part("casting", tube.mount),
    )
    touch = (
        kit.box((-14, -356, -OUTER), (RAIL, -90, OUTER)),
        kit.box((-17, -90, -OUTER), (RAIL, 64, OUTER)),
    )
    return Link("pitch_end", "pitch_end", parts, touch)


def _insertion(m: Mechanism) -> Link:
    """Return the carriage: a saddle on the rail, and the sterile adaptor that takes a housing."""
    back = float(hinge(m, "pitch_end", "insertion").point[0]) - STRIP
    half = [(29, back), (29, 24), (35.5, 24), (35.5, 5)]
    around = [*half, *((-x, y) for x, y in reversed(half))]
    saddle = kit.plate(kit.polygon(around, 2.4), -58, 46, 1.5)
    crown = kit.block((-30, 5.5, -70), (30, 30, -57), 4.0) - kit.box((-29, back, -80), (29, 40, 0))
    adaptor = kit.block((-26.5, 3.7, -30), (26.5, 6, 44), 1.0)
    guides = [kit.block((x - 2, -9, -18), (x + 2, 5, 40), 1.2) for x in (-26, 26)]
    return Link(
        "insertion",
        "insertion",
        (
            Part("cover", saddle),
            Part("joint", crown),
            Part("casting", kit.together([adaptor, *guides])),
        ),
        (kit.box((-35, 5, -58), (35, 24, 46)),),
    )


def _counterweight() -> Link:
    """Return the weight that runs on the back of the rear rocker's rail."""
    block = kit.rounded_box((4.5, 0, 0), (33, 48, 56), 6.0)
    return Link("counterweight", "counterweight", (Part("joint", block),))
