"""Arms that follow poses in small steps, a thousand times a second: slaves, and carried masters.

The surgeon's axes are x left, y up, z away from the eyes, as on the stereo display. Joints are
commanded velocities, too, or they would lag behind by their damping.
"""

from __future__ import annotations

from math import radians
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry.rotations import (
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    rotation_z,
)
from trocar.geometry.se3 import inverse, transform

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]

#: The surgeon's axes in those of an image (x right, y down): both of the screen's are turned round.
R_IMAGE_VIEW = rotation_z(np.pi)
#: The view without an endoscope: of an operator before the robot who looks across it at the table,
#: against the world's y. Source: our own choice, as the surgeon at full_cart_mtm's console does.
R_WORLD_VIEW = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
#: A solution that is farther from the set-points is on another branch. Source: our own choice.
#: [rad or m]
FAR = 0.3
#: A tip that is held back by more is not pushed on. Source: our own choice; joints that lag far
#: behind would end in FAULT. [m]
LEASH_M = 0.01


def view_in_world(world: World) -> Array:
    """Return the surgeon's frame, T_world_view (4, 4).

    That of the rig's endoscope, bent ones included; else of an ECM's scope; else of the room.
    """
    for camera in world.rig.cameras:
        if camera.kind == "endoscope":
            seen = world.cameras()[camera.name].T_world_camera
            return seen @ transform(R_IMAGE_VIEW, np.zeros(3))
    for name, arm in world.arms.items():
        if arm.description.type == "ECM":
            return world.reference_pose(name) @ arm.local.measured_cp().matrix
    return transform(R_WORLD_VIEW, np.zeros(3))


def base_in_view(world: World, arm: str) -> Array:
    """Return an arm's own reference frame in the surgeon's frame now, (4, 4)."""
    return inverse(view_in_world(world)) @ world.reference_pose(arm)


class Slave:
    """Lead a tool's tip.

    Args:
        world: the arm's
        name: of a PSM, or of a master that a hand carries
        T_view_base: the arm's own reference frame in the surgeon's, (4, 4)

    Attributes:
        name: as given
        T_base_view: the surgeon's frame in the arm's own, (4, 4)
    """

    def __init__(self, world: World, name: str, T_view_base: Array) -> None:
        self.name = name
        self._world, self._arm = world, world.arm(name)
        self._T_view_base, self.T_base_view = T_view_base, inverse(T_view_base)
        self._own = self._arm.description.own_joints
        whole = self._arm.joints.setpoints()
        self._commanded, self._rest = whole[: self._own], whole[self._own :]

    @property
    def T(self) -> Array:
        """The commanded pose of the tip as the surgeon sees it, (4, 4)."""
        return self._T_view_base @ self._tip(self._commanded)

    @property
    def measured(self) -> Array:
        """The measured pose of the tip as the surgeon sees it, (4, 4)."""
        return self._T_view_base @ self._world.frames.measured(self.name)

    def follow(self, T: Array, period_s: float) -> str:
        """Bring the tip to a pose as the surgeon sees it, (4, 4), within a period [s].

        Returns:
            why it stays where it is, "" when it follows
        """
        goal, joints = self.T_base_view @ T, self._arm.joints
        try:
            q = self._solve(goal)
            inside = np.clip(q, joints.lower[: self._own], joints.upper[: self._own])
            reason = self._objection(inside, goal)
        except TrocarError as problem:
            q = inside = self._commanded
            reason = str(problem)
        if reason:
            self._arm.servo_jp(self._commanded)
            return reason
        speed = (inside - self._commanded) / period_s
        self._commanded = inside
        self._arm.servo_jp(inside, speed)
        beyond = np.flatnonzero(inside != q)
        return f"{joints.names[beyond[0]]} is at its limit" if beyond.size else ""

    def _solve(self, goal: Array) -> Array:
        """Return the joints that bring the tip to a pose in the arm's own base, (n,).

        Those of a tool are the robot's, which go on beyond the limits.
        """
        if self._own <= 6:
            return self._arm.inverse_kinematics(goal, self._commanded)
        return self._arm.local.inverse_kinematics(goal, self._commanded)

    def _objection(self, inside: Array, goal: Array) -> str:
        """Return the reason that joint positions must not be commanded, "" when they may."""
        if np.abs(inside - self._commanded).max() > FAR:
            return "the joints would jump to another branch"
        here = self._world.frames.measured(self._arm.name)[:3, 3]
        lag, way = here - self._tip(self._commanded)[:3, 3], here - goal[:3, 3]
        return "something is in its way" if LEASH_M**2 < lag @ lag < way @ way else ""

    def _tip(self, q: Array) -> Array:
        return self._world.frames.local_at(self._arm.name, np.concatenate([q, self._rest]))


#: Fastest that a hand carries a master. Source: our own choice: hands are slower. [m/s, rad/s]
SPEED, TURN = 0.5, radians(180.0)
#: A hand comes up to its goal as slowly as this makes it. Source: our own choice. [s]
SOFT_S = 0.06


class HandleMover:
    """Carry a master's handle towards a goal; in the loop's thread.

    Args:
        world: the master is an arm of its rig
        name: of the arm
    """

    def __init__(self, world: World, name: str) -> None:
        self._world, self._name = world, name
        self._goal: Array | None = None
        self._hand: Slave | None = None

    @property
    def busy(self) -> bool:
        """Whether a hand has hold of it."""
        return self._goal is not None

    def carry(self, T: Array) -> None:
        """Bring the handle to a pose in the world, (4, 4), as fast as a hand does."""
        self._goal = T
        if self._hand is None:
            arm = self._world.arm(self._name)
            arm.hold()  # its set-points are then where it is
            self._hand = Slave(self._world, self._name, self._world.reference_pose(self._name))

    def let_go(self) -> None:
        """Take the hand away; the master stays where it is."""
        if self._hand is not None:
            self._world.arm(self._name).hold()
        self._goal = self._hand = None

    def tick(self, period_s: float) -> None:
        """Go on by a period [s]."""
        if self._goal is None or self._hand is None:
            return
        here = self._hand.T
        way = self._goal[:3, 3] - here[:3, 3]
        turn = rotation_vector_from_matrix(self._goal[:3, :3] @ here[:3, :3].T)
        p = here[:3, 3] + _part(way, SPEED, period_s)
        R = matrix_from_rotation_vector(_part(turn, TURN, period_s)) @ here[:3, :3]
        self._hand.follow(transform(R, p), period_s)


def _part(way: Array, fastest: float, period_s: float) -> Array:
    """Return the part of a way for one period: softly at its end, not faster than allowed."""
    length = float(np.linalg.norm(way))
    if length == 0.0:
        return way
    step = min(length / SOFT_S, fastest) * period_s
    return way * min(step / length, 1.0)
