"""The links of the da Vinci Si's arms: PSM and ECM share base, yaw link and two belt-driven links.

Side by side along the hinges (z of the pitch frames): the first link of the pitch, the instrument's
rail and the shaft in the middle (to 28 mm), the yaw link on one side (30 to 92 mm), the forearm on
the other (-30 to -88 mm). So no link runs through its neighbour, however far the arm leans.

Source: axes from the description; thicknesses and looks our own choice, after photographs of the
da Vinci Si.
"""

from __future__ import annotations

import numpy as np
from build123d import Plane
from build123d.topology import Shape

from tools.cad import kit
from tools.cad.kit import Hinge, cannula, cap, hinge
from tools.cad.links import Link, Part
from trocar.descriptions.records import ArmDescription
from trocar.kinematics.mechanism import Mechanism

#: Layers along the hinges: half the middle one, the yaw link's, the forearm's [mm].
MIDDLE, YAW, FOREARM = 28.0, (30.0, 92.0), (-88.0, -30.0)
#: Radii at the hinges of the pitch [mm].
FIRST, SECOND, THIRD = 50.0, 43.0, 38.0
#: Where the base begins and ends along the yaw axis, and where the yaw link's drum ends: the first
#: link's far end comes near [mm].
REAR, FRONT, DRUM = -112.0, 10.0, 42.0
#: Front of the rail, of the strip on it and of the telescope's middle stage, x in pitch_3 [mm].
RAIL, STRIP, STAGE = 55.0, 57.5, 67.0


def links(arm: ArmDescription) -> tuple[Link, ...]:
    """Return the links of an arm without its instrument or endoscope."""
    m = arm.mechanism
    shared = (_base(m), _yaw(m), _pitch_1(m), _pitch_2(m))
    if arm.type == "ECM":
        return (*shared, _ecm_pitch_3(m), _ecm_insertion(m))
    return (*shared, _psm_pitch_3(m), _psm_middle(), _psm_insertion(m))


def _base(m: Mechanism) -> Link:
    """Return the shoulder on the setup joint's knuckle: its axis is the yaw axis."""
    axis = hinge(m, "base", "yaw")
    low, high = -FRONT, -REAR  # the axis looks back
    shell = [(0, low), (60, low), (62, low + 3), (62, 68), (58, 82), (48, 98), (48, high)]
    drum = kit.turning(axis, [*shell, (0, high)])
    pack = kit.rounded_box((0, -48, 50), (92, 92, 66), 12.0, 20.0)
    bands = [
        kit.tube(axis, low + 12, low + 19, 62.8, 50.0),
        kit.tube(axis, high - 9, high - 4, 49.0, 30.0),
    ]
    parts = (Part("cover", drum + pack), Part("joint", kit.together(bands)))
    return Link("base", "base", parts, (kit.prism(axis, low, high, 62.0, 12),))


def _yaw(m: Mechanism) -> Link:
    """Return the drum that turns on the base, and the housing beside the first pitch hinge."""
    pitch = hinge(m, "yaw", "pitch_1")
    side = Plane(origin=(0, 0, 0), x_dir=(0, 0, -1), z_dir=(0, 1, 0)).location
    u, v = -float(pitch.point[2]), -float(pitch.point[0])
    own = hinge(m, "yaw", "yaw")
    start = FRONT + 3.0
    drum = kit.turning(own, [(0, -start), (62, -start), (62, -DRUM + 7), (55, -DRUM), (0, -DRUM)])
    low, high = YAW
    beside = kit.hull([(start + 58, -2, 58), (u, v, FIRST)])
    housing = side * kit.plate(beside, low, high, 14.0, round_off=True)
    root = side * kit.plate(kit.hull([(start + 12, -44, 12), (start + 12, 44, 12)]), 0.0, high - 14)
    panel = side * kit.pad(kit.hull([(100, 14, 30), (u - 92, v - 20, 26)]), high - 2, high + 4, 3.0)
    pins = [
        kit.pin(own, -start, -FRONT - 0.5, 56.0),
        kit.pin(pitch, MIDDLE - 4, low + 4, FIRST - 8),
        cap(pitch, high, high + 7, FIRST - 12),
    ]
    touch = (
        side * kit.plate(kit.polygon(_stadium((start + 58, -2, 58), (u, v, FIRST))), low, high),
        kit.prism(own, -DRUM, -start, 60.0, 12),
    )
    parts = (
        Part("cover", kit.together([housing, drum, root])),
        Part("casting", panel),
        Part("joint", kit.together(pins)),
    )
    return Link("yaw", "yaw", parts, touch)


