"""Masters: an orientation that the gimbal holds while the hand moves the rest of the arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import TrocarError
from trocar.kinematics.inverse_gimbal_arm import PLATFORM
from trocar.kinematics.structures import fit_chain
from trocar.simulation.controllers import CartesianForce, Law
from trocar.simulation.journal import command
from trocar.simulation.masters import (
    GIMBAL,
    GimbalLimits,
    OrientationLock,
    PlatformEffort,
    check_orientation,
)
from trocar.simulation.readings import Readings

Array = NDArray[np.float64]
STRUCTURE = "gimbal_arm"


class Locking(Readings):
    """The part of an arm that only masters have; `Arm` keeps the laws."""

    _laws: dict[str, Law]
    _lock: Array | None

    @property
    def orientation_locked(self) -> bool:
        """Whether the gimbal holds an orientation, or will under the next force command."""
        return self._lock is not None

    @command
    def lock_orientation(self, R: ArrayLike | None = None) -> bool:
        """Let the gimbal hold an orientation while the tip is under force control.

        It does so under `servo_cf` and `servo_ci`, at once or when one of them comes; the first
        three joints stay free. `unlock_orientation`, `free` and every other command end it.

        Args:
            R: (3, 3) or a quaternion wxyz, in the frame of `measured_cp`; as it is when omitted

        Returns:
            whether the command was accepted
        """
        if not self._verbs.ready("lock_orientation"):
            return False
        if self.description.inverse_kinematics != STRUCTURE:
            self._refuse("only masters can")
            return False
        try:
            wanted = self.measured_cp().T[:3, :3] if R is None else check_orientation(R)
        except TrocarError as problem:
            self._refuse(str(problem))
            return False
        self._lock = wanted.copy()
        if "wrench" in self._laws:
            self._begin_lock()
        self._verbs.tell("orientation_locked", locked=True)
        return True

    @command
    def unlock_orientation(self) -> bool:
        """Let the gimbal go; under force control it floats again."""
        if "lock" in self._laws:
            del self._laws["lock"]
            self._verbs.lend(list(range(GIMBAL.start, GIMBAL.stop)), self._own)
        self._forget_lock()
        return True

    # ------------------------------------------------------------------ inside

    def _begin_master_laws(self, law: Law) -> None:
        """Let a master's platform give way and its gimbal be locked under force control.

        Under a wrench in the reference frame the platform stays, as on the dVRK.
        """
        if self.description.inverse_kinematics != STRUCTURE:
            return
        self._laws.pop("platform", None)
        if not (isinstance(law, CartesianForce) and law.frame == "spatial"):
            platform = self.description.joints[PLATFORM]
            self._laws["platform"] = PlatformEffort(platform.lower, platform.upper)
        if self._lock is not None and "lock" not in self._laws:
            self._begin_lock()

    def _begin_lock(self) -> None:
        if self._lock is None:
            return
        if "lock" not in self._laws:
            self._verbs.take(list(range(GIMBAL.start, GIMBAL.stop)), self._own)
        joints = self.description.joints[self._own]
        limits = GimbalLimits(
            np.array([j.lower for j in joints]),
            np.array([j.upper for j in joints]),
            np.array([j.velocity_max for j in joints]),
        )
        self._laws["lock"] = OrientationLock(
            fit_chain(self.description.mechanism, STRUCTURE),
            self.base_frame()[0][:3, :3].T @ self._lock,
            self.positions()[self._own],
            limits,
            lambda: self._clock.time,
        )

    def _forget_lock(self) -> None:
        if self._lock is not None:
            self._lock = None
            self._verbs.tell("orientation_locked", locked=False)

    def _refuse(self, why: str) -> None:
        self._verbs.refusals.warn("lock_orientation", f"lock_orientation: {why}")
