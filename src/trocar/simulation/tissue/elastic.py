"""Soft tissue as a linear finite-element mesh, condensed to the few places where it is held.

Two halves of a pad lie on both sides of a wound, clamped below and on the faces away from it. The
mesh has trilinear cells of eight nodes. A place is a patch: the displacement there is a weighted
mean over a ball of a stated radius, a force there is spread over it with the same weights w(q) =
(1 - q^2)^2. With W the patches' weights and A the mesh's stiffness, places displaced by d take the
forces K d with K = (W^T A^-1 W)^-1: exactly those of the whole mesh, whatever its size.

Frame: origin in the middle of the wound on the surface at rest, x along the wound, z outwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_matrix  # pyright: ignore[reportMissingTypeStubs]
from scipy.sparse.linalg import splu  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.descriptions.tissues import Tissue

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Corners of a cell in the order of its nodes, and of the quadrature points, in units of half its
#: edges. Source: Gauss-Legendre of two points.
CORNERS = np.array([[i, j, k] for k, j, i in product((-1.0, 1.0), repeat=3)])
GAUSS = CORNERS / np.sqrt(3.0)
#: Corners of a cell's six faces, outwards.
FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
#: Points of quadrature along each edge of a cell, of patches. Source: our own choice; a patch of
#: 1.5 mm on cells of 1 mm then weighs 1 to 1e-3.
PATCH_POINTS = 4


@dataclass(frozen=True, eq=False)
class Condensed:
    """A mesh condensed to patches.

    Attributes:
        stiffness: forces of the patches by their displacements, (3k, 3k) [N/m]
        response: displacements of all nodes by those of the patches, (n, 3, 3k); the patches take
            no other force
    """

    stiffness: Array
    response: Array


class ElasticPad:
    """The mesh of a tissue, factored once.

    Args:
        tissue: its dimensions and moduli

    Attributes:
        nodes: at rest, (n, 3) [m]
        cells: corners of each, in the order of `CORNERS`, (m, 8)
        sizes: edges of a cell, (3,) [m]
        matrix: forces of the nodes by their displacements, (3n, 3n)
        free: those of them that are not clamped
    """

    def __init__(self, tissue: Tissue) -> None:
        edges = np.array(
            [
                np.round(size / tissue.element).clip(1)
                for size in (tissue.length, tissue.width, tissue.depth)
            ]
        ).astype(int)
        xs = np.linspace(-0.5, 0.5, edges[0] + 1) * tissue.length
        ys = np.linspace(0.0, tissue.width, edges[1] + 1) + 0.5 * tissue.gap
        zs = np.linspace(-tissue.depth, 0.0, edges[2] + 1)
        counts = edges + 1
        grid = np.stack(np.meshgrid(xs, ys, zs, indexing="ij"), axis=-1).reshape(-1, 3)
        number = np.arange(len(grid)).reshape(counts)
        base = number[:-1, :-1, :-1].ravel()
        steps = (CORNERS + 1.0).astype(int) // 2 @ [counts[1] * counts[2], counts[2], 1]
        half = cast(Index, base[:, None] + steps)
        other = np.argsort(CORNERS @ [1, -2, 4])  # the mirrored cell's corners in order
        self.nodes = np.concatenate([grid, grid * [1.0, -1.0, 1.0]])
        self.cells: Index = np.concatenate([half, half[:, other] + len(grid)])
        self.sizes = np.array([xs[1] - xs[0], ys[1] - ys[0], zs[1] - zs[0]])
        self._patch_radius = tissue.patch
        middles = self._middles()
        moduli = tissue.modulus_at(-middles[:, 2])
        unit = _cell_stiffness(self.sizes, tissue.poisson)
        dofs = (3 * self.cells[:, :, None] + np.arange(3)).reshape(-1, 24)
        rows, columns = np.repeat(dofs, 24, axis=1).ravel(), np.tile(dofs, (1, 24)).ravel()
        size = 3 * len(self.nodes)
        values = (moduli[:, None, None] * unit).ravel()
        self.matrix: Any = csc_matrix((values, (rows, columns)), shape=(size, size))
        outer = 0.5 * tissue.gap + tissue.width
        fixed = np.isclose(self.nodes[:, 2], -tissue.depth)
        fixed |= np.isclose(np.abs(self.nodes[:, 1]), outer)
        self.free: Index = np.flatnonzero(np.repeat(~fixed, 3))
        #: Those of the half at +y; the other half is its mirror image.
        self._half = self.free[self.free < size // 2]
        self._factor: Any = splu(
            self.matrix[self._half][:, self._half].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def _middles(self) -> Array:
        """Return the middles of the cells at rest, (m, 3) [m]."""
        return self.nodes[self.cells].mean(axis=1)

    def weights(self, point: ArrayLike) -> Array:
        """Return the weights of the nodes in the patch about a point, (n,), with the sum 1.

        Only the half on the point's side of the wound has some.
        """
        at = np.asarray(point, dtype=np.float64)
        middles = self._middles()
        reach = self._patch_radius + 0.5 * float(np.linalg.norm(self.sizes))
        near = np.linalg.norm(middles - at, axis=1) < reach
        near &= np.sign(middles[:, 1]) == (1.0 if at[1] > 0.0 else -1.0)
        line = (np.arange(PATCH_POINTS) + 0.5) * 2.0 / PATCH_POINTS - 1.0
        local = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
        places = middles[near][:, None] + 0.5 * self.sizes * local
        apart = np.linalg.norm(places - at, axis=-1) / self._patch_radius
        share = np.where(apart < 1.0, (1.0 - apart**2) ** 2, 0.0)
        found = np.zeros(len(self.nodes))
        np.add.at(found, self.cells[near], share @ _shape_functions(local))
        return found / found.sum()

    def condense(self, points: ArrayLike) -> Condensed:
        """Condense the mesh to patches about points, (k, 3) [m]."""
        at = np.atleast_2d(np.asarray(points, dtype=np.float64))
        spread = np.zeros((len(self.nodes), 3, len(at), 3))
        for k, point in enumerate(at):
            weights = self.weights(point)
            for axis in range(3):
                spread[:, axis, k, axis] = weights
        forces = spread.reshape(3 * len(self.nodes), -1)
        moved = self.solve(forces)
        compliance = forces.T @ moved
        stiffness: Array = np.linalg.inv(0.5 * (compliance + compliance.T)).astype(np.float64)
        return Condensed(stiffness, (moved @ stiffness).reshape(len(self.nodes), 3, -1))

    def solve(self, forces: Array) -> Array:
        """Return the displacements of the nodes by forces on them, (3n, ...) [m, N]."""
        columns = forces.reshape(len(forces), -1)
        moved, size = np.zeros_like(columns), len(columns) // 2
        flipped = np.where(self._half % 3 == 1, -1.0, 1.0)[:, None]
        for rows, mirror in ((self._half, 1.0), (self._half + size, flipped)):
            some = np.flatnonzero(columns[rows].any(axis=0))
            if len(some):
                part = np.ix_(rows, some)
                moved[part] = mirror * self._factor.solve(mirror * columns[part])
        return moved.reshape(forces.shape)

    def volumes(self, moved: Array) -> Array:
        """Return the factors by which displacements (n, 3) change the cells' volumes, (m,).

        They are those in the middle of each; one that is not above 0 is turned inside out.
        """
        slopes = CORNERS / 8.0 * (2.0 / self.sizes)
        along: Array = np.ascontiguousarray(moved.T)[:, self.cells] @ slopes + np.eye(3)[:, None]
        x, y, z = np.moveaxis(along, 2, 0)  # of each cell's edges along each axis
        return (  # in a third of the time of np.linalg.det
            x[0] * (y[1] * z[2] - y[2] * z[1])
            + x[1] * (y[2] * z[0] - y[0] * z[2])
            + x[2] * (y[0] * z[1] - y[1] * z[0])
        )

    def surface(self) -> tuple[Index, Index]:
        """Return the nodes of the visible surface, (k,), and its triangles among them, (m, 3)."""
        quads = self.cells[:, FACES].reshape(-1, 4)
        _, first, count = np.unique(
            np.sort(quads, axis=1), axis=0, return_index=True, return_counts=True
        )
        outside = quads[first[count == 1]]
        below = np.isclose(self.nodes[outside][:, :, 2], self.nodes[:, 2].min()).all(axis=1)
        outside = outside[~below]
        nodes, corners = np.unique(outside, return_inverse=True)
        corners = corners.reshape(-1, 4)
        return nodes, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])


@lru_cache(maxsize=4)
def pad_of(tissue: Tissue) -> ElasticPad:
    """Return the mesh of a tissue, factored once."""
    return ElasticPad(tissue)


def _shape_functions(local: Array) -> Array:
    """Return the shape functions of a cell's corners at local places (k, 3), (k, 8)."""
    return np.prod(1.0 + local[:, None] * CORNERS, axis=-1) / 8.0


