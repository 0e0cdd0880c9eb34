"""A master that is an arm of the rig: a simulated MTM."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.apps.teleoperation.reading import Reading
from trocar.apps.teleoperation.ready import ask_to_be_ready, why_arm_not_ready
from trocar.errors import SingularError, UnreachableError
from trocar.geometry.rotations import angle_between
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import inverse_kinematics

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]

#: The goal is renewed where the slave turned by more. Source: our own choice (the dVRK renews it
#: each 10 ms). [rad]
TURNED = np.deg2rad(0.2)
#: A gimbal that came to rest beside its goal, held back by friction, is told to go on by as much
#: as it lacks, so often. Source: our own choice. [s]
NUDGE_S = 0.1
#: What it lacks is then less than this. Source: our own choice. [rad]
CLOSE = np.deg2rad(0.5)
#: Most that a joint is told beyond its goal. Source: our own choice. [rad]
BEYOND = np.deg2rad(15.0)


class ArmMaster:
    """An MTM of the rig.

    Args:
        name: of the arm
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._base: Array | None = None
        self._wanted: Array | None = None
        self._goal: Array | None = None
        self._extra = np.zeros(0)
        self._place: Array | None = None
        self._nudged = 0.0

    def why_not_ready(self, world: World) -> str:
        """Return what keeps the arm from being used, "" when nothing does."""
        return why_arm_not_ready(world.arm(self.name))

    def get_ready(self, world: World) -> None:
        """Enable and home the arm where it needs it."""
        self._base = self._wanted = self._place = None
        ask_to_be_ready(world.arm(self.name))

    def read(self, world: World) -> Reading:
        """Return where the handle is measured, and its gripper."""
        arm = world.arm(self.name)
        if self._base is None:
            self._base = arm.base_frame()[0]
        q = arm.readings()[0]
        opening = float(q[-1]) if arm.description.has_gripper else None
        T = self._base @ chain_pose(arm.description.mechanism)(q)
        return Reading(T, opening, turning=arm.busy)

    def align(self, world: World, R: Array) -> str:
        """Turn the gimbal; the handle stays in its place."""
        arm, here = world.arm(self.name), self.read(world).T
        if self._wanted is None or angle_between(self._wanted, R) > TURNED:
            why = self._begin(arm, here, R)
            if why:
                return why
        elif not arm.busy and world.time - self._nudged > NUDGE_S:
            self._nudge(arm, here, R, world.time)
        return ""

    def meet(self, gripper: float) -> None:
        """Do nothing: fingers hold the gripper, and the jaw comes to them."""

    def give_way(self) -> None:
        """Do nothing: the hand is where it is."""

    def let_go(self, world: World, *, locked: bool) -> None:
        """Exert nothing but what carries the links; locked: the gimbal holds its orientation.

        The dVRK asks for a wrench of zero in both cases. `free` is that without the platform's
        null space, which has no hand to give way to here, at a tenth of the cost.
        """
        arm = world.arm(self.name)
        self._wanted = self._place = None
        arm.use_gravity_compensation(True)
        if locked:
            arm.servo_cf(np.zeros(6))
            arm.lock_orientation()
        else:
            arm.free()

    def hold(self, world: World) -> None:
        """Stay where it is."""
        self._wanted = self._place = None
        arm = world.arm(self.name)
        if not why_arm_not_ready(arm):
            arm.hold()

    def _begin(self, arm: Arm, here: Array, R: Array) -> str:
        """Move to the joint positions with the orientation that are nearest to those now."""
        mechanism = arm.description.mechanism
        if self._place is None:
            self._place = here[:3, 3].copy()
        base = self._base if self._base is not None else np.eye(4)
        wanted = inverse(base) @ transform(R, self._place)
        now = arm.readings()[0]
        try:
            found = inverse_kinematics(mechanism, "gimbal_arm", wanted, now[:7])
        except (UnreachableError, SingularError) as problem:
            return str(problem)
        goal = self._goal = found[0]
        self._wanted, self._extra = R.copy(), np.zeros(len(goal))
        arm.move_jp(goal)
        return ""

    def _nudge(self, arm: Arm, here: Array, R: Array, time: float) -> None:
        self._nudged = time
        if self._goal is None or angle_between(here[:3, :3], R) < CLOSE:
            return
        own = slice(0, len(self._goal))
        lacks = self._goal - arm.readings()[0][own]
        self._extra = np.clip(self._extra + lacks, -BEYOND, BEYOND)
        arm.move_jp(np.clip(self._goal + self._extra, arm.lower[own], arm.upper[own]))