def _pitch_1(m: Mechanism) -> Link:
    """Return the first belt-driven link, between yaw link and forearm."""
    own, far = hinge(m, "pitch_1", "pitch_1"), hinge(m, "pitch_1", "pitch_2")
    ends = own.disc(FIRST - 2), far.disc(SECOND - 1)
    body = kit.plate(kit.hull(ends), -MIDDLE, MIDDLE, 11.0, round_off=True)
    waist = kit.hull([(62, 0, 22), (float(far.point[0]) - 56, 0, 19)])
    panels = [kit.pad(waist, t * (MIDDLE - 2), t * (MIDDLE + 1), 1.0) for t in (-1, 1)]
    pins = [
        kit.pin(far, -MIDDLE - 4, -MIDDLE + 4, SECOND - 7),
        cap(own, -MIDDLE + 1, -MIDDLE - 6, FIRST - 14),
        cap(far, MIDDLE - 1, MIDDLE + 6, SECOND - 9),
    ]
    parts = (
        Part("cover", body),
        Part("casting", kit.together(panels)),
        Part("joint", kit.together(pins)),
    )
    touch = kit.plate(kit.polygon(_stadium(*ends)), -MIDDLE, MIDDLE)
    return Link("pitch_1", "pitch_1", parts, (touch,))


def _pitch_2(m: Mechanism) -> Link:
    """Return the forearm: slim, with a housing at each end."""
    own, far = hinge(m, "pitch_2", "pitch_2"), hinge(m, "pitch_2", "pitch_3")
    x = float(far.point[0])
    low, high = FOREARM
    shape = kit.hull([own.disc(SECOND), (0.45 * x, 0, 34), far.disc(THIRD)])
    body = kit.plate(shape, low, high, 15.0, round_off=True)
    inlay = kit.hull([(74, 0, 19), (x - 74, 0, 16)])
    panel = kit.pad(inlay, low + 2, low - 2, 1.5)
    pins = [
        cap(own, low, low - 7, SECOND - 12),
        cap(far, low, low - 7, THIRD - 10),
        kit.pin(far, high - 2, -MIDDLE + 4, THIRD - 8),
    ]
    parts = (Part("cover", body), Part("casting", panel), Part("joint", kit.together(pins)))
    touch = kit.plate(kit.polygon(_stadium(own.disc(SECOND), far.disc(THIRD))), low, high)
    return Link("pitch_2", "pitch_2", parts, (touch,))


def _rail(top: float, bottom: float, half: float) -> tuple[Shape, Shape, Shape]:
    """Return the spar that hangs on the last hinge: its body, its head and the strip in front.

    Args:
        top, bottom: its ends, y of pitch_3 [mm]
        half: half its width [mm]
    """
    side = [(RAIL, top), (8, top), (-4, -130), (-THIRD, -22), (-THIRD, 20)]
    side += [(10, bottom), (RAIL, bottom)]
    whole = kit.plate(kit.polygon(side, 13.0), -half, half, 11.0, round_off=True)
    body, head = kit.split(whole, kit.box((-60, top - 5, -60), (90, top + 26, 60)))
    strip = kit.box((RAIL - 1, top + 30, -15), (STRIP, bottom - 16, 15))
    panel = kit.hull([(26, top + 60, 10), (24, -70, 13)])
    inlays = [kit.pad(panel, t * (half - 2), t * (half + 1), 1.0) for t in (-1, 1)]
    return kit.together([body, *inlays]), head, strip


def _end_link(m: Mechanism, name: str, rail: tuple[float, float, float], tube: kit.Cannula) -> Link:
    """Return the rail with a cannula: `rail` are its top, bottom and half width [mm]."""
    top, bottom, half = rail
    own = hinge(m, "pitch_3", "pitch_3")
    body, head, strip = _rail(top, bottom, half)
    dark = [cap(own, half, half + 6, THIRD - 10), *tube.dark]
    parts = (
        Part("cover", body),
        Part("steel", strip + tube.tube),
        Part("joint", kit.together([*dark, head])),
        Part("casting", tube.mount),
    )
    touch = (
        kit.box((-2, top, -half), (RAIL, -60, half)),
        kit.box((-THIRD, -60, -half), (RAIL, bottom, half)),
    )
    return Link(name, "pitch_3", parts, touch)


