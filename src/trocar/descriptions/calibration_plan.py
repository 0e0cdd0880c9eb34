"""Plan of an arm's calibration report: axes by label, their distances, and angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

from trocar.descriptions.keys import key
from trocar.descriptions.table import Table
from trocar.kinematics.mechanism import Closure, Mechanism

Pair = tuple[str, str]


@dataclass(frozen=True)
class CalibrationPlan:
    """The measured axes of a mechanism, and the reported figures of them.

    An axis is named after the frame that moves about it, or after the closure whose hinge it is.

    Attributes:
        axes: {label: frame or closure}, `{ 3 = "pitch_back", c1 = "c1" }`
        distances: of axes on one link, `["3-4", "4-c1"]`
        betas: `{ beta1 = ["6-8", "3-6"] }`: angle at q = 0 from the second line to the first, minus
            pi/2; a line leads from its first axis to its second
    """

    axes: Mapping[str, str] = field(metadata=key(form="any"))
    distances: tuple[Pair, ...] = field(metadata=key(form="texts", default=()))
    betas: Mapping[str, tuple[Pair, Pair]] = field(metadata=key(form="any", default=()))


def read_calibration(table: Table) -> CalibrationPlan | None:
    """Return the plan that an arm's file has, None where it has none."""
    if "calibration" not in table:
        table.raw("calibration")
        return None
    row = table.table("calibration")
    names = row.table("axes")
    axes = {label: names.text(label) for label in names.entries()}
    for label in axes:
        if "-" in label or not label:
            raise names.fail(label, "got a label with '-' in it; allowed: labels without")
    distances = tuple(_pair(row, "distances", text, axes) for text in row.texts("distances"))
    lines = row.optional_table("betas")
    betas: dict[str, tuple[Pair, Pair]] = {}
    for name in lines.entries():
        two = [_pair(lines, name, text, axes) for text in lines.texts(name)]
        if len(two) != 2:
            raise lines.fail(name, f'got {len(two)} lines; allowed: two, as ["6-8", "3-6"]')
        betas[name] = (two[0], two[1])
    row.done()
    return CalibrationPlan(axes, distances, betas)


def check_plan(plan: CalibrationPlan, mechanism: Mechanism) -> str:
    """Return the problem of the first axis of a plan that the mechanism lacks, "" without one."""
    known = default_axes(mechanism)
    for label, name in plan.axes.items():
        if name not in known:
            return f"{label}: got {name!r}; allowed: {', '.join(known)}"
    return ""


def default_plan(mechanism: Mechanism) -> CalibrationPlan:
    """Return the plan of an arm whose file has none.

    Its labels are names of frames and closures: every axis that belongs to a loop, and every pair
    of them that one link carries.
    """
    carried: dict[str, list[str]] = {}
    axes = _loop_axes(mechanism)
    for name in axes:
        for body in axis_links(mechanism, name):
            carried.setdefault(body, []).append(name)
    distances = dict.fromkeys(p for on in carried.values() for p in combinations(on, 2))
    return CalibrationPlan({name: name for name in axes}, tuple(distances), {})


def default_axes(mechanism: Mechanism) -> tuple[str, ...]:
    """Return every axis that something turns about: moving frames, then closures."""
    turning = [f.name for f in mechanism.frames if f.motion == "revolute"]
    return (*turning, *(c.name for c in mechanism.closures))


def axis_links(mechanism: Mechanism, axis: str) -> Pair:
    """Return the links that an axis joins, each by the frame that moves it (parent's, child's).

    Raises:
        UnknownNameError: no such frame
    """
    closure = next((c for c in mechanism.closures if c.name == axis), None)
    if closure is not None:
        frame_b, _ = hinge_side(mechanism, closure)
        return link_of(mechanism, closure.frame_a), link_of(mechanism, frame_b)
    frame = mechanism.frame(axis)
    return link_of(mechanism, frame.parent or frame.name), frame.name


def link_of(mechanism: Mechanism, name: str) -> str:
    """Return the frame that moves the link which a frame is fixed to, the root for what rests."""
    frame = mechanism.frame(name)
    while frame.motion == "fixed" and frame.parent is not None:
        frame = mechanism.frame(frame.parent)
    return frame.name


def hinge_side(mechanism: Mechanism, closure: Closure) -> tuple[str, str]:
    """Return the frame of a closure's side b, and that of the pin that slides in it ("": none)."""
    frame = mechanism.frame(closure.frame_b)
    pinned = frame.motion == "prismatic" and frame.name in closure.passive
    return (frame.parent or "", frame.name) if pinned else (frame.name, "")


def _loop_axes(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the axes of all loops: of frames on one side of a closure only, and the closures."""
    members = {
        mechanism.frames[index].name
        for c in mechanism.closures
        for index in set(mechanism.chain(c.frame_a)) ^ set(mechanism.chain(c.frame_b))
    }
    turning = [f.name for f in mechanism.frames if f.motion == "revolute" and f.name in members]
    return (*turning, *(c.name for c in mechanism.closures))


def _pair(table: Table, key: str, text: str, axes: Mapping[str, str]) -> Pair:
    """Return the two labels of "3-6"."""
    first, dash, second = text.partition("-")
    if not dash or first not in axes or second not in axes or first == second:
        raise table.fail(key, f"got {text!r}; allowed: two labels of {', '.join(axes)}, as 3-6")
    return first, second
