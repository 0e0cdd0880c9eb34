"""Thread that jaws can grasp: laying it along a curve, where it is, its tension, and its looks."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.records import Prop
from trocar.descriptions.threads import ChainThread
from trocar.errors import InputError
from trocar.geometry.rotations import rotation_y, rotation_z
from trocar.geometry.se3 import transform
from trocar.modeling.threads import BEND_RAD, bodies_of
from trocar.simulation.parts import Attached, Part
from trocar.simulation.records import DrawnCurve

Array = NDArray[np.float64]

#: Largest speeds of links [rad/s] and of the first link's end [m/s]. An arm that is put into thread
#: in no time (a reset, a tool, mode "set") would otherwise make the simulation diverge. Source: our
#: own choice; jaws that pull knots shut turn links at 108 rad/s (measured).
TURN_RAD_S, MOVE_M_S = 1000.0, 20.0
#: Points of the drawn curve for each link. Source: our own choice.
POINTS = 4


class ThreadProp(Part):
    """A prop that is a thread.

    Args:
        prop: its description
        thread: its record

    Attributes:
        name, thread: as described
    """

    every = 1

    def __init__(self, prop: Prop, thread: ChainThread) -> None:
        self.name, self.thread, self._names = prop.name, thread, bodies_of(prop)

    def attach(self, physics: Attached) -> None:
        """Take the physics that it is in."""
        model = physics.model
        self._model, self._data = model, physics.data
        self._bodies = [model.body(name).id for name in self._names]
        self._tree = int(model.body_treeid[self._bodies[0]])
        self._dofs = np.flatnonzero(model.dof_treeid == self._tree)
        self._fastest = np.full(len(self._dofs), TURN_RAD_S)
        self._fastest[:3] = MOVE_M_S

    def look(self) -> None:
        """Limit the speeds of links to `TURN_RAD_S` and `MOVE_M_S`."""
        speed = self._data.qvel[self._dofs]
        if (np.abs(speed) > self._fastest).any():
            self._data.qvel[self._dofs] = np.clip(speed, -self._fastest, self._fastest)

    def points(self) -> Array:
        """Return the ends of its links in the world, from its beginning on, (links + 1, 3) [m]."""
        data = self._data
        mujoco.mj_kinematics(self._model, data)
        starts = data.xpos[self._bodies]
        last = self._bodies[-1]
        end = data.xpos[last] + self.thread.link * data.xmat[last].reshape(3, 3)[:, 0]
        return np.concatenate([starts, end[None]])

    def tension(self) -> Array:
        """Return the tension where each link but the first one begins, (links - 1,) [N].

        As of the last step; below 0 where the thread is pushed together.
        """
        model, data = self._model, self._data
        kept = data.qacc[self._dofs]
        if data.tree_asleep[self._tree] >= 0:  # what sleeps has the acceleration of a free fall
            data.qacc[self._dofs] = 0.0
        mujoco.mj_rnePostConstraint(model, data)
        data.qacc[self._dofs] = kept
        along = data.xmat[self._bodies[1:]].reshape(-1, 3, 3)[:, :, 0]
        return -np.einsum("ni,ni->n", data.cfrc_int[self._bodies[1:], 3:], along)

    def curve(self) -> DrawnCurve:
        """Return it as a smooth curve through the ends of its links."""
        at = self.points()
        whole = np.concatenate([2.0 * at[:1] - at[1:2], at, 2.0 * at[-1:] - at[-2:-1]])
        before, here, there, after = (whole[k : len(whole) - 3 + k, None] for k in range(4))
        s = (np.arange(POINTS) / POINTS)[:, None]
        spans = 0.5 * (
            2.0 * here
            + (there - before) * s
            + (2.0 * before - 5.0 * here + 4.0 * there - after) * s**2
            + (3.0 * here - before - 3.0 * there + after) * s**3
        )
        points = np.concatenate([spans.reshape(-1, 3), at[-1:]])
        look = MATERIALS[self.thread.material]
        return DrawnCurve(self.name, points, 0.5 * self.thread.diameter, look.rgba, look.gloss)


def laid(name: str, thread: ChainThread, curve: Array) -> tuple[Array, Array]:
    """Return the pose of a thread's beginning and its bends, along a curve through points.

    Args:
        name: of the thread
        thread: its record
        curve: points on a polyline in the world, (n, 3) [m]

    Returns:
        (4, 4); angles of its hinges, (2 (links - 1),) [rad]

    Raises:
        InputError: a curve shorter than the thread, or bent more than its joints
    """
    ends, row = [curve[0]], 0
    while len(ends) <= thread.links:
        here = ends[-1]
        while np.linalg.norm(curve[row + 1] - here) < thread.link:  # where it leaves a ball
            row += 1
            if row + 1 == len(curve):
                reached = 1e3 * thread.link * (len(ends) - 1)
                raise InputError(
                    f"{name}: got points for {reached:.1f} mm of thread; needed:"
                    f" {1e3 * thread.length:.1f} mm"
                )
        way, off = curve[row + 1] - curve[row], curve[row] - here
        a, b, c = way @ way, off @ way, off @ off - thread.link**2
        ends.append(curve[row] + (np.sqrt(b * b - a * c) - b) / a * way)
    ways = np.diff(ends, axis=0) / thread.link
    side = np.cross(ways[0], np.eye(3)[int(np.argmin(np.abs(ways[0])))])
    side /= np.linalg.norm(side)
    turn = np.column_stack([ways[0], np.cross(side, ways[0]), side])
    start, bends = transform(turn, ends[0]), np.zeros((thread.links - 1, 2))
    for number, way in enumerate(ways[1:]):
        x, y, z = (turn.T @ way).tolist()
        bends[number] = up, across = np.arctan2(-z, x), np.arcsin(min(max(y, -1.0), 1.0))
        turn = turn @ rotation_y(up) @ rotation_z(across)
    if np.abs(bends).max(initial=0.0) > BEND_RAD:
        raise InputError(
            f"{name}: got points at which links bend by {np.abs(bends).max():.2f} rad; allowed: up"
            f" to {BEND_RAD:g} rad"
        )
    return start, bends.ravel()
