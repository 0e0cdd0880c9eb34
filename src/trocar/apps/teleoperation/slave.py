"""An arm that follows poses in small steps, a thousand times a second.

Its joints are solved by Newton's method from where they are told to be, which takes a tenth of the
closed form's time and cannot leave its branch; where that does not converge, the closed form has
the last word. Joints are told velocities, too, or they would lag behind by their damping.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry.se3 import inverse
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import inverse_kinematics
from trocar.simulation.arm import SAFE_DEPTH_M

if TYPE_CHECKING:
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]

#: Joints are moved by so little to learn what that does. Source: our own choice. [rad or m]
STEP = 1e-6
#: A pose is met when nothing misses by more. Source: our own choice. [m, rad]
MET = 1e-10
TRIES = 6
#: A step of Newton's method that is longer leaves its branch. Source: our own choice. [rad or m]
FAR = 0.3
INSERTION = 2
#: A tip that is held back by more is not pushed on. Source: our own choice; joints that lag far
#: behind would end in FAULT. [m]
LEASH_M = 0.01


class Slave:
    """Lead a tool's tip.

    Args:
        arm: a PSM, or a master that a hand carries
        T_view_base: the arm's own reference frame as the surgeon sees it, (4, 4)
    """

    def __init__(self, arm: Arm, T_view_base: Array) -> None:
        self._arm = arm
        self._T_view_base, self._T_base_view = T_view_base, inverse(T_view_base)
        mechanism = arm.description.mechanism
        self._mechanism = mechanism
        self._tip, self._own = chain_pose(mechanism), arm.description.own_joints
        whole = arm.setpoints()
        self._told, self._rest = whole[: self._own], whole[self._own :]
        self._deepest_out = self._insertion_of(SAFE_DEPTH_M)

    @property
    def T(self) -> Array:
        """Where the tip is told to be, as the surgeon sees it, (4, 4)."""
        return self._T_view_base @ self._tip(np.concatenate([self._told, self._rest]))

    def follow(self, T: Array, period_s: float) -> str:
        """Bring the tip to a pose as the surgeon sees it, (4, 4), within a period [s].

        Returns:
            why it stays where it is, "" when it follows
        """
        wanted = self._T_base_view @ T
        q = self._solved(wanted)
        why = q if isinstance(q, str) else self._why_not(q, wanted)
        if why or isinstance(q, str):
            self._arm.servo_jp(self._told)
            return why
        inside = np.clip(q, self._arm.lower[: self._own], self._arm.upper[: self._own])
        speed = (inside - self._told) / period_s
        self._told = inside
        self._arm.servo_jp(inside, speed)
        beyond = np.flatnonzero(inside != q)
        return f"{self._arm.joint_names[beyond[0]]} is at its limit" if beyond.size else ""

    def _why_not(self, q: Array, wanted: Array) -> str:
        """Return why joint positions must not be gone to, "" when they may."""
        if self._deepest_out is not None and q[INSERTION] < self._deepest_out:
            return (
                f"the wrist would come nearer than {1e3 * SAFE_DEPTH_M:.0f} mm to the remote centre"
            )
        here = self._arm.readings()[0]
        both = self._tip(np.stack([here, np.concatenate([self._told, self._rest])]))[:, :3, 3]
        lag, far = both[0] - both[1], both[0] - wanted[:3, 3]
        if lag @ lag > LEASH_M**2 < far @ far:
            return "something is in its way"
        return ""

    def _solved(self, wanted: Array) -> Array | str:
        """Return the joints that bring the tip to a pose in its own base, or why there are none."""
        q = self._told.copy()
        J: Array | None = None
        for _ in range(TRIES):
            if J is None:
                T, J = self._pose_and_jacobian(q)
            else:
                T = self._tip(np.concatenate([q, self._rest]))
            misses = _miss(T, wanted)
            if np.abs(misses).max() < MET:
                return q
            step = _step(J, misses)
            if np.abs(step).max() > FAR:
                break
            q = q + step
        return self._closed_form(wanted)

    def _closed_form(self, wanted: Array) -> Array | str:
        structure = self._arm.description.inverse_kinematics
        try:
            return inverse_kinematics(self._mechanism, structure, wanted, self._told)[0]
        except TrocarError as problem:
            return str(problem)

    def _pose_and_jacobian(self, q: Array) -> tuple[Array, Array]:
        """Return the tip's pose and how it moves with each joint: (linear; angular), (6, n)."""
        rows = np.tile(np.concatenate([q, self._rest]), (self._own + 1, 1))
        rows[np.arange(1, self._own + 1), np.arange(self._own)] += STEP
        found = self._tip(rows)
        R, p = found[:, :3, :3], found[:, :3, 3]
        D = R[1:] @ R[0].T
        turn = np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]])
        return found[0], np.concatenate([(p[1:] - p[0]).T, 0.5 * turn]) / STEP

    def _insertion_of(self, depth: float) -> float | None:
        """Return the insertion that puts the wrist so far past the remote centre, None without."""
        if self._arm.type != "PSM" or "wrist_pitch" not in self._mechanism.frame_index:
            return None
        q = np.concatenate([self._told, self._rest])
        wrist = chain_pose(self._mechanism, "wrist_pitch")(q)[:3, 3]
        ahead = chain_pose(self._mechanism, "roll")(q)[:3, 2]
        return float(q[INSERTION] - ahead @ wrist + depth)


def _step(J: Array, misses: Array) -> Array:
    """Return the smallest change of joints that makes up for what misses, (n,)."""
    if J.shape[0] == J.shape[1]:
        try:
            return np.asarray(np.linalg.solve(J, misses), dtype=np.float64)
        except np.linalg.LinAlgError:
            pass
    return np.asarray(np.linalg.lstsq(J, misses, rcond=1e-6)[0], dtype=np.float64)


def _miss(T: Array, wanted: Array) -> Array:
    """Return how far a pose is from another: (linear; angular) in their base's axes, (6,).

    The angular part is half of what is skew in the rotation between them, exact to second order.
    """
    D = wanted[:3, :3] @ T[:3, :3].T
    turn = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
    return np.concatenate([wanted[:3, 3] - T[:3, 3], turn])
