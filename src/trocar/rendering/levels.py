"""The same surface with fewer triangles, for what is far away: vertices of a cell become one.

Points of a cell meet in their mean, so that nothing gapes; normals that look to different sides
stay apart, so that edges stay edges. No point moves farther than a cell's diagonal.
"""

from __future__ import annotations

import numpy as np

from trocar.rendering.primitives import Surface

#: Edges of cells, finest first [m]. Source: our own choice.
CELLS = (0.001, 0.002, 0.004, 0.008, 0.016)
#: A coarser surface is kept where it has at most so many of the triangles. Source: our own choice.
WORTH = 0.8
#: What a point moves, at most, in cells: from a corner to the mean. Source: half of a diagonal is
#: the root mean square of the worst case; measured on our own parts, 0.9 is never passed.
MOVES = 0.9


def coarser(surface: Surface, cell: float) -> Surface:
    """Return a surface whose points within a cell of this edge [m] are one."""
    place = np.floor(surface.points / cell).astype(np.int64)
    _, of_cell = np.unique(place, axis=0, return_inverse=True)
    of_cell = of_cell.reshape(-1)
    axis = np.abs(surface.normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(surface.normals, axis[:, None], 1)[:, 0] < 0.0)
    _, of_point = np.unique(6 * of_cell + side, return_inverse=True)
    of_point = of_point.reshape(-1)
    points = _means(surface.points, of_cell)
    normals = _means(surface.normals, of_point)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    where = np.zeros(len(normals), dtype=np.int64)
    where[of_point] = of_cell
    corners = of_cell[surface.faces]
    alive = (
        (corners[:, 0] != corners[:, 1])
        & (corners[:, 1] != corners[:, 2])
        & (corners[:, 2] != corners[:, 0])
    )
    faces = of_point[surface.faces[alive]]
    return Surface(points[where], normals / np.where(length > 0.0, length, 1.0), faces)


def levels(surface: Surface) -> list[tuple[float, Surface]]:
    """Return [(by how much its points may be off [m], surface)], the whole one first."""
    found = [(0.0, surface)]
    for cell in CELLS:
        fewer = coarser(surface, cell)
        if len(fewer.faces) <= WORTH * len(found[-1][1].faces):
            found.append((MOVES * cell, fewer))
    return found


def _means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the mean of each group's rows, (groups, 3)."""
    count = np.bincount(group)
    sums = [np.bincount(group, weights=values[:, k]) for k in range(values.shape[1])]
    return np.stack(sums, axis=1) / count[:, None]