def _cell_stiffness(sizes: Array, poisson: float) -> Array:
    """Return the stiffness of a cell of modulus 1, (24, 24).

    Source: trilinear hexahedron with two Gauss points along each edge, as in any textbook.
    """
    elastic = np.zeros((6, 6))
    elastic[:3, :3] = poisson
    elastic[range(3), range(3)] = 1.0 - poisson
    elastic[3:, 3:] = np.eye(3) * (1.0 - 2.0 * poisson) / 2.0
    elastic /= (1.0 + poisson) * (1.0 - 2.0 * poisson)
    found = np.zeros((24, 24))
    for place in GAUSS:
        factors = 1.0 + place * CORNERS
        slopes = CORNERS / 8.0 * factors[:, [1, 0, 0]] * factors[:, [2, 2, 1]] * (2.0 / sizes)
        strain = np.zeros((6, 8, 3))
        for row, parts in enumerate(((0, 0), (1, 1), (2, 2))):
            strain[row, :, parts[0]] = slopes[:, parts[1]]
        for row, (one, two) in enumerate(((0, 1), (1, 2), (2, 0)), start=3):
            strain[row, :, one], strain[row, :, two] = slopes[:, two], slopes[:, one]
        B = strain.reshape(6, 24)
        found += B.T @ elastic @ B * np.prod(sizes) / 8.0
    return found
