"""Convex pieces that touch in place of a link: hulls of few corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: A closed convex surface of n corners has 2 n - 4 triangles.
MOST_TRIANGLES = 64
MOST_CORNERS = MOST_TRIANGLES // 2 + 2


def few_corners(points: Array, most: int = MOST_CORNERS, slack: float = 0.2) -> Array:
    """Return the points whose hull fills the hull of all best, (k, 3) with k <= most.

    Begins with the six outermost along the axes and adds the one that is farthest out, until the
    hull misses none by more than `slack`.

    Args:
        points: (n, 3) [mm]
        most: so many corners are enough, whatever is missed
        slack: [mm]
    """
    corners = points[ConvexHull(points).vertices]
    corners = corners[np.lexsort(corners.T)]
    chosen: list[int] = _spread(corners)
    while len(chosen) < min(most, len(corners)):
        hull = ConvexHull(corners[chosen])
        out = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        worst = int(np.argmax(out))
        if out[worst] <= slack:
            break
        chosen.append(worst)
    return corners[sorted(chosen)]


def _spread(corners: Array) -> list[int]:
    """Return four or more corners that do not lie in one plane."""
    ends = [int(k(corners[:, axis])) for axis in range(3) for k in (np.argmin, np.argmax)]
    chosen = list(dict.fromkeys(ends))
    while True:
        base = corners[chosen] - corners[chosen[0]]
        _, sizes, axes = np.linalg.svd(base, full_matrices=True)
        if len(chosen) >= 4 and sizes[2] > 1e-6 * sizes[0]:
            return chosen
        away = np.abs((corners - corners[chosen[0]]) @ axes[2])
        chosen.append(int(np.argmax(away)))


def hull_faces(points: Array) -> tuple[Array, Ints]:
    """Return the hull of points as corners (k, 3) and triangles (m, 3), outside anticlockwise."""
    hull = ConvexHull(points)
    used = np.unique(hull.simplices)
    number = np.zeros(len(points), dtype=np.int64)
    number[used] = np.arange(len(used))
    faces = hull.simplices.astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    first = np.argmin(faces, axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return points[used], number[faces[np.lexsort(faces.T[::-1])]]
