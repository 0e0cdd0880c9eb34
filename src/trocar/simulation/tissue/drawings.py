"""Drawings of soft tissue: the surface of the whole mesh, and a thread that hangs and slides.

Both follow the physics and never act on it, and cost nothing until a snapshot is taken. The thread
stays outside of all boxes and capsules that touch anything, jaws and needle among them, and above
the tissue's surface as it is now.
"""

from __future__ import annotations

from typing import NamedTuple, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.simulation.records import DrawnCurve, DrawnSurface
from trocar.simulation.tissue.tissues import SoftTissue

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Colours of a wound's walls and of a thread. Source: our own choice, after photographs.
WALL, THREAD = (0.62, 0.16, 0.15, 1.0), (0.20, 0.12, 0.52, 1.0)
#: Points of a drawn thread. Source: our own choice, about 1 mm each.
POINTS = 72
#: Time step of a thread's motion, sweeps of its constraints in each, and share of speed that stays.
#: Source: our own choice: it then settles within half a second. [s]
STEP_S, SWEEPS, STAYS = 0.005, 12, 0.96
#: A thread's motion catches up with so much time at most; longer ago it begins anew. Source: our
#: own choice. [s]
LONGEST_S = 0.1
#: Three points in a row straighten by this share each sweep. Source: our own choice.
STIFF = 0.15
GRAVITY = np.array([0.0, 0.0, -9.81])
#: Every so many sweeps it is brought out of solids and tissue, after the last one too.
#: Source: our own choice.
OUTSIDE = 4
#: Shapes this near to a thread are looked at until it is drawn again, and of these so near to a
#: point in a time step. Source: our own choice. [m]
NEAR_M, NEXT_M = 0.01, 0.002
#: Shapes that a thread stays outside of; capsules and spheres are rounded boxes without width.
ROUNDED = {
    int(mujoco.mjtGeom.mjGEOM_BOX): (1.0, 1.0, 1.0, 0.0),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): (0.0, 0.0, 1.0, 1.0),
    int(mujoco.mjtGeom.mjGEOM_SPHERE): (0.0, 0.0, 0.0, 1.0),
}


class Solids(NamedTuple):
    """Boxes with rounded edges where they are now, each (n, ...).

    Attributes:
        at, turn: of each in the world (n, 3), (n, 3, 3) [m]
        half: half edges of the box that is rounded (n, 3) [m]
        round: by which [m]
    """

    at: Array
    turn: Array
    half: Array
    round: Array

    def pairs(self, points: Array, reach: float) -> tuple[Index, Index]:
        """Return pairs of points and solids within about a reach [m]: rows of both, (n,) each."""
        local = np.abs((points - self.at[:, None]) @ self.turn)
        away = (local - self.half[:, None]).max(axis=2) - self.round[:, None]
        solids, near = np.nonzero(away < reach)
        return solids, near

    def ways_out(
        self, points: Array, radius: float, pairs: tuple[Index, Index]
    ) -> tuple[Array, Array]:
        """Return the depths of balls in the solids, and the shortest ways out.

        Args:
            points: middles of the balls, (k, 3) [m]
            radius: of the balls [m]
            pairs: of solids and points that may be deep

        Returns:
            depth in the solid that each is deepest in, below 0 outside (k,) [m]; the way out (k, 3)
        """
        solids, rows = pairs
        turn, half = self.turn[solids], self.half[solids]
        local = np.einsum("ni,nij->nj", points[rows] - self.at[solids], turn)
        beyond = local - np.clip(local, -half, half)
        away = np.sqrt(np.einsum("ni,ni->n", beyond, beyond))
        faces = np.abs(local) - half
        inward = faces.max(axis=1)  # to the nearest face, below 0 inside
        facing = faces == inward[:, None]
        out = np.where(
            (inward < 0.0)[:, None],
            cast(Array, facing * np.where(local < 0.0, -1.0, 1.0)),
            cast(Array, beyond / np.maximum(away, 1e-12)[:, None]),
        )
        to_face = cast(Array, np.where(inward < 0.0, inward, away))
        deep = self.round[solids] + radius - to_face
        order = deep.argsort(kind="stable")  # of several solids the deepest one counts
        depth, ways = np.full(len(points), -np.inf), np.zeros((len(points), 3))
        depth[rows[order]] = deep[order]
        steps = np.maximum(deep, 0.0)[:, None] * np.einsum("nij,nj->ni", turn, out)
        ways[rows[order]] = steps[order]
        return depth, ways


