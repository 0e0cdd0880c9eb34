"""Jaws on soft tissue: fingers that press its surface, and pads that grip it.

Fingers are boxes. Each node of the upper surface that a box is above of stays below the box: with
the gaps g where nothing presses and the surface's compliance S, forces f >= 0 that open the gaps
g + S f >= 0, one of both 0 at each node. They are vertical, without friction. Two pads that close
within tissue hold the patch between them, which moves with the jaw from then on.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, cast

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.descriptions.records import RigDescription
from trocar.descriptions.tissues import Tissue
from trocar.modeling import naming
from trocar.simulation.tissue.elastic import ElasticPad, pad_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: A finger that comes this near to the surface until the next look is looked at in each step.
#: Source: our own choice. [m]
NEAR_M = 1e-4
#: A finger is not looked at closely that this speed would not bring to the surface until the next
#: look. Source: our own choice, the largest at which jaws do not pass through tissue. [m/s]
FASTEST_M_S = 0.1
#: Changes of the set of nodes that touch, until it is searched for with certainty. Source: our own
#: choice; 1 to 5 are usual.
CHANGES = 20
#: Least compliance of a node beside that of the mesh, which keeps its inverse finite. Source: our
#: own choice: 1 N presses it in by 1 nm. [m/N]
SOFT = 1e-9
#: Pads whose middles are so near hold what is between them, and let go of it where they are so far
#: apart. Source: our own choice; shut, they are 1.7 mm apart. [m]
CLOSED_M, OPENED_M = 2.6e-3, 3.4e-3
#: Pads hold tissue so far before their ends. Source: our own choice. [m]
END_M = 1e-3

GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)


@dataclass(frozen=True)
class JawFingers:
    """The fingers of an arm.

    Attributes:
        arm: its name
        bodies: of both fingers
        geoms: the box of each
    """

    arm: str
    bodies: tuple[int, int]
    geoms: tuple[int, int]


class Held(NamedTuple):
    """A patch of tissue between pads.

    Attributes:
        jaw: row of the jaw
        point: where the patch is at rest, in the tissue's frame (3,) [m]
        anchor: where it is held, in the first finger's frame (3,) [m]
    """

    jaw: int
    point: Array
    anchor: Array


@lru_cache(maxsize=4)
def compliance_of(tissue: Tissue) -> tuple[Index, Array]:
    """Return the nodes of the upper surface of the half at +y, and their compliance upwards.

    They are those of a grid, along the wound and away from it; the mesh is its own mirror image
    along the wound, so loads on half of them tell the rest.
    """
    pad = pad_of(tissue)
    half = len(pad.nodes) // 2
    top = np.flatnonzero(np.isclose(pad.nodes[:half, 2], 0.0))
    top = top[np.isin(3 * top + 2, pad.free)]
    grid = np.arange(len(top)).reshape(len(np.unique(pad.nodes[top, 0])), -1)
    mirror, loaded = grid[::-1].ravel(), grid[: (len(grid) + 1) // 2].ravel()
    forces = np.zeros((3 * len(pad.nodes), len(loaded)))
    forces[3 * top[loaded] + 2, range(len(loaded))] = 1.0
    moved = pad.solve(forces)[3 * top + 2]
    found = np.empty((len(top), len(top)))
    found[:, loaded], found[:, mirror[loaded]] = moved, moved[mirror]
    return top, 0.5 * (found + found.T)


def jaws_of(rig: RigDescription, model: mujoco.MjModel) -> list[JawFingers]:
    """Return the jaws of a rig whose fingers touch as one box each."""
    found: list[JawFingers] = []
    for arm in rig.arms:
        bodies = [model.body(naming.scoped(arm.name, name)).id for name in arm.arm.fingers]
        boxes = [
            g
            for body in bodies
            for g in range(model.ngeom)
            if model.geom_bodyid[g] == body
            and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX
            and (model.geom_contype[g] or model.geom_conaffinity[g])
        ]
        if len(bodies) == len(boxes) == 2:
            found.append(JawFingers(arm.name, (bodies[0], bodies[1]), (boxes[0], boxes[1])))
    return found


class TissueSurface:
    """The upper surface of both halves, as it yields to vertical forces.

    Args:
        tissue: that has it
        pad: its mesh
        response: displacements of all nodes by those of its places, (n, 3, k)
        stiffness: forces of the places by their displacements, (k, k) [N/m]

    Attributes:
        nodes: of both halves, (2, n)
        at: where they are at rest, along and across, (2, n, 2) [m]
        rise: their heights by displacements of the places, (2, n, k)
    """

    def __init__(self, tissue: Tissue, pad: ElasticPad, response: Array, stiffness: Array) -> None:
        top, compliance = compliance_of(tissue)
        self.nodes = np.stack([top, top + len(pad.nodes) // 2])
        self.at = pad.nodes[self.nodes, :2]
        self.rise = response[self.nodes, 2]
        #: The nodes are those of a grid, along the wound and away from it.
        along, across = np.unique(self.at[0, :, 0]), np.unique(self.at[0, :, 1])
        self._along, self._across = along.tolist(), across.tolist()
        self._grid = np.arange(len(top)).reshape(len(along), len(across))
        back = np.linalg.inv(stiffness)
        held = self.rise @ back @ np.swapaxes(self.rise, 1, 2)
        #: With the places held where they are.
        self.compliance = compliance - held

    def under(self, half: int, box: Array, reach: Array) -> Index:
        """Return the nodes of a half within half the edges of a box of its middle, (k,)."""
        x, y = float(box[0]), float(box[1]) * (1.0 - 2.0 * half)
        dx, dy = float(reach[0]), float(reach[1])
        rows = slice(bisect_left(self._along, x - dx), bisect_right(self._along, x + dx))
        columns = slice(bisect_left(self._across, y - dy), bisect_right(self._across, y + dy))
        return self._grid[rows, columns].ravel()


def press(compliance: Array, gaps: Array) -> Array:
    """Return the forces f >= 0 with gaps + compliance f >= 0, of both one 0 at each node, (n,).

    Args:
        compliance: symmetric, positive definite, (n, n) [m/N]
        gaps: without forces, (n,) [m]
    """
    touch, count = gaps < 0.0, len(gaps)
    matrix = compliance.copy()
    matrix.flat[:: count + 1] += SOFT
    for _ in range(CHANGES):
        forces = np.zeros(count)
        rows = np.flatnonzero(touch)
        forces[rows] = np.linalg.solve(matrix[rows[:, None], rows], -gaps[rows])
        after = np.where(touch, forces > 0.0, gaps + matrix @ forces < -1e-12)
        if (after == touch).all():
            return forces
        touch = after
    factor = np.linalg.cholesky(matrix)
    return cast(Array, nnls(factor.T, -np.linalg.solve(factor, gaps))[0])


def underside(at: Array, box: Array, turn: Array, half: Array) -> Array:
    """Return the height of a box's lower side above points on the ground, (n,); inf beside it.

    Args:
        at: points, (n, 2) [m]
        box: its middle, (3,) [m]
        turn: its axes as columns, (3, 3)
        half: half its edges, (3,) [m]
    """
    way = np.where(np.abs(turn[2]) < 1e-9, 1e-9, turn[2])
    middle = (box[2] * turn[2] - (at - box[:2]) @ turn[:2]) / way
    thick = half / np.abs(way)
    low, high = (middle - thick).max(axis=1), (middle + thick).min(axis=1)
    return np.where(low <= high, low, np.inf)


def _end(model: mujoco.MjModel, geom: int) -> Array:
    """Return a point near the outer end of a finger's box, in the finger's frame, (3,)."""
    turn, half = np.zeros(9), model.geom_size[geom]
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    longest = int(np.argmax(half))
    along = turn.reshape(3, 3)[:, longest]
    outwards = np.sign(along @ model.geom_pos[geom])
    return model.geom_pos[geom] + outwards * (half[longest] - END_M) * along


class Tools:
    """Fingers of a rig on one tissue; each touches one tissue at a time.

    Args:
        model, data: the physics
        jaws: fingers that can touch it
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, jaws: Sequence[JawFingers]
    ) -> None:
        self._model, self._data, self.jaws = model, data, tuple(jaws)
        self._geoms = [geom for jaw in jaws for geom in jaw.geoms]
        self._bodies = [body for jaw in jaws for body in jaw.bodies]
        self._half = model.geom_size[self._geoms]
        self._reach: list[float] = np.linalg.norm(self._half, axis=1).tolist()
        #: Near the end of each box that is away from the finger's axis, in the finger's frame.
        self._ends = [_end(model, geom) for geom in self._geoms]
        self.wrench = data.xfrc_applied
        #: Boxes that are near: their row.
        self.near: list[int] = []
        #: Force of all that press [N]; forces of the nodes that touch, (half, node): force.
        self.force, self.nodes = 0.0, dict[tuple[int, int], float]()

    def over(self, pose: Array, tissue: Tissue, highest: float) -> list[int]:
        """Return the fingers that may be in a tissue, or up to a height above it at rest.

        Args:
            pose: of the tissue in the world, (4, 4)
            tissue: its record
            highest: the height [m]
        """
        (x, y, z), found = pose[:3, 3].tolist(), list[int]()
        (a, b, c), (d, e, f), (g, h, i) = pose[:3, :3].tolist()
        along, across = 0.5 * tissue.length, 0.5 * tissue.gap + tissue.width
        boxes = self._data.geom_xpos[self._geoms].tolist()
        for row, ((u, v, w), reach) in enumerate(zip(boxes, self._reach, strict=True)):
            u, v, w = u - x, v - y, w - z
            if (
                c * u + f * v + i * w < highest + reach
                and abs(b * u + e * v + h * w) < across + reach
                and abs(a * u + d * v + g * w) < along + reach
            ):
                found.append(row)
        return found

    def look(
        self,
        pose: Array,
        surface: TissueSurface,
        displaced: Array,
        rows: Sequence[int],
        time: float,
    ) -> None:
        """Note which of some fingers may touch the surface, as it is now, within a time [s]."""
        self.near = []
        if not rows:
            return
        moving, risen = np.zeros(6), surface.rise @ displaced
        highest = float(risen.max())
        for row in rows:
            box, axes = self._box(pose, geom := self._geoms[row])
            if box[2] - np.abs(axes[2]) @ self._half[row] > highest + FASTEST_M_S * time:
                continue
            mujoco.mj_objectVelocity(self._model, self._data, GEOM, geom, moving, 0)
            near = NEAR_M + float(np.abs(moving[3:]).sum()) * time
            half = self._half[row] + near
            reach = np.abs(axes) @ half
            for side, (at, above) in enumerate(zip(surface.at, risen, strict=True)):
                under = surface.under(side, box, reach)
                if not len(under):
                    continue
                heights = above[under]
                if heights.max() < box[2] - reach[2]:
                    continue
                if (underside(at[under], box, axes, half) < heights).any():
                    self.near.append(row)
                    break

    def _box(self, pose: Array, geom: int) -> tuple[Array, Array]:
        """Return the middle of a finger's box, (3,), and its axes, (3, 3), in a tissue's frame."""
        data, turn = self._data, pose[:3, :3]
        box = (data.geom_xpos[geom] - pose[:3, 3]) @ turn
        return box, turn.T @ data.geom_xmat[geom].reshape(3, 3)

    def release(self) -> None:
        """Let nothing act on the fingers."""
        self.wrench[self._bodies] = 0.0
        self.force, self.nodes = 0.0, {}

    def apply(
        self, pose: Array, surface: TissueSurface, displaced: Array, stiffness: float
    ) -> Array:
        """Press fingers that are near; return the forces on the tissue's places, (k,).

        Args:
            pose: of the tissue in the world, (4, 4)
            surface: of it
            displaced: its places, (k,) [m]
            stiffness: factor on its moduli
        """
        turn = pose[:3, :3]
        places, self.force, self.nodes = np.zeros(len(displaced)), 0.0, {}
        boxes: list[tuple[int, Array, Array, Array]] = []
        for row in self.near:
            box, axes = self._box(pose, self._geoms[row])
            boxes.append((row, box, axes, np.abs(axes) @ self._half[row]))
        for half, (at, rise) in enumerate(zip(surface.at, surface.rise, strict=True)):
            found: list[tuple[Index, Array, Array, Array]] = []
            for row, box, axes, reach in boxes:
                under = surface.under(half, box, reach)
                heights = rise[under] @ displaced
                if heights.max(initial=-np.inf) <= box[2] - reach[2]:
                    continue
                low = underside(at[under], box, axes, self._half[row])
                inside = low < np.inf
                owner = np.full(np.count_nonzero(inside), row)
                found.append((under[inside], low[inside], low[inside] - heights[inside], owner))
            if not found:
                continue
            under, low, gaps, owner = found[0]
            if len(found) > 1:  # of the lowest box above each node
                under, low, gaps, owner = (
                    np.concatenate(parts) for parts in zip(*found, strict=True)
                )
                order = np.lexsort((low, under))
                under, first = np.unique(under[order], return_index=True)
                low, gaps, owner = (values[order][first] for values in (low, gaps, owner))
            if gaps.min(initial=0.0) >= 0.0:
                continue
            forces = press(surface.compliance[half][under[:, None], under] / stiffness, gaps)
            places -= forces @ rise[under]
            self.force += float(forces.sum())
            touched = forces > 0.0
            under, low, owner, forces = (
                under[touched],
                low[touched],
                owner[touched],
                forces[touched],
            )
            keys = [(half, node) for node in under.tolist()]
            self.nodes |= dict(zip(keys, forces.tolist(), strict=True))
            points = np.column_stack([at[under], low])
            for row in {int(k) for k in owner}:
                weights = np.where(owner == row, forces, 0.0)
                total = float(weights.sum())
                middle = pose[:3, 3] + turn @ (weights @ points / total)
                self.push(self._bodies[row], middle, total * turn[:, 2])
        return places

    def push(self, body: int, at: Array, force: Array) -> None:
        """Add a force at a point to what acts on a finger's body, in the world."""
        x, y, z = (at - self._data.xipos[body]).tolist()
        fx, fy, fz = force.tolist()
        self.wrench[body, :3] += force
        self.wrench[body, 3:] += (y * fz - z * fy, z * fx - x * fz, x * fy - y * fx)

    def forces(self) -> dict[str, Array]:
        """Return the force that acts on each jaw in the world, {arm: (3,)} [N]."""
        return {jaw.arm: self.wrench[list(jaw.bodies), :3].sum(axis=0) for jaw in self.jaws}

    def between(self, row: int) -> tuple[Array, float]:
        """Return the middle of the ends of a jaw's pads in the world, (3,), and their distance."""
        data = self._data
        one, two = (
            data.xpos[body] + data.xmat[body].reshape(3, 3) @ self._ends[2 * row + side]
            for side, body in enumerate(self.jaws[row].bodies)
        )
        return 0.5 * (one + two), float(np.linalg.norm(one - two))
