"""What of soft tissue is seen: its surface from the whole mesh, and a thread that hangs and slides.

Both follow the physics and never act on it, and cost nothing while nobody looks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.records import RigDescription
from trocar.simulation.records import DrawnCurve, DrawnSurface
from trocar.simulation.tissues import SoftTissue

Array = NDArray[np.float64]

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


class TissueDrawings:
    """The drawings of one tissue.

    Args:
        tissue: that is drawn
        rig: whose needle lies where it begins on what thread lies on beside the tissue
    """

    def __init__(self, tissue: SoftTissue, rig: RigDescription) -> None:
        self._tissue = tissue
        needle = next(prop for prop in rig.props if prop.name == tissue.tissue.needle)
        #: Height on which thread lies, in the world [m].
        self._floor = float(needle.pose[2, 3]) - 0.5 * tissue.tissue.wire.wire
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
        if not 0.0 <= time - self._time <= LONGEST_S:
            self._lay()
        else:
            for _ in range(round((time - self._time) / STEP_S)):
                self._move(STEP_S)
        self._time = time
        return DrawnCurve(
            f"{tissue.name}_thread", self._points.copy(), tissue.tissue.thread.radius, THREAD, 0.4
        )

    # ------------------------------------------------------------------ a thread that hangs

    def _lay(self) -> None:
        """Lay the thread anew, and let it settle."""
        length = self._tissue.tissue.thread.length
        index, held = self._held()
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
        for _ in range(40):
            self._move(STEP_S)

    def _held(self) -> tuple[NDArray[np.int64], Array]:
        """Return which points of the thread are held, and where: the needle's end, then tissue."""
        tissue = self._tissue
        swage, back, eyes, fed = tissue.threaded()
        spacing = tissue.tissue.thread.length / (POINTS - 1)
        index, held = [0, 1], [swage, swage + spacing * back]
        if len(eyes):
            apart = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
            # thread up to the first puncture, less what lies in the tissue
            reach = max(fed - float(apart.sum()), float(np.linalg.norm(eyes[0] - swage)))
            for k, eye in enumerate(eyes):
                reach += apart[k - 1] if k else 0.0
                number = min(max(round(reach / spacing), index[-1] + 1), POINTS - 2)
                if number > index[-1]:
                    index.append(number)
                    held.append(eye)
        return np.array(index), np.array(held)

    def _move(self, time: float) -> None:
        """Move the thread for a time step: position based dynamics."""
        tissue = self._tissue
        spacing = tissue.tissue.thread.length / (POINTS - 1)
        index, held = self._held()
        now = self._points
        speed = STAYS * (now - self._before)
        fastest = 0.3 * spacing
        speed *= np.minimum(1.0, fastest / np.maximum(np.linalg.norm(speed, axis=1), 1e-12))[
            :, None
        ]
        ahead = now + speed + GRAVITY * time**2
        free = np.ones(POINTS)
        free[index] = 0.0
        for _ in range(SWEEPS):
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
            self._rest_on(ahead, free)
        ahead[index] = held
        self._before, self._points = now, ahead

    def _rest_on(self, points: Array, free: Array) -> None:
        """Keep free points above the tissue and the floor."""
        tissue = self._tissue
        pose, size = tissue.pose, tissue.tissue
        radius = size.thread.radius
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        above = (np.abs(local[:, 0]) < 0.5 * size.length) & (
            np.abs(local[:, 1]) < 0.5 * size.gap + size.width
        )
        least = np.where(above, pose[2, 3], self._floor) + radius
        points[:, 2] = np.where((free > 0.0) & (points[:, 2] < least), least, points[:, 2])
