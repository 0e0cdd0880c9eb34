"""What ties coordinates together: loops, the guards of their branch, couplings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trocar.descriptions.records import RigArm
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.modeling.hinges import followers
from trocar.modeling.markup import child
from trocar.modeling.menagerie.bodies import Anchor, at_point
from trocar.modeling.menagerie.sheet import Sheet
from trocar.modeling.menagerie.text import exact, placed
from trocar.modeling.options import LAYERS


def add_loops(
    sheet: Sheet, place: RigArm, anchors: Mapping[str, Anchor], hinges: Mapping[str, str], to: Any
) -> None:
    """Close the loops of an arm, point on point.

    Args:
        sheet: the file
        place: the arm
        anchors: {frame: where it is}
        hinges: {frame: name of its hinge}
        to: the element `equality`
    """
    mechanism = place.arm.mechanism
    parallel = loops_are_parallelograms(mechanism)
    guarded = parallel and not any(c.open for c in mechanism.closures)
    for closure in mechanism.closures:
        name = sheet.name(place.name, closure.name)
        ends = ((closure.frame_a, closure.point_a), (closure.frame_b, closure.point_b))
        sites = (f"{name}_a", f"{name}_b")
        for site, (frame, point) in zip(sites, ends, strict=True):
            at = placed(at_point(anchors[frame], point))
            child(anchors[frame].body, "site", {"class": "frame", "name": site, **at})
        if closure.open:
            continue
        said = {"class": sheet.classes.root, "site1": sites[0], "site2": sites[1]}
        for layer in range(1 if parallel else LAYERS):
            own = name if layer == 0 else f"{name}_{layer + 1}"
            child(to, "connect", {"name": own, **said})
        if closure.guard and guarded:
            one, other = (hinges[frame] for frame in closure.guard)
            _tie(sheet, to, f"{name}_guard", (one, other), 1.0)


def add_couplings(sheet: Sheet, place: RigArm, hinges: Mapping[str, str], to: Any) -> None:
    """Tie frames that neither a motor nor a loop moves to the joint that they follow.

    Raises:
        InputError: one follows more than one joint
    """
    for frame, leader, ratio in followers(place.arm):
        _tie(sheet, to, sheet.name(place.name, frame), (hinges[frame], hinges[leader]), ratio)


def _tie(sheet: Sheet, to: Any, name: str, joints: tuple[str, str], ratio: float) -> None:
    said = {"name": name, "class": sheet.classes.root, "joint1": joints[0], "joint2": joints[1]}
    child(to, "joint", {**said, "polycoef": f"0 {exact(ratio)} 0 0 0"})
