"""The links of the Endoscope Camera Manipulator, with the endoscope.

Side by side along the hinges (z of the pitch frames), from the middle outwards: the two long links
and the tongue of the yaw link (to 20 mm), the plates of pitch back (21.5 to 29.5 mm) and of pitch
front (31 to 43 mm). So no link runs through its neighbour, however far the arm leans.

Source: axes from the description; thicknesses and looks our own choice, after photographs of the
da Vinci Classic.
"""

from __future__ import annotations

import numpy as np
from build123d import Plane

from tools.cad import kit
from tools.cad.kit import Hinge, bar, bored, cannula, cap_pair, hinge
from tools.cad.links import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.kinematics.mechanism import Mechanism

#: Layers along the hinges, half widths [mm].
BAR, INNER, MIDDLE, SPLIT, OUTER = 20.0, 21.5, 29.5, 31.0, 43.0
#: Half width of the end link, and the front of its rail and of the strip on it, x [mm].
CHEEK, RAIL, STRIP = 34.0, 55.0, 57.0
#: Where the base ends along the yaw axis and where the yaw link begins [mm].
REAR, FRONT, SEAM = -84.0, 54.0, 66.0


def links(arm: ArmDescription) -> tuple[Link, ...]:
    """Return the links of an ECM and its endoscope."""
    m = arm.mechanism
    return (
        _base(m),
        _yaw(m),
        _pitch_front(m),
        _pitch_back(m),
        _pitch_bottom(m),
        _pitch_top(m),
        _pitch_end(m),
        _insertion(m),
        _endoscope(m),
    )


def _height(axis: Hinge, y: float) -> float:
    """Return the height along the yaw axis of the plane y of the base's frame [mm]."""
    return float((y - axis.point[1]) / axis.direction[1])


def _base(m: Mechanism) -> Link:
    """Return the drum about the yaw axis, on the foot that the setup joints hold."""
    axis = hinge(m, "base", "yaw")
    front, rear = _height(axis, FRONT), _height(axis, REAR)
    back = [(0, rear), (30, rear), (44, rear - 4), (53, rear - 12), (58, rear - 24)]
    drum = kit.turning(axis, [*back, (58, front + 4), (54, front), (0, front)])
    band = kit.tube(axis, rear - 42, rear - 36, 58.8, 50.0)
    sole = kit.polygon([(-48, -66), (48, -66), (48, 45), (-48, 45)], 14.0)
    foot = kit.plate(sole, -101.5, -38, 5.0)
    ring = kit.pin(axis, _height(axis, SEAM + 0.5), _height(axis, FRONT - 1), 50.0)
    parts = (
        Part("cover", drum),
        Part("casting", foot),
        Part("joint", ring + band),
    )
    return Link("base", "base", parts, (kit.prism(axis, front, rear, 58.0, 12), foot))


def _yaw(m: Mechanism) -> Link:
    """Return the drive housing and the tongue that both rockers straddle."""
    front, back = hinge(m, "yaw", "pitch_front"), hinge(m, "yaw", "pitch_back")
    side = Plane(origin=(0, 0, 0), x_dir=(0, 0, -1), z_dir=(0, -1, 0)).location  # x forward, y up
    start = SEAM - float(hinge(m, "base", "yaw").point[1])
    housing = [
        (start, 54),
        (start + 20, 53),
        (start + 40, 42),
        (-58, -15),
        (-58, -60),
        (-92, -76),
        (start + 24, -62),
        (start, -54),
    ]
    body = kit.plate(kit.polygon(housing, 14.0), -50, 50, 12.0, round_off=True)
    bu, bv = -float(back.point[2]), float(back.point[0])
    au, av = -float(front.point[2]), float(front.point[0])
    tongue = kit.plate(
        kit.outline([(au, av, 22), (bu, bv, 19), (-84, -36, 26)], [(au, av, 22), (-84, -36, 26)]),
        -BAR,
        BAR,
        3.0,
    )
    pins = [kit.pin(front, -SPLIT, SPLIT, 7.5), kit.pin(back, -MIDDLE - 0.7, MIDDLE + 0.7, 7.0)]
    touch = (
        side * kit.plate(kit.polygon(housing), -50, 50),
        side
        * kit.plate(
            kit.polygon([(-90, -60), (au + 15, av - 18), (au + 15, av + 18), (-90, -12)]), -BAR, BAR
        ),
    )
    parts = (
        Part("cover", side * body),
        Part("casting", side * tongue),
        Part("joint", kit.together(pins)),
    )
    return Link("yaw", "yaw", parts, touch)


