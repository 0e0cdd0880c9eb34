"""Shapes of a calibrated robot: drawn for it, or the nominal ones moved with their axes.

A link carries several axes: its own, those of the links that turn on it, and closing hinges. Where
a calibration has moved them, each point of the link's meshes moves by a mean of what the axes have
moved by at that height, weighted by the inverse cube of the distance from each (Shepard 1968, "A
two-dimensional interpolation function for irregularly-spaced data"). What lies on an axis lies on
the calibrated axis afterwards, and nothing tears.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import hinge_side
from trocar.descriptions.records import ArmDescription, Body, Shape
from trocar.descriptions.solids import read_solid, seen_and_touched
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

#: Weight of an axis is its distance to the power of minus this. Source: our own choice: the bosses
#: around an axis move with it as one piece, and the middle of a rod shares its ends' ways.
POWER = 3.0
#: Corners of a box of half edges 1.
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
#: Nearer than this a point lies on the axis; axes that moved less have not moved. [m]
NEAR = 1e-9


@dataclass(frozen=True, eq=False)
class CarriedAxis:
    """An axis of a link, as drawn and as calibrated: points (3,) [m] and directions (3,)."""

    point: Array
    along: Array
    point_now: Array
    along_now: Array

    @property
    def moved(self) -> bool:
        """Whether it stands elsewhere now."""
        away = np.abs(self.point_now - self.point).max()
        return bool(max(away, np.abs(self.along_now - self.along).max()) > NEAR)


def calibrated_bodies(arm: ArmDescription, now: Mechanism, overlay: str) -> tuple[Body, ...]:
    """Return an arm's bodies with the shapes of the calibrated robot.

    Args:
        arm: the nominal arm
        now: its mechanism as calibrated
        overlay: the overlay's file; a folder `NAME.solids` beside `NAME.toml` holds what `trocar
            cad --calibration` has drawn for this robot
    """
    folder = Path(overlay).with_suffix(".solids") if overlay else None
    axes = carried_axes(arm.mechanism, now, {body.frame for body in arm.bodies})
    return tuple(_calibrated(body, axes.get(body.frame, ()), folder) for body in arm.bodies)


def _calibrated(body: Body, axes: tuple[CarriedAxis, ...], folder: Path | None) -> Body:
    if folder is not None and body.solid and folder.is_dir():
        try:
            solid = read_solid(body.solid, folder)
        except KeyError:
            pass  # of another arm or of a tool
        else:
            nominal = len(seen_and_touched(read_solid(body.solid), body.touches))
            drawn = seen_and_touched(solid, body.touches)
            return replace(body, shapes=(*drawn, *body.shapes[nominal:]))
    if not any(axis.moved for axis in axes):
        return body
    return replace(body, shapes=tuple(_warped(shape, axes) for shape in body.shapes))


def _warped(shape: Shape, axes: tuple[CarriedAxis, ...]) -> Shape:
    """Return a shape whose mesh, or box that is only touched, has moved with the axes."""
    turn, at = shape.pose[:3, :3], shape.pose[:3, 3]
    if shape.kind == "box" and not shape.visible:
        corners = shape.size * CORNERS
        moved = (warp(corners @ turn.T + at, axes) - at) @ turn
        lower, upper = moved.min(axis=0), moved.max(axis=0)
        place = shape.pose @ transform(np.eye(3), 0.5 * (lower + upper))
        return replace(shape, pose=place, size=0.5 * (upper - lower))
    if shape.mesh is None:
        return shape
    moved = warp(shape.mesh.vertices @ turn.T + at, axes)
    vertices = (moved - at) @ turn
    mark = hashlib.sha256(np.round(vertices, 9).tobytes()).hexdigest()[:8]
    mesh = replace(shape.mesh, vertices=vertices, name=f"{shape.mesh.name}_{mark}")
    return replace(shape, mesh=mesh, size=np.abs(vertices).max(axis=0))


def warp(points: Array, axes: tuple[CarriedAxis, ...]) -> Array:
    """Return where points of a link lie when its axes have moved, (n, 3) [m]."""
    ways, weights = np.zeros((len(axes), *points.shape)), np.zeros((len(axes), len(points)))
    for k, axis in enumerate(axes):
        height = (points - axis.point) @ axis.along
        foot = axis.point + height[:, None] * axis.along
        ways[k] = axis.point_now + height[:, None] * axis.along_now - foot
        away = np.linalg.norm(points - foot, axis=1)
        weights[k] = np.maximum(away, NEAR) ** -POWER
    share = weights / weights.sum(axis=0)
    return points + np.einsum("kn,kni->ni", share, ways)


def carried_axes(
    before: Mechanism, now: Mechanism, bodied: set[str]
) -> Mapping[str, tuple[CarriedAxis, ...]]:
    """Return the axes that each link carries, in the link's frame, {frame: axes}.

    Args:
        before: the nominal mechanism
        now: as calibrated; frames that are new in it, such as pins, are left out
        bodied: frames with a body, which are links though they may stand still
    """
    first, then = _in_links(before, bodied), _in_links(now, bodied)
    found: dict[str, list[CarriedAxis]] = {}
    for frame in before.frames:
        if frame.motion == "fixed" or frame.name not in then:
            continue
        link, pose = first[frame.name]
        found.setdefault(link, []).append(_axis(pose, then[frame.name][1]))
        own = inverse(frame.after)
        found.setdefault(frame.name, []).append(_axis(own, own))
    after = {closure.name: closure for closure in now.closures}
    for closure in before.closures:
        other = after[closure.name]
        side = hinge_side(before, closure)[0]
        # The far side of a pin that slides is where the pin stands, which is the pin's own frame.
        point_b = other.point_b
        if hinge_side(now, other)[1] and not hinge_side(before, closure)[1]:
            point_b = now.frame(other.frame_b).before[:3, 3]
        for link, point, moved in (
            (closure.frame_a, closure.point_a, other.point_a),
            (side, closure.point_b, point_b),
        ):
            upright = np.array([0.0, 0.0, 1.0])
            found.setdefault(link, []).append(CarriedAxis(point, upright, moved, upright))
    return {link: tuple(axes) for link, axes in found.items()}


def _axis(pose: Array, now: Array) -> CarriedAxis:
    return CarriedAxis(pose[:3, 3], pose[:3, 2], now[:3, 3], now[:3, 2])


def _in_links(mechanism: Mechanism, bodied: set[str]) -> dict[str, tuple[str, Array]]:
    """Return the link that carries each frame's axis, and the axis' pose in it: {frame: ...}."""
    at: dict[str, tuple[str, Array]] = {}
    stands: dict[str, tuple[str, Array]] = {}
    for frame in mechanism.frames:
        link, pose = (frame.name, np.eye(4)) if frame.parent is None else stands[frame.parent]
        at[frame.name] = link, pose @ frame.before
        still = frame.parent is not None and frame.motion == "fixed" and frame.name not in bodied
        placed = pose @ frame.before @ frame.after
        stands[frame.name] = (link, placed) if still else (frame.name, np.eye(4))
    return at
