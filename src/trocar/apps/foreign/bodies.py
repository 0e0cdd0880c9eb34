"""Masses of foreign links as possible bodies, and their shapes as ours."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.apps.foreign.records import ForeignLink, ForeignModel, ForeignShape
from trocar.apps.foreign.surfaces import hull_of
from trocar.descriptions.shapes import impossible

Array = NDArray[np.float64]

#: What a moving link weighs that the file gives no mass, and the radius of the ball that it is
#: taken for. Source: our own choice: too little to be felt.
NO_MASS_KG, NO_MASS_RADIUS_M = 1e-4, 0.01


@dataclass(frozen=True, eq=False)
class ForeignBody:
    """A link's mass and shapes in the frame that it moves with."""

    frame: str
    link: str
    mass: float
    com: Array
    inertia: Array
    shapes: tuple[ForeignShape, ...]
    source: str


def body_of(
    link: ForeignLink, frame: str, at: Array, *, moves: bool, warnings: list[str]
) -> ForeignBody | None:
    """Return a link's body in the frame that carries it, None of a link that is nothing.

    Args:
        link: as in the file
        frame, at: the frame and T_frame_link
        moves: whether the frame is moved by a joint of its own, and so needs a mass
        warnings: where what was mended is said
    """
    mass, source = link.mass, "the file"
    inertia, com = link.inertia, link.com
    if mass <= 0.0:
        if not moves and not link.shapes:
            return None
        mass, com = NO_MASS_KG, np.zeros(3)
        inertia = 0.4 * mass * NO_MASS_RADIUS_M**2 * np.eye(3)
        source = "placeholder: the file gives no mass"
        if moves:
            warnings.append(f"link {link.name}: moves and has no mass; got {mass:g} kg")
    problem = impossible(inertia)
    if problem:
        inertia = mass * _gyration(link)
        source = f"mass: the file; its inertia is {problem}; that of a box about the shapes"
        warnings.append(f"link {link.name}: inertia is {problem}; replaced by that of a box")
    turn = at[:3, :3]
    return ForeignBody(
        frame,
        link.name,
        mass,
        turn @ com + at[:3, 3],
        turn @ inertia @ turn.T,
        tuple(_placed(s, at) for s in link.shapes),
        source,
    )


def _placed(shape: ForeignShape, at: Array) -> ForeignShape:
    return replace(shape, shape=replace(shape.shape, pose=at @ shape.shape.pose))


def _gyration(link: ForeignLink) -> Array:
    """Return the inertia of 1 kg of a box about a link's shapes, (3, 3) [m^2]."""
    reach = [_corners(s) for s in link.shapes] or [np.array([[-0.01] * 3, [0.01] * 3])]
    corners = np.concatenate(reach)
    a, b, c = np.maximum(np.ptp(corners, axis=0), 1e-3) / 2.0
    return np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 3.0


def extent(shapes: Iterable[tuple[Array, ForeignShape]]) -> float:
    """Return the longest edge of the box about shapes that stand at poses [m], 0 of none."""
    found = [_corners(shape, pose) for pose, shape in shapes]
    return float(np.ptp(np.concatenate(found), axis=0).max()) if found else 0.0


def _corners(shape: ForeignShape, at: Array | None = None) -> Array:
    own = shape.shape
    if own.mesh is not None:
        points = own.mesh.vertices
    else:
        a, b, _ = own.size
        half = own.size if own.kind == "box" else np.array([a, a, a + b])
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        points = signs * half
    pose = own.pose if at is None else at @ own.pose
    return points @ pose[:3, :3].T + pose[:3, 3]


def with_hulls(model: ForeignModel) -> ForeignModel:
    """Return a model whose colliding meshes are convex: each by the hull of its triangles."""
    links = [
        replace(link, shapes=tuple(_hulled(s, f"{model.file}: {link.name}") for s in link.shapes))
        for link in model.links
    ]
    return replace(model, links=tuple(links))


def _hulled(shape: ForeignShape, where: str) -> ForeignShape:
    mesh = shape.shape.mesh
    if mesh is None or not shape.collide or shape.visible:
        return shape
    return replace(shape, shape=replace(shape.shape, mesh=hull_of(mesh, where)))