def _pitch_front(m: Mechanism) -> Link:
    """Return the driven rocker: two plates and the upper arm's cover between them."""
    own = hinge(m, "pitch_front", "pitch_front")
    low, top = hinge(m, "pitch_front", "pitch_bottom"), hinge(m, "pitch_front", "pitch_top")
    frame = kit.outline([own.disc(24), low.disc(18), top.disc(15)])
    plates = kit.mirrored(kit.plate(frame, SPLIT, OUTER, 2.5))
    cover = kit.rounded_box((136, 13, 0), (140, 40, 2 * OUTER + 6), 9.0, 15.0)
    pins = cap_pair(own, OUTER, 6.0, 21.0)
    for at, radius in ((low, 15.5), (top, 13.0)):
        pins += [kit.pin(at, -OUTER, OUTER, 6.0), *cap_pair(at, OUTER, 5.0, radius)]
    x = float(low.point[0])
    touch = (
        kit.plate(kit.polygon([(-20, -22), (-20, 22), (x + 48, 20), (x + 48, -10)]), SPLIT, OUTER),
        kit.plate(
            kit.polygon([(-20, -22), (-20, 22), (x + 48, 20), (x + 48, -10)]), -OUTER, -SPLIT
        ),
        kit.box((66, -7, -OUTER), (206, 33, OUTER)),
    )
    parts = (Part("casting", plates), Part("cover", cover), Part("joint", kit.together(pins)))
    return Link("pitch_front", "pitch_front", parts, touch)


def _pitch_back(m: Mechanism) -> Link:
    """Return the coupling rocker, parallel to the driven one and inside it."""
    own, far = hinge(m, "pitch_back", "pitch_back"), hinge(m, "pitch_back", "c1")
    x = float(far.point[0])
    frame = kit.outline(
        [own.disc(12.5), own.disc(8.5, 0.15 * x), far.disc(8.5, -0.15 * x), far.disc(12)]
    )
    plates = kit.mirrored(kit.plate(frame, INNER, MIDDLE, 2.0))
    web = kit.plate(kit.hull([(x / 2 - 24, 0, 7.5), (x / 2 + 24, 0, 7.5)]), -INNER, INNER)
    parts = (
        Part("cover", plates + web),
        Part("joint", kit.pin(far, -MIDDLE - 0.7, MIDDLE + 0.7, 6.0)),
    )
    touch = (kit.box((-12, -9, -MIDDLE), (x + 10, 9, MIDDLE)),)
    return Link("pitch_back", "pitch_back", parts, touch)


def _pitch_bottom(m: Mechanism) -> Link:
    """Return the lower long link; it leaves 2 mm to the upper one when the arm leans most."""
    own, coupled = hinge(m, "pitch_bottom", "pitch_bottom"), hinge(m, "pitch_bottom", "c1")
    end = hinge(m, "pitch_bottom", "pitch_end")
    a, b = 48.0, float(end.point[0]) - 36
    rear = kit.plate(kit.outline([coupled.disc(11), own.disc(10.5), (a, 0, 10.5)]), -17, 17, 3.0)
    front = kit.plate(kit.outline([(b, 0, 10.5), end.disc(10.5)]), -17, 17, 3.0)
    touch = (
        kit.box((coupled.point[0] - 10, -10, -17), (a, 18, 17)),
        kit.box((a, -10, -BAR), (b + 46, 14, BAR)),
    )
    parts = (
        Part("casting", bored(rear + front, (own, coupled, end), 6.0)),
        Part("cover", bar(a, b, 2.0, 24.0, 2 * BAR)),
    )
    return Link("pitch_bottom", "pitch_bottom", parts, touch)


def _pitch_top(m: Mechanism) -> Link:
    """Return the upper long link."""
    own, end = hinge(m, "pitch_top", "pitch_top"), hinge(m, "pitch_top", "c2")
    a, b = 34.0, float(end.point[0]) - 34
    rear = kit.plate(kit.outline([own.disc(8.5), (a, 0, 8.5)]), -16, 16, 2.5)
    front = kit.plate(kit.outline([(b, 0, 8.5), end.disc(8.5)]), -16, 16, 2.5)
    touch = (kit.box((-8, -13, -18), (b + 42, 8.5, 18)),)
    parts = (Part("casting", rear + front), Part("cover", bar(a, b, -2.5, 22.0, 36.0)))
    return Link("pitch_top", "pitch_top", parts, touch)