class TissueDrawings:
    """The drawings of one tissue.

    Args:
        tissue: that is drawn
        model, data: the physics that it is in, with the shapes that its thread lies on
    """

    def __init__(self, tissue: SoftTissue, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._tissue, self._data = tissue, data
        touching = model.geom_conaffinity > 0  # plates of a tissue have none
        kinds = np.isin(model.geom_type, list(ROUNDED))
        self._geoms = np.flatnonzero(touching & kinds)
        sizes = model.geom_size[self._geoms]
        shares = np.array([ROUNDED[int(kind)] for kind in model.geom_type[self._geoms]])
        shares = shares.reshape(-1, 4)
        self._round = sizes[:, 0] * shares[:, 3]
        #: Capsules have their half length second.
        long = cast(Array, np.where(shares[:, 3] > 0.0, sizes[:, 1], sizes[:, 2]))
        self._half: Array = np.column_stack([sizes[:, :2], long]) * shares[:, :3]
        #: Nodes of the upper surface.
        self._top = np.flatnonzero(np.isclose(tissue.pad.nodes[:, 2], 0.0))
        self._parts: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] | None = None
        self._time = -np.inf
        self._points = self._before = np.zeros((POINTS, 3))

    def skin(self) -> DrawnSurface:
        """Return the surface without the wound's walls."""
        return self._surface("skin")

    def wound(self) -> DrawnSurface:
        """Return the walls of the wound."""
        return self._surface("wound")

    def _surface(self, part: str) -> DrawnSurface:
        if self._parts is None:
            self._parts = self._split()
        nodes, faces = self._parts[part]
        tissue = self._tissue
        rest = tissue.pad.nodes[nodes]
        here = rest + tissue.displacements()[nodes]
        at = here @ tissue.pose[:3, :3].T + tissue.pose[:3, 3]
        look = MATERIALS[tissue.tissue.material]
        rgba = look.rgba if part == "skin" else WALL
        name = f"{tissue.name}_{part}"
        return DrawnSurface(name, at, faces, rgba, look.gloss, 0.0, "tissue", rest)

    def _split(self) -> dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """Return nodes and triangles of both parts; edges are sharp, their nodes doubled."""
        pad = self._tissue.pad
        nodes, faces = pad.surface()
        corners = nodes[faces]
        at = pad.nodes[corners]
        normal = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
        facing = np.abs(normal).argmax(axis=1)
        side = 2 * facing + (np.take_along_axis(normal, facing[:, None], axis=1)[:, 0] > 0.0)
        wall = (facing == 1) & (np.abs(at[:, 0, 1]) < 0.5 * self._tissue.tissue.gap + 1e-9)
        found: dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
        for part, mine in (("wound", wall), ("skin", ~wall)):
            keys = corners[mine] * 6 + side[mine, None]
            unique, index = np.unique(keys, return_inverse=True)
            found[part] = unique // 6, index.reshape(-1, 3)
        return found

    def thread(self) -> DrawnCurve:
        """Return the thread from the needle to its end."""
        tissue = self._tissue
        time = tissue.time
        self._surface_now = tissue.pad.nodes[self._top] + tissue.displacements()[self._top]
        if not 0.0 <= time - self._time <= LONGEST_S:
            self._lay()
        else:
            self._solids = self._near()
            for _ in range(round((time - self._time) / STEP_S)):
                self._move(STEP_S)
            self._settle()
        self._time = time
        return DrawnCurve(
            f"{tissue.name}_thread", self._points.copy(), tissue.tissue.thread.radius, THREAD, 0.4
        )

    def _near(self) -> Solids:
        """Return the shapes near the thread, where they are now."""
        data = self._data
        at, turn = data.geom_xpos[self._geoms], data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        local = np.abs((self._points - at[:, None]) @ turn) - self._half[:, None]
        away = np.linalg.norm(np.maximum(local, 0.0), axis=2).min(axis=1)
        rows = away < self._round + NEAR_M
        return Solids(at[rows], turn[rows], self._half[rows], self._round[rows])

    # ------------------------------------------------------------------ a thread that hangs

    def _lay(self) -> None:
        """Lay the thread anew, and let it settle."""
        length = self._tissue.tissue.thread.length
        index, held, _ = self._held()
        reach = np.linspace(0.0, length, POINTS)
        at, last = held[0], held[-1]
        away = held[1] - at if len(held) > 1 and index[1] == 1 else np.array([0.0, 0.0, -1e-3])
        away = away / max(float(np.linalg.norm(away)), 1e-9)
        tail = at + reach[:, None] * away
        for axis in range(3):
            tail[:, axis] = np.where(
                np.arange(POINTS) > index[-1],
                last[axis] + (reach - reach[index[-1]]) * away[axis],
                np.interp(np.arange(POINTS), index, held[:, axis]),
            )
        tail[:, 0] += 1e-4 * np.sin(40.0 * reach / length)
        self._points = tail
        self._before = tail.copy()
        self._solids = self._near()
        for _ in range(40):
            self._move(STEP_S)
        self._settle()

    def _held(self) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
        """Return the held points with their places, and the points in tissue, (POINTS,).

        Held are the needle's end, then channel points.
        """
        tissue = self._tissue
        swage, back, eyes, fed = tissue.threaded()
        spacing = tissue.tissue.thread.length / (POINTS - 1)
        index, held = [0, 1], [swage, swage + spacing * back]
        within = np.zeros(POINTS, dtype=bool)
        if len(eyes):
            stitches = np.nonzero(tissue.left)[0][::-1]
            apart = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
            # thread up to the first puncture, less what lies in the tissue
            reach = max(fed - float(apart.sum()), float(np.linalg.norm(eyes[0] - swage)))
            for k, eye in enumerate(eyes):
                reach += apart[k - 1] if k else 0.0
                number = min(max(round(reach / spacing), index[-1] + 1), POINTS - 2)
                # the needle's end is in tissue until it has left a stitch
                one = stitches[k - 1] == stitches[k] if k else not tissue.left[stitches[0]].all()
                within[index[-1] + 1 if k else 0 : number] = one
                if number > index[-1]:
                    index.append(number)
                    held.append(eye)
        within[index] = True
        return np.array(index), np.array(held), within

    def _move(self, time: float) -> None:
        """Move the thread for a time step: position based dynamics."""
        tissue = self._tissue
        spacing = tissue.tissue.thread.length / (POINTS - 1)
        index, held, within = self._held()
        now = self._points
        speed = STAYS * (now - self._before)
        fastest = 0.3 * spacing
        speed *= np.minimum(1.0, fastest / np.maximum(np.linalg.norm(speed, axis=1), 1e-12))[
            :, None
        ]
        ahead = now + speed + GRAVITY * time**2
        free = np.ones(POINTS)
        free[index] = 0.0
        pairs = self._solids.pairs(_with_middles(ahead), NEXT_M)
        for sweep in range(SWEEPS):
            ahead[index] = held
            middle = 0.5 * (ahead[:-2] + ahead[2:]) - ahead[1:-1]
            ahead[1:-1] += STIFF * free[1:-1, None] * middle
            for first in (0, 1):
                one, two = ahead[first:-1:2], ahead[first + 1 :: 2]
                way = two - one
                long = np.linalg.norm(way, axis=1)
                share = free[first:-1:2] + free[first + 1 :: 2]
                excess = (long - spacing) / np.maximum(long * share, 1e-12)
                excess[share == 0.0] = 0.0
                step = excess[:, None] * way
                one += free[first:-1:2, None] * step
                two -= free[first + 1 :: 2, None] * step
            if (sweep + 1) % OUTSIDE == 0:
                self._keep_out(ahead, ~within, pairs)
        ahead[index] = held
        self._before, self._points = now, ahead

    def _keep_out(self, points: Array, free: NDArray[np.bool_], pairs: tuple[Index, Index]) -> None:
        """Bring free points, and what is between two of them, out of solids and tissue."""
        radius = self._tissue.tissue.thread.radius
        deep, ways = self._solids.ways_out(_with_middles(points), radius, pairs)
        own = ways[:POINTS]
        own[~free] = 0.0
        points += own
        between = np.flatnonzero(
            (deep[POINTS:] > 0.0) & (deep[: POINTS - 1] <= 0.0) & (deep[1:POINTS] <= 0.0)
        )
        for k in between:
            points[k : k + 2] += free[k : k + 2, None] * ways[POINTS + k]
        points[free] += self._ways_up(points[free])

    def _ways_up(self, points: Array) -> Array:
        """Return the ways from points in the tissue to its surface as it is now, (n, 3) [m]."""
        tissue = self._tissue
        pose, size, top = tissue.pose, tissue.tissue, self._surface_now
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        least = np.full(len(points), -np.inf)
        over = np.flatnonzero(
            (np.abs(local[:, 0]) < 0.5 * size.length)
            & (np.abs(local[:, 1]) < 0.5 * size.gap + size.width)
            & (local[:, 2] < top[:, 2].max() + size.thread.radius)
        )
        if len(over):
            apart = local[over, None, :2] - top[:, :2]
            nearest = np.einsum("knj,knj->kn", apart, apart).argmin(axis=1)
            least[over] = top[nearest, 2] + size.thread.radius
        return np.maximum(least - local[:, 2], 0.0)[:, None] * pose[:3, 2]

    def _settle(self) -> None:
        """Bring points out that are between solids, as shut jaws, by the shortest way that is free.

        The shortest way out of one solid leads into the other there.
        """
        radius = self._tissue.tissue.thread.radius
        solids, free = self._solids, ~self._held()[2]
        pairs = solids.pairs(self._points, 0.0)
        for k in np.flatnonzero((solids.ways_out(self._points, 0.0, pairs)[0] > 0.0) & free):
            point = self._points[k]
            local = np.einsum("ni,nij->nj", point - solids.at, solids.turn)
            reach = solids.half + (solids.round + 1.001 * radius)[:, None]
            steps = np.concatenate([reach - local, -reach - local], axis=1)  # to all faces
            axes = np.concatenate([np.swapaxes(solids.turn, 1, 2)] * 2, axis=1)
            exits = (steps[..., None] * axes).reshape(-1, 3)
            exits = point + exits[(np.abs(local) < reach).all(axis=1).repeat(6)]
            exits += self._ways_up(exits)
            deep = solids.ways_out(exits, 0.0, solids.pairs(exits, 0.0))[0]
            far = np.linalg.norm(exits - point, axis=1)
            best = int(np.lexsort((far, np.maximum(deep, 0.0)))[0])
            self._points[k] = self._before[k] = exits[best]


def _with_middles(points: Array) -> Array:
    """Return points, then those halfway from one to the next."""
    return np.concatenate([points, 0.5 * (points[1:] + points[:-1])])
