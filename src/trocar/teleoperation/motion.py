"""The motion of masters in a recording, and a player that carries simulated masters by it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.geometry.se3 import transform
from trocar.kinematics.chain_pose import chain_pose
from trocar.recording import open_recording
from trocar.teleoperation.component import ALIGNING

if TYPE_CHECKING:
    from trocar.teleoperation.engine import Teleoperation

Array = NDArray[np.float64]

#: Fingers pinch first, so that components notice a hand: the gripper, and for how long. Source: our
#: own choice: far enough from wide open for the dVRK's threshold. [rad, s]
PINCH, PINCH_S = 0.2, 0.3


@dataclass(frozen=True, eq=False)
class MasterMotion:
    """The recorded motion of masters.

    Attributes:
        times: from the beginning, (k,) [s]
        joints: {master: joint positions, the gripper last, (k, n)} [rad]
    """

    times: Array
    joints: Mapping[str, Array]

    @staticmethod
    def read(path: str) -> MasterMotion:
        """Read the masters of a recording.

        Raises:
            InputError: no recording, or one without masters
        """
        recorded = open_recording(path)
        found: dict[str, Array] = {}
        times = np.zeros(0)
        for name in recorded.arms:
            columns = recorded.columns(name)
            if columns is None or not name.startswith("MTM"):
                continue
            states = recorded.states(columns)
            times, found[name] = states.time - states.time[0], states.position
        if not found:
            arms = ", ".join(recorded.arms)
            raise InputError(f"{path}: contains no master; got arms {arms}; allowed: an MTM")
        return MasterMotion(times, found)

    def at(self, name: str, time: float) -> Array:
        """Return a master's joints at a time, (n,)."""
        rows = self.joints[name]
        after = int(np.searchsorted(self.times, time))
        if after >= len(rows):
            return rows[-1]
        if after == 0:
            return rows[0]
        before = self.times[after - 1]
        ratio = (time - before) / (self.times[after] - before)
        return (1.0 - ratio) * rows[after - 1] + ratio * rows[after]


class MotionPlayer:
    """Carry masters as recorded, from where they are, once their slaves follow.

    Args:
        engine: its masters are carried
        motion: the recorded one

    Raises:
        InputError: the rig has none of the recorded masters
    """

    def __init__(self, engine: Teleoperation, motion: MasterMotion) -> None:
        self._engine, self._motion = engine, motion
        self._names = [name for name in motion.joints if name in engine.carriers]
        if not self._names:
            known = ", ".join(engine.carriers)
            raise InputError(
                f"--motion: got the masters {', '.join(motion.joints)}; allowed: {known}"
            )
        self._from: dict[str, Array] = {}
        self.restart()

    @property
    def over(self) -> bool:
        """Whether it was played to its end."""
        return self._time >= float(self._motion.times[-1])

    @property
    def busy(self) -> bool:
        """Whether it carries masters now."""
        return self._time >= 0.0 and not self.over

    def restart(self) -> None:
        """Wait again until the slaves of these masters follow, and then play from the start."""
        self._time, self._waited = -1.0, 0.0

    def tick(self, period_s: float) -> None:
        """Go on by a period [s]."""
        if self.over:
            return
        if self._time < 0.0:
            self._wait(period_s)
            return
        self._time += period_s
        for name in self._names:
            self._carry(name)
            if self.over:
                self._engine.carriers[name].let_go()

    def _wait(self, period_s: float) -> None:
        """Pinch until every component that these masters move follows; then begin."""
        console, components = self._engine.console, self._engine.components
        mine = [
            components[name]
            for name in console.selected
            if set(components[name].description.masters) & set(self._names)
            and components[name].description.kind == "psm"
        ]
        if not all(one.following for one in mine):
            if any(one.current == ALIGNING for one in mine):
                self._waited += period_s
                self._pinch(shut=self._waited % (2.0 * PINCH_S) < PINCH_S)
            return
        world, self._time = self._engine.world, 0.0
        for name in self._names:
            base = world.reference_pose(name)
            self._from[name] = base @ world.arm(name).local.measured_cp().matrix

    def _pinch(self, *, shut: bool) -> None:
        for name in self._names:
            gripper = self._engine.world.arm(name).gripper
            if gripper is not None:
                if shut:
                    gripper.squeeze_to(PINCH)
                else:
                    gripper.release()

    def _carry(self, name: str) -> None:
        world, motion = self._engine.world, self._motion
        arm = world.arm(name)
        first, now = motion.at(name, 0.0), motion.at(name, self._time)
        tip = chain_pose(arm.description.mechanism)
        A, B = tip(first), tip(now)
        at, base = self._from[name], world.reference_pose(name)[:3, :3]
        turn = base @ rotation_vector_from_matrix(B[:3, :3] @ A[:3, :3].T)
        R = matrix_from_rotation_vector(turn) @ at[:3, :3]
        self._engine.carriers[name].carry(transform(R, at[:3, 3] + base @ (B - A)[:3, 3]))
        if arm.gripper is not None:
            opening = float(np.clip(now[-1], arm.joints.lower[-1], arm.joints.upper[-1]))
            arm.gripper.squeeze_to(opening)