def _pitch_end(m: Mechanism) -> Link:
    """Return the end link: the insertion rail, its cheeks on the long links, the cannula."""
    own, upper = hinge(m, "pitch_end", "pitch_end"), hinge(m, "pitch_end", "c2")
    side = [
        (RAIL, -165),
        (18, -165),
        (-18, -84),
        (-20, -30),
        (-20, 30),
        (8, 112),
        (22, 207),
        (RAIL, 207),
    ]
    whole = kit.plate(kit.polygon(side, 12.0), -CHEEK, CHEEK, 9.0, round_off=True)
    body, crown = kit.split(whole, kit.box((-40, -170, -60), (80, -143, 60)))
    panel = kit.hull([(27, -118, 13), (27, 150, 13)])
    panels = [kit.pad(panel, t * (CHEEK - 2), t * (CHEEK + 1), 1.0) for t in (-1, 1)]
    x, y, _ = upper.at(0.0)
    gap = [(17, 8), (15, y - 9), (x - 14, y - 29), (-60, y - 58), (-60, 140), (-24, 92)]
    body = body - kit.plate(kit.polygon(gap), -INNER, INNER)
    strip = kit.box((RAIL - 1, -139, -16), (STRIP, 190, 16))
    pins = [kit.pin(own, -INNER, INNER, 6.0), kit.pin(upper, -INNER, INNER, 5.5)]
    pins += [*cap_pair(own, CHEEK, 5.0, 14.0), *cap_pair(upper, CHEEK, 5.0, 12.0)]
    # The tube ends before the remote centre: the scope looks out from insertion 0 on.
    tube = cannula(m, "pitch_end", 6.6, -4.0, (36.0, 200.0))
    parts = (
        Part("cover", kit.together([body, *panels])),
        Part("steel", strip + tube.tube),
        Part("joint", kit.together([*pins, *tube.dark, crown])),
        Part("casting", tube.mount),
    )
    touch = (
        kit.box((-18, -100, -CHEEK), (STRIP, 112, CHEEK)),
        kit.box((14, -165, -CHEEK), (STRIP, -100, CHEEK)),
        kit.box((14, 112, -CHEEK), (STRIP, 207, CHEEK)),
    )
    return Link("pitch_end", "pitch_end", parts, touch)


def _insertion(m: Mechanism) -> Link:
    """Return the carriage: a saddle on the rail and the clamp of the endoscope's adaptor."""
    axis = hinge(m, "insertion", "insertion")
    back = float(hinge(m, "pitch_end", "insertion").point[0]) - STRIP - 1.0
    half = [(60, CHEEK + 1.5), (60, CHEEK + 7), (23, CHEEK + 7)]
    around = [
        (back, CHEEK + 1.5),
        *half,
        *((x, -y) for x, y in reversed(half)),
        (back, -CHEEK - 1.5),
    ]
    saddle = kit.plate(kit.polygon(around, 2.0), -52, 36, 1.0)
    clamp = kit.tube(axis, -34, 22, 22.0, 15.5)
    block = kit.box((17, -15, -32), (26, 15, 20))
    touch = (kit.box((23, -38, -52), (back, 38, 36)),)
    return Link(
        "insertion", "insertion", (Part("cover", saddle), Part("joint", clamp + block)), touch
    )


def _endoscope(m: Mechanism) -> Link:
    """Return the stereo endoscope: tip, shaft, adaptor and camera head; it rolls."""
    axis = hinge(m, "roll", "roll")
    shaft = kit.turning(axis, [(0, -400), (5, -400), (5, -9), (0, -9)])
    tip = kit.turning(axis, [(0, -9.5), (5.3, -9.5), (5.3, 0.2), (0, 0.2)])
    adaptor = kit.turning(
        axis,
        [
            (0, -452),
            (20, -452),
            (20, -446),
            (15, -440),
            (15, -368),
            (8, -354),
            (8, -342),
            (0, -342),
        ],
    )
    head = kit.rounded_box((0, 0, -504), (58, 48, 100), 10.0, 16.0)
    collar = kit.turning(axis, [(0, -460), (24, -460), (24, -450), (0, -450)])
    cables = [
        kit.turning(
            Hinge(axis.point + np.array([x, 0.0, 0.0]), axis.direction),
            [(0, -592), (5, -592), (5, -560), (0, -560)],
        )
        for x in (-12.0, 12.0)
    ]
    light = Hinge(axis.point + np.array([0.0, 0.0, -433.0]), np.array([-1.0, 0.0, 0.0]))
    guide = kit.turning(light, [(0, 10), (5.5, 10), (5.5, 24), (4, 26), (4, 38), (0, 38)])
    top = kit.turning(axis, [(0, -566), (14, -566), (18, -556), (18, -550), (0, -550)])
    parts = (
        Part("steel", shaft + guide),
        Part("black", kit.together([tip, adaptor, *cables])),
        Part("cover", head),
        Part("joint", kit.together([collar, top])),
    )
    touch = (
        kit.prism(axis, -382, 0.2, 5.3),
        kit.prism(axis, -440, -354, 15.0),
        kit.box((-29, -24, -560), (29, 24, -440)),
    )
    return Link("roll", "roll", parts, touch)
