"""The loops of a mechanism as bodies and hinges: what motion capture sees of it.

Frames that are fixed to one another are one body. A hinge joins two bodies: the hinge of a frame
joins its parent's body with its own, a closure the bodies of its two frames. Nothing here knows a
robot by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.calibration_plan import default_plan, link_of
from trocar.errors import InputError
from trocar.kinematics.loops import closed_coordinates
from trocar.kinematics.mechanism import Closure, Frame, Mechanism
from trocar.kinematics.tree import frame_poses

Array = NDArray[np.float64]

ClosureKind = Literal["parallelogram", "general"]

# Source: our own choice. The hinges of a loop count as parallel within this angle; real ones are
# ten times straighter. [rad]
PARALLEL_RAD = 0.05
#: Two axes nearer than this in the description count as one: they have no distance, and give no
#: direction. Source: our own choice. [m]
APART_M = 1e-3


@dataclass(frozen=True)
class HingeAxis:
    """An axis about which two bodies turn.

    Attributes:
        name: the frame that moves about it, or the closure
        label: what reports call it
        body_a, body_b: the parent's body and the child's; of a closure, of frame_a and frame_b
        closure: whether it closes a loop
    """

    name: str
    label: str
    body_a: str
    body_b: str
    closure: bool


@dataclass(frozen=True, eq=False)
class LoopedPart:
    """The part of a mechanism that its loops move.

    Attributes:
        arm: name of the arm
        mechanism: the frames of the loops and what leads to them, with all joints
        bodies: {body: its first frame}, the ground of the loops first
        hinges: every hinge of the loops, those of the tree before the closures
        joints: positions in `mechanism.joints` of the joints that move the loops
        rest: joint positions of home, (n_joints,) [rad or m]; the limit where 0 lies beyond it
        frames: T_ground_frame at home of every frame in `mechanism`, {frame: (4, 4)}
        plane: two unit vectors across the axes and one along them, as columns, in the ground
            body's first frame (3, 3)
        points: {hinge: where its axis passes the plane at home, (2,) [m]}
        first: the hinge whose origin the plane passes in which distances are told (see `datum`)
        level: how far along the axes that is [m]
        turns: {body: d angle / d joint in the plane as the description has it, (n_joints,)}
        body_of: {frame: its body} of the frames in `mechanism`
        known: every body of the arm
    """

    arm: str
    mechanism: Mechanism
    bodies: Mapping[str, str]
    hinges: tuple[HingeAxis, ...]
    joints: tuple[int, ...]
    rest: Array
    frames: Mapping[str, Array]
    plane: Array
    points: Mapping[str, Array]
    first: str
    level: float
    turns: Mapping[str, Array]
    body_of: Mapping[str, str]
    known: frozenset[str]

    @property
    def tree(self) -> tuple[HingeAxis, ...]:
        """The hinges of the tree, from the ground up."""
        return tuple(hinge for hinge in self.hinges if not hinge.closure)

    @property
    def ground(self) -> str:
        """The body that every loop hangs on."""
        return next(iter(self.bodies))

    @cached_property
    def hinge(self) -> Mapping[str, HingeAxis]:
        """The hinges by their names."""
        return {hinge.name: hinge for hinge in self.hinges}

    @cached_property
    def carried(self) -> Mapping[str, tuple[str, ...]]:
        """{body: names of the hinges that it carries}."""
        return {
            body: tuple(h.name for h in self.hinges if body in (h.body_a, h.body_b))
            for body in self.bodies
        }


def linkage(arm: ArmDescription) -> LoopedPart:
    """Return the loops of an arm as bodies and hinges.

    Raises:
        InputError: the arm has no loops, one that slides, or axes that are not parallel
    """
    whole, body_of = arm.mechanism, bodies_of(arm)
    # A loop is what leads to one end of its closure, but not to both.
    ends = [(set(whole.chain(c.frame_a)), set(whole.chain(c.frame_b))) for c in whole.closures]
    if not ends:
        raise InputError(f"{arm.name}: has no closed loop; allowed: an arm with closed loops")
    loops = sorted({i for a, b in ends for i in a ^ b if whole.frames[i].motion != "fixed"})
    names = [whole.frames[i].name for i in loops]
    for i in loops:
        if whole.frames[i].motion == "prismatic":
            raise InputError(
                f"{arm.name}: {whole.frames[i].name} slides; allowed in a loop: revolute joints"
            )
    kept = tuple(whole.frames[i] for i in sorted({i for a, b in ends for i in a | b}))
    core = Mechanism(whole.name, whole.joints, kept, whole.closures, kept[0].name, kept[0].name)
    plan = arm.calibration
    labels = {} if plan is None else {frame: label for label, frame in plan.axes.items()}
    joined = [(n, body_of[str(whole.frame(n).parent)], body_of[n], False) for n in names]
    joined += [(c.name, body_of[c.frame_a], body_of[c.frame_b], True) for c in whole.closures]
    hinges = tuple(HingeAxis(n, labels.get(n, n), a, b, closure) for n, a, b, closure in joined)
    present = {body for hinge in hinges for body in (hinge.body_a, hinge.body_b)}
    bodies: dict[str, str] = {}
    for frame in whole.frames:
        if body_of[frame.name] in present:
            bodies.setdefault(body_of[frame.name], frame.name)
    rest = np.clip(np.zeros(len(core.joints)), core.lower, core.upper)
    at = frame_poses(core, closed_coordinates(core, rest))
    ground = np.linalg.inv(at[core.frame_index[next(iter(bodies.values()))]])
    frames = {frame.name: ground @ at[i] for i, frame in enumerate(core.frames)}
    axes = _home_axes(core, names, frames)
    along = axes[names[0]][1]
    for name, (_, direction) in axes.items():
        if np.linalg.norm(np.cross(direction, along)) > PARALLEL_RAD:
            raise InputError(
                f"{core.name}: axis {name} is not parallel to {names[0]}; allowed: loops whose axes"
                f" are parallel within {PARALLEL_RAD} rad"
            )
    plane = plane_across(along)
    first = next(iter((plan or default_plan(whole)).axes.values()))
    joints = sorted({c for n in names for c in np.flatnonzero(core.ratios[core.frame_index[n]])})
    return LoopedPart(
        arm=core.name,
        mechanism=core,
        bodies=bodies,
        hinges=hinges,
        joints=tuple(int(column) for column in joints),
        rest=rest,
        frames=frames,
        plane=plane,
        points={name: plane[:, :2].T @ point for name, (point, _) in axes.items()},
        first=first,
        level=float(plane[:, 2] @ axes[first][0]),
        turns=_turns(core, hinges, {n: float(np.sign(axes[n][1] @ along)) for n in names}),
        body_of={frame.name: body_of[frame.name] for frame in core.frames},
        known=frozenset(body_of.values()),
    )


def bodies_of(arm: ArmDescription) -> dict[str, str]:
    """Return {frame: the body that it is fixed on}; a body is named after its first frame."""
    return {f.name: f"{arm.name}_{link_of(arm.mechanism, f.name)}" for f in arm.mechanism.frames}


def _home_axes(
    core: Mechanism, names: list[str], frames: Mapping[str, Array]
) -> dict[str, tuple[Array, Array]]:
    """Return a point and the direction of each axis at home, {hinge: ((3,), (3,))}."""
    found: dict[str, tuple[Array, Array]] = {}
    for name in names:
        frame = core.frame(name)
        pose = frames[str(frame.parent)] @ frame.before
        found[name] = pose[:3, 3], pose[:3, 2]
    for closure in core.closures:
        pose = frames[closure.frame_a]
        point = pose[:3, :3] @ closure.point_a + pose[:3, 3]
        # A closing hinge is parallel to the hinge that its first passive frame turns about.
        found[closure.name] = point, found[closure.passive[0]][1]
    return found


def plane_across(along: Array) -> Array:
    """Return a right-handed basis whose last column is `along`, (3, 3)."""
    start = np.eye(3)[int(np.argmin(np.abs(along)))]
    one = np.cross(along, np.cross(start, along))
    one = np.asarray(one / np.linalg.norm(one), dtype=np.float64)
    return np.stack([one, np.cross(along, one), along], axis=1)


def _turns(
    core: Mechanism, hinges: tuple[HingeAxis, ...], signs: Mapping[str, float]
) -> dict[str, Array]:
    """Return the turn of each body in the plane by the couplings alone, from the ground up."""
    found = {hinges[0].body_a: np.zeros(len(core.joints))}
    for hinge in hinges:
        if not hinge.closure:
            ratio = signs[hinge.name] * core.ratios[core.frame_index[hinge.name]]
            start = found.setdefault(hinge.body_a, np.zeros(len(core.joints)))
            found[hinge.body_b] = start + ratio
    return found


@dataclass(frozen=True)
class Slot:
    """A place at which a body carries a hinge."""

    hinge: str
    body: str


def slots(linkage: LoopedPart) -> tuple[Slot, ...]:
    """Return the places that the displacements belong to, in their order."""
    found: list[Slot] = []
    for hinge in linkage.hinges:
        found.append(Slot(hinge.name, hinge.body_a))
        if hinge.closure:
            found.append(Slot(hinge.name, hinge.body_b))
    return tuple(found)


def shift_rows(linkage: LoopedPart) -> dict[str, Array]:
    """Return the slots that displace each body at home, {body: (n_slots,)} of zeros and ones."""
    unit = np.eye(len(slots(linkage)))
    rows = {linkage.ground: 0.0 * unit[0]}
    for hinge, row in zip(linkage.tree, unit, strict=False):
        rows[hinge.body_b] = rows.setdefault(hinge.body_a, 0.0 * row) + row
    return rows


def place_rows(linkage: LoopedPart) -> dict[Slot, Array]:
    """Return the slots that displace each place at home, {place: (n_slots,)}."""
    rows, places = shift_rows(linkage), slots(linkage)
    return {slot: rows[slot.body] + u for slot, u in zip(places, np.eye(len(places)), strict=True)}


def home_points(linkage: LoopedPart, moved: Array) -> dict[Slot, Array]:
    """Return the places of the hinges of each body at home.

    Args:
        linkage: the loops
        moved: displacements, (n_slots, 2) [m]

    Returns:
        {place: (2,) in the plane [m]}, of a frame's hinge for both of its bodies
    """
    rows = place_rows(linkage)
    found = {slot: linkage.points[slot.hinge] + rows[slot] @ moved for slot in slots(linkage)}
    for hinge in linkage.tree:
        found[Slot(hinge.name, hinge.body_b)] = found[Slot(hinge.name, hinge.body_a)]
    return found


def displacements(linkage: LoopedPart, points: Mapping[Slot, Array]) -> Array:
    """Return the displacements that put the hinges at these places, (n_slots, 2) [m]."""
    places, rows = slots(linkage), place_rows(linkage)
    away = np.stack([points[slot] - linkage.points[slot.hinge] for slot in places])
    found = np.linalg.solve(np.stack([rows[slot] for slot in places]), away)
    return np.asarray(found, dtype=np.float64)


def closing_rows(linkage: LoopedPart, parallelogram: bool) -> Array:
    """Return the rows that vanish on displacements of a linkage that closes, (m, n_slots).

    With `parallelogram` it closes by the couplings at every joint position: the links that turn
    alike make up a closed polygon by themselves. Without, it closes at home.
    """
    places = slots(linkage)
    index = {slot: i for i, slot in enumerate(places)}
    rows: list[Array] = []
    for hinge in linkage.hinges:
        if not hinge.closure:
            continue
        groups: dict[tuple[float, ...], Array] = {}
        for body, sign in ((hinge.body_a, -1.0), (hinge.body_b, 1.0)):
            for slot in [*leading(linkage, body), Slot(hinge.name, body)]:
                turn = linkage.turns[slot.body] if parallelogram else np.zeros(1)
                row = groups.setdefault(tuple(np.round(turn, 9)), np.zeros(len(places)))
                row[index[slot]] += sign
        rows += [row for row in groups.values() if row.any()]
    return np.stack(rows)


def gauge_rows(linkage: LoopedPart) -> Array:
    """Return three rows that hold the ground still, (3, 2 n_slots).

    The first hinge of the ground stays, and the direction from there to the ground's next one, or
    to the next one of the first link where these two coincide.
    """
    rows = place_rows(linkage)
    first = linkage.tree[0]
    start = Slot(first.name, first.body_a)
    other = next(
        slot
        for body in (first.body_a, first.body_b)
        for slot in slots(linkage)
        if slot.body == body
        and np.linalg.norm(linkage.points[slot.hinge] - linkage.points[first.name]) > APART_M
    )
    along = linkage.points[other.hinge] - linkage.points[first.name]
    across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    still = np.stack([np.kron(rows[start], axis) for axis in np.eye(2)])
    held = np.vstack([still, np.kron(rows[other] - rows[start], across)])
    return np.asarray(held, dtype=np.float64)


def freedoms(linkage: LoopedPart, parallelogram: bool) -> Array:
    """Return an orthonormal basis of the displacements that close, (2 n_slots, n_free)."""
    closing = np.kron(closing_rows(linkage, parallelogram), np.eye(2))
    held = np.vstack([closing, gauge_rows(linkage)])
    _, sizes, right = np.linalg.svd(held)
    return np.asarray(right[int(np.sum(sizes > 1e-9)) :].T, dtype=np.float64)


def rebuilt(
    linkage: LoopedPart,
    mechanism: Mechanism,
    moved: Array,
    tilts: Mapping[str, Array] | None = None,
) -> Mechanism:
    """Return a mechanism with its axes displaced.

    Args:
        linkage: its loops
        mechanism: the linkage's own, or the whole arm's
        moved: displacements, (n_slots, 2) [m]
        tilts: {frame: small rotation of its hinge's axis about the plane's two axes (2,) [rad]}
    """
    by = dict(zip(slots(linkage), moved, strict=True))

    def frame(one: Frame) -> Frame:
        slot = Slot(one.name, linkage.body_of.get(str(one.parent), ""))
        if slot not in by:
            return one
        before = one.before.copy()
        before[:3, 3] += in_frame(linkage, str(one.parent), by[slot])
        if tilts is not None and one.name in tilts:
            turn = in_frame(linkage, str(one.parent), tilts[one.name])
            half = 0.5 * np.cross(np.eye(3), turn)  # the rotation, by Cayley's formula
            before[:3, :3] = np.linalg.solve(np.eye(3) - half, np.eye(3) + half) @ before[:3, :3]
        return replace(one, before=before)

    def closure(one: Closure) -> Closure:
        a = by[Slot(one.name, linkage.body_of[one.frame_a])]
        b = by[Slot(one.name, linkage.body_of[one.frame_b])]
        return replace(
            one,
            point_a=one.point_a + in_frame(linkage, one.frame_a, a),
            point_b=one.point_b + in_frame(linkage, one.frame_b, b),
        )

    return replace(
        mechanism,
        frames=tuple(frame(one) for one in mechanism.frames),
        closures=tuple(closure(one) for one in mechanism.closures),
    )


def in_frame(linkage: LoopedPart, frame: str, across: Array) -> Array:
    """Return a vector in the plane as a frame has it at home, (3,)."""
    return linkage.frames[frame][:3, :3].T @ linkage.plane[:, :2] @ across


def leading(linkage: LoopedPart, body: str) -> list[Slot]:
    """Return the places of the hinges that lead from the ground to a body."""
    above = {hinge.body_b: Slot(hinge.name, hinge.body_a) for hinge in linkage.tree}
    found: list[Slot] = []
    while body in above:
        found.append(above[body])
        body = above[body].body
    return found
