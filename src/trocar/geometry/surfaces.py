"""Triangle surfaces: their normals, and tubes around curves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Points around a tube. Source: our own choice; chords miss its circle by 3.4 % of the radius.
AROUND = 12


def vertex_normals(points: Array, faces: Ints) -> Array:
    """Return unit normals at the vertices: means over their triangles, weighted by area, (n, 3).

    Args:
        points: (n, 3)
        faces: (m, 3), anticlockwise seen from outside
    """
    a, b, c = points[faces.T]
    across = np.cross(b - a, c - a)
    corners, each = faces.ravel(), np.repeat(across, 3, axis=0)
    sums = [np.bincount(corners, each[:, k], len(points)).astype(float) for k in range(3)]
    return _unit(np.stack(sums, axis=1))


def tube(points: Array, radius: ArrayLike) -> tuple[Array, Array, Ints]:
    """Return a closed tube around a curve: points (n, 3), normals (n, 3) and faces (m, 3).

    Its cross-sections do not twist: each follows from the one before by the smallest rotation
    between their tangents.

    Args:
        points: of the curve, (k, 3), k > 1
        radius: the same everywhere, or at each point (k,)
    """
    k = len(points)
    ahead = _unit(np.diff(points, axis=0))
    along = _unit(np.concatenate([ahead[:1], ahead[:-1] + ahead[1:], ahead[-1:]]))
    side = _unit(np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)]))
    up = np.cross(along, side)
    # How far each section's own axes are turned from those carried over from the section before.
    t0, t1, before = along[:-1], along[1:], side[:-1]
    lean = (t1 * before).sum(axis=1) / np.maximum(1.0 + (t0 * t1).sum(axis=1), 1e-9)
    carried = before - lean[:, None] * (t0 + t1)
    step = np.arctan2((carried * up[1:]).sum(axis=1), (carried * side[1:]).sum(axis=1))
    turn = np.concatenate([[0.0], np.cumsum(step)])
    angle = turn[:, None] + np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    out = np.cos(angle)[..., None] * side[:, None] + np.sin(angle)[..., None] * up[:, None]
    rings = points[:, None] + np.broadcast_to(radius, k)[:, None, None] * out
    ends = np.array([-along[0], along[-1]])
    row, column = np.meshgrid(np.arange(k - 1), np.arange(AROUND), indexing="ij")
    here, right = row * AROUND + column, row * AROUND + (column + 1) % AROUND
    sides = [np.stack([here, right, right + AROUND], -1),
             np.stack([here, right + AROUND, here + AROUND], -1)]  # fmt: skip
    around, after = np.arange(AROUND), np.roll(np.arange(AROUND), -1)
    start, end = k * AROUND, (k + 1) * AROUND + 1  # rings of the lids, each before its middle
    middles = np.full((2, AROUND), [[start + AROUND], [end + AROUND]])
    lids = [np.stack([after + start, around + start, middles[0]], -1),
            np.stack([around + end, after + end, middles[1]], -1)]  # fmt: skip
    return (
        np.concatenate([rings.reshape(-1, 3), rings[0], points[:1], rings[-1], points[-1:]]),
        np.concatenate([out.reshape(-1, 3), np.repeat(ends, AROUND + 1, axis=0)]),
        np.concatenate([*(each.reshape(-1, 3) for each in sides), *lids]),
    )


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0.0, length, 1.0)