def _psm_pitch_3(m: Mechanism) -> Link:
    return _end_link(
        m,
        "psm_pitch_3",
        (-362.0, 72.0, MIDDLE + 1),
        cannula(m, "pitch_3", 5.4, 38.0, (46.0, 64.0)),
    )


def _psm_middle() -> Link:
    """Return the telescope's middle stage: a plate on the rail's strip, with two rails of its own.

    Its frame looks back along x.
    """
    back = 60.2 - STRIP - 1.0
    plate = kit.block((60.2 - STAGE + 2, -25, -172), (back, 25, 66), 2.0)
    rails = [kit.block((60.2 - STAGE, y - 4, -166), (back, y + 4, 60), 0.8) for y in (-17, 17)]
    parts = (Part("joint", plate), Part("steel", kit.together(rails)))
    return Link("psm_middle", "insertion_middle", parts)


def _psm_insertion(m: Mechanism) -> Link:
    """Return the carriage: a housing, a hood with buttons over the instrument, the adaptor."""
    shaft = kit.shaft_axis(m, "pitch_3")
    back = float(shaft.point[0]) - STAGE - 1.0
    body = kit.rounded_box((0, (5 + back) / 2, -26), (76, back - 5, 164), 6.5, 9.0)
    hood = kit.rounded_box((0, (back - 26) / 2, -84), (64, back + 26, 50), 9.0, 16.0)
    sides = [kit.pad(kit.hull([(-70, -14, 6), (30, -14, 5)]), t * 36, t * 39, 1.5) for t in (-1, 1)]
    turn = Plane(origin=(0, 0, 0), x_dir=(0, 0, 1), z_dir=(1, 0, 0)).location
    stripes = [turn * side for side in sides]
    out = np.array([0.0, -1.0, 0.0])
    buttons = [cap(Hinge(np.array([x, -26.0, -84.0]), out), -1, 2.5, 9.0) for x in (-14.0, 14.0)]
    adaptor = kit.block((-26.5, 3.7, -30), (26.5, 6, 44), 1.0)
    guides = [kit.block((x - 2, -9, -18), (x + 2, 5, 40), 1.2) for x in (-26, 26)]
    parts = (
        Part("cover", kit.together([body, hood])),
        Part("joint", kit.together([*stripes, *buttons])),
        Part("casting", kit.together([adaptor, *guides])),
    )
    touch = (kit.box((-38, 5, -108), (38, back, 56)),)
    return Link("psm_insertion", "insertion", parts, touch)


def _ecm_pitch_3(m: Mechanism) -> Link:
    # The tube ends before the remote centre: the scope looks out from insertion 0 on.
    tube = cannula(m, "pitch_3", 6.6, -4.0, (46.0, 96.0))
    return _end_link(m, "ecm_pitch_3", (-268.0, 104.0, MIDDLE + 1), tube)


def _ecm_insertion(m: Mechanism) -> Link:
    """Return the endoscope's holder: a saddle on the rail, and the clamp about the adaptor."""
    axis = hinge(m, "insertion", "insertion")
    back = float(kit.shaft_axis(m, "pitch_3").point[0]) - STRIP - 1.0
    saddle = kit.block((back - 13, -37, -60), (back, 37, 44), 4.0)
    arm = kit.rounded_box(((14 + back) / 2, 0, -7), (back - 14, 46, 52), 5.0, 9.0)
    arm = arm - kit.pin(axis, -60, 60, 15.5)
    clamp = kit.tube(axis, -36, 24, 24.0, 15.5)
    latch = kit.rounded_box((-23, 0, -6), (14, 18, 40), 4.0)
    parts = (
        Part("cover", kit.together([saddle, arm])),
        Part("joint", kit.together([clamp, latch])),
    )
    touch = (kit.box((16, -37, -60), (back, 37, 44)),)
    return Link("ecm_insertion", "insertion", parts, touch)


def _stadium(a: kit.Disc, b: kit.Disc) -> list[tuple[float, float]]:
    """Return eight corners about two circles whose line of centres is nearer to x than to y."""
    (x0, y0, r0), (x1, y1, r1) = a, b
    half = 0.4142
    return [
        (x0 - r0, y0 - half * r0),
        (x0 - half * r0, y0 - r0),
        (x1 + half * r1, y1 - r1),
        (x1 + r1, y1 - half * r1),
        (x1 + r1, y1 + half * r1),
        (x1 + half * r1, y1 + r1),
        (x0 - half * r0, y0 + r0),
        (x0 - r0, y0 + half * r0),
    ]
