"""A linkage's geometry as numbers, and back into a description.

At home every frame keeps the orientation that the description gives it; what a robot has of its
own is where its axes stand. The numbers are displacements in the plane across the axes, two for
each place at which a body carries a hinge: of a frame's hinge in the parent's body, of a closure in
both. So a shorter link moves an axis in the frame of that link, and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.linkage import Hinge, Linkage
from trocar.kinematics.mechanism import Closure, Frame, Mechanism

Array = NDArray[np.float64]

# Source: our own choice. Two axes of the ground nearer than this give it no direction. [m]
APART_M = 1e-3


@dataclass(frozen=True)
class Slot:
    """A place at which a body carries a hinge."""

    hinge: str
    body: str


def slots(linkage: Linkage) -> tuple[Slot, ...]:
    """Return the places that the displacements belong to, in their order."""
    found: list[Slot] = []
    for hinge in linkage.hinges:
        found.append(Slot(hinge.name, hinge.body_a))
        if hinge.closure:
            found.append(Slot(hinge.name, hinge.body_b))
    return tuple(found)


def shift_rows(linkage: Linkage) -> dict[str, Array]:
    """Return how displacements move each body at home, {body: (n_slots,)} of zeros and ones."""
    places = slots(linkage)
    rows = {linkage.ground: np.zeros(len(places))}
    for column, (hinge, _) in enumerate(_tree(linkage)):
        start = rows.setdefault(hinge.body_a, np.zeros(len(places)))
        rows[hinge.body_b] = start.copy()
        rows[hinge.body_b][column] += 1.0
    return rows


def place_rows(linkage: Linkage) -> dict[Slot, Array]:
    """Return how displacements move each place at home, {place: (n_slots,)}."""
    rows = shift_rows(linkage)
    unit = np.eye(len(slots(linkage)))
    return {slot: rows[slot.body] + unit[i] for i, slot in enumerate(slots(linkage))}


def home_points(linkage: Linkage, moved: Array) -> dict[Slot, Array]:
    """Return where each body has its hinges at home.

    Args:
        linkage: the loops
        moved: displacements, (n_slots, 2) [m]

    Returns:
        {place: (2,) in the plane [m]}, of a frame's hinge for both of its bodies
    """
    rows = place_rows(linkage)
    found = {slot: linkage.points[slot.hinge] + rows[slot] @ moved for slot in slots(linkage)}
    for hinge, slot in _tree(linkage):
        found[Slot(hinge.name, hinge.body_b)] = found[slot]
    return found


def displacements(linkage: Linkage, points: Mapping[Slot, Array]) -> Array:
    """Return the displacements that put the hinges at these places, (n_slots, 2) [m]."""
    places, rows = slots(linkage), place_rows(linkage)
    away = np.stack([points[slot] - linkage.points[slot.hinge] for slot in places])
    found = np.linalg.solve(np.stack([rows[slot] for slot in places]), away)
    return np.asarray(found, dtype=np.float64)


def closing_rows(linkage: Linkage, parallelogram: bool) -> Array:
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


def gauge_rows(linkage: Linkage) -> Array:
    """Return three rows that hold the ground still, (3, 2 n_slots).

    The first hinge of the ground stays, and the direction from there to the ground's next one, or
    to the next one of the first link where these two coincide.
    """
    rows = place_rows(linkage)
    first = next(hinge for hinge, _ in _tree(linkage))
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


def freedoms(linkage: Linkage, parallelogram: bool) -> Array:
    """Return an orthonormal basis of the displacements that close, (2 n_slots, n_free)."""
    closing = np.kron(closing_rows(linkage, parallelogram), np.eye(2))
    held = np.vstack([closing, gauge_rows(linkage)])
    _, sizes, right = np.linalg.svd(held)
    return np.asarray(right[int(np.sum(sizes > 1e-9)) :].T, dtype=np.float64)


def rebuilt(
    linkage: Linkage, mechanism: Mechanism, moved: Array, tilts: Mapping[str, Array] | None = None
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
            before[:3, :3] = _turn(turn) @ before[:3, :3]
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


def in_frame(linkage: Linkage, frame: str, across: Array) -> Array:
    """Return a vector in the plane as a frame has it at home, (3,)."""
    return linkage.frames[frame][:3, :3].T @ linkage.plane[:, :2] @ across


def _turn(vector: Array) -> Array:
    half = 0.5 * np.cross(np.eye(3), vector)
    return np.asarray(np.linalg.solve(np.eye(3) - half, np.eye(3) + half), dtype=np.float64)


def _tree(linkage: Linkage) -> list[tuple[Hinge, Slot]]:
    return [(h, Slot(h.name, h.body_a)) for h in linkage.hinges if not h.closure]


def leading(linkage: Linkage, body: str) -> list[Slot]:
    """Return the places of the hinges that lead from the ground to a body."""
    above = {hinge.body_b: slot for hinge, slot in _tree(linkage)}
    found: list[Slot] = []
    while body in above:
        found.append(above[body])
        body = above[body].body
    return found
