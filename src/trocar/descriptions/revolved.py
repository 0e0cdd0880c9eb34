"""Round things of many convex pieces, drawn smooth: rings and cups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.geometry.rotations import rotation_y, rotation_z
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]
#: A line of a profile: two ends and their normals, (radius, height) each.
Line = tuple[Sequence[float], Sequence[float], Sequence[float], Sequence[float]]

#: Boards of a cup. Source: our own choice.
BOARDS = 12
#: Fewer sides of a ring are drawn as rods with corners. Source: our own choice.
ROUND = 8
#: Corners of what is drawn round, and of a ring's wire. Source: our own choice, 0.4 % off a circle.
CORNERS, WIRE_CORNERS = 48, 16


def ring(like: Shape, radius: float, wire: float, sides: int) -> tuple[Shape, ...]:
    """Return a ring about its z axis: rods from corner to corner, and a smooth one to look at.

    Args:
        like: pose, material and surface of the shapes
        radius: of the circle that the corners are on [m]
        wire: radius of the rods [m]
        sides: rods
    """
    angle, half = 2.0 * np.pi / sides, radius * np.sin(np.pi / sides)
    inner = radius * np.cos(np.pi / sides)
    lying = transform(rotation_z(np.pi / 2.0) @ rotation_y(np.pi / 2.0), [inner, 0.0, 0.0])
    smooth = sides >= ROUND
    rods = tuple(
        replace(
            like,
            kind="capsule",
            pose=like.pose @ transform(rotation_z((k + 0.5) * angle), np.zeros(3)) @ lying,
            size=np.array([wire, half, 0.0]),
            visible=like.visible and not smooth,
        )
        for k in range(sides)
    )
    if not smooth or not like.visible:
        return rods
    turns = 2.0 * np.pi * np.arange(WIRE_CORNERS) / WIRE_CORNERS
    out = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    at = [radius, 0.0] + wire * out
    lines = list(zip(at, out, np.roll(at, -1, 0), np.roll(out, -1, 0), strict=True))
    return *rods, _drawn(like, revolved(lines, f"ring_{1e6 * radius:.0f}_{1e6 * wire:.0f}"))


def cup(like: Shape, radius: float, wall: float, height: float, floor: float) -> tuple[Shape, ...]:
    """Return a cup about its z axis that stands at 0: a bottom, a ring of boards, a smooth face.

    Args:
        like: pose, material and surface of the shapes
        radius: inside [m]
        wall, floor: thickness [m]
        height: of the whole [m]
    """
    outer = radius + wall
    half = np.array([0.5 * wall, outer * np.tan(np.pi / BOARDS), 0.5 * height])
    board = transform(np.eye(3), [radius + 0.5 * wall, 0.0, 0.5 * height])
    hidden = replace(like, visible=False)
    boards = (
        replace(
            hidden,
            kind="box",
            pose=like.pose @ transform(rotation_z(k * 2 * np.pi / BOARDS), np.zeros(3)) @ board,
            size=half,
        )
        for k in range(BOARDS)
    )
    bottom = replace(
        hidden,
        kind="cylinder",
        pose=like.pose @ transform(np.eye(3), [0.0, 0.0, 0.5 * floor]),
        size=np.array([outer, 0.5 * floor, 0.0]),
    )
    if not like.visible:
        return bottom, *boards
    down, up, out, into = (0.0, -1.0), (0.0, 1.0), (1.0, 0.0), (-1.0, 0.0)
    lines: list[Line] = [
        ((0.0, 0.0), down, (outer, 0.0), down),
        ((outer, 0.0), out, (outer, height), out),
        ((outer, height), up, (radius, height), up),
        ((radius, height), into, (radius, floor), into),
        ((radius, floor), up, (0.0, floor), up),
    ]
    name = "_".join(f"{1e6 * size:.0f}" for size in (radius, wall, height, floor))
    return bottom, *boards, _drawn(like, revolved(lines, f"cup_{name}"))


def revolved(lines: Sequence[Line], name: str) -> Mesh:
    """Return the surface that lines make when they turn about the z axis.

    Args:
        lines: of the profile, outside to the right of their direction
        name: of the mesh
    """
    turn = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    c, s = np.cos(turn), np.sin(turn)
    points: list[Array] = []
    normals: list[Array] = []
    faces: list[NDArray[np.int64]] = []
    for number, line in enumerate(lines):
        for end, out in (line[:2], line[2:]):
            points.append(np.stack([end[0] * c, end[0] * s, np.full(CORNERS, end[1])], axis=-1))
            normals.append(np.stack([out[0] * c, out[0] * s, np.full(CORNERS, out[1])], axis=-1))
        one = 2 * number * CORNERS + np.arange(CORNERS)
        other = 2 * number * CORNERS + np.roll(np.arange(CORNERS), -1)
        if line[0][0] > 0.0:
            faces.append(np.stack([one, other, one + CORNERS], axis=-1))
        if line[2][0] > 0.0:
            faces.append(np.stack([other, other + CORNERS, one + CORNERS], axis=-1))
    return Mesh(np.concatenate(points), np.concatenate(faces), name, np.concatenate(normals))


def _drawn(like: Shape, mesh: Mesh) -> Shape:
    """Return the shape of a mesh that is only seen."""
    size = np.abs(mesh.vertices).max(axis=0)
    shape = replace(like, kind="mesh", size=size, mesh=mesh, collide=False, weigh=False)
    return replace(shape, density=None, stiffness=None, friction=None)
