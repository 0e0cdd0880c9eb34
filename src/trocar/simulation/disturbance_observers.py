"""Disturbance observers of servos: what they add to the PID's efforts, one physics step at a time.

Source: sawControllers@f98b6a8 mtsPID.cpp:565-600, at the physics' rate in place of 1.5 kHz. The
dVRK's PID is that of actuators, and so are its observers: of an instrument's discs where it has
some (sawIntuitiveResearchKit@9e535e6 mtsIntuitiveResearchKitPSM.cpp:1411-1418).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.modeling.joints import JointTable

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

#: Largest torque of a disc, to which the dVRK limits PID and observer together. Source: torque
#: constant, gear ratio and largest current of SiPSM in dvrk-io-config-generator.py of the same
#: commit. [N m]
DISC_EFFORT_MAX = 0.0385 * 13.813 * 1.1


class DisturbanceObservers:
    """The disturbance observers of a rig's motors; arrays are (..., K), one of each observer.

    With the effort u that PID and observer called for at the last step, the velocity v, the nominal
    mass M and the cut-off g, the state x and the effort d that is added now are

        x += (u + M g v - x) g dt,   d = x - M g v

    so that d grows until u moves the motor; where u is within its limits, x is g times the integral
    of the PID's effort. Servos are those of joints. With the matrix C of the table's `observed`, a
    motor's velocity is C qd; what its observer adds to the efforts of joints is C^T d, and u is
    C^-T times theirs, so that the power of motors is that of joints. A disc at its largest torque
    gets no more from its observer: it adds clip(p + d) - clip(p), with p of the PID alone.

    Args:
        table: the joints
        timestep: physics step [s]

    Attributes:
        rows: rows of the table at which a motor has an observer, (K,)
        joints: rows of the table that these motors drive, (R,)
        dof: degree of freedom that each of these joints drives, (R,)
        coupled: which joints each observer reads or drives, (K, R) bool
        discs: which observers are of an instrument's discs
    """

    def __init__(self, table: JointTable, timestep: float) -> None:
        self.rows: Index = np.flatnonzero(table.observer[:, 1] > 0.0)
        velocity, effort = table.observed[self.rows], np.linalg.inv(table.observed).T[self.rows]
        coupled = (velocity != 0.0) | (effort != 0.0)
        self.joints: Index = np.flatnonzero(coupled.any(axis=0))
        self.dof: Index = abs(table.rate[self.joints]).argmax(axis=1)
        self.coupled: Bools = coupled[:, self.joints]
        velocity = velocity[:, self.joints]
        mass, cutoff = table.observer[self.rows].T
        self._effort = np.ascontiguousarray(effort[:, self.joints])
        self._damping = (mass * cutoff)[:, None] * velocity * table.rate[self.joints, self.dof]
        self._spread = np.ascontiguousarray(velocity.T)
        self._rate = cutoff * timestep
        self.discs: Index = np.flatnonzero((table.observed != np.eye(len(table)))[self.rows].any(1))
        driven = np.flatnonzero(self.coupled[self.discs].any(axis=0))
        self._wrist, self._wrist_dof = self.joints[driven], self.dof[driven]
        self._wrist_rate = table.rate[self._wrist, self._wrist_dof]
        self._wrist_qpos = abs(table.drive[self._wrist]).argmax(axis=1)
        self._wrist_drive = table.drive[self._wrist, self._wrist_qpos]
        self._wrist_effort = np.ascontiguousarray(self._effort[np.ix_(self.discs, driven)])

    def acting(self, servoed: Bools) -> Array | None:
        """Return 1 of observers whose joints all have a PID, else 0, (K,); None where all have.

        Args:
            servoed: joints that their PID drives, (J,)
        """
        on = ~(self.coupled & ~servoed[self.joints]).any(axis=1)
        return None if on.all() else on.astype(np.float64)

    def pid(self, gains: Array, setpoint: Array, integral: Array, state: tuple[Array, Array]) -> Array:
        """Return the torques that the PID of joints calls for at discs, (..., discs) [N m].

        Args:
            gains: P, I, D, (..., J, 3)
            setpoint: position, velocity and effort fed forward, (..., J, 3)
            integral: of the position error, (..., J)
            state: qpos (..., nq) and qvel (..., nv)
        """
        joints, (qpos, qvel) = self._wrist, state
        p, i, d = np.moveaxis(gains[..., joints, :], -1, 0)
        goal = setpoint[..., joints, :]
        effort = p * (goal[..., 0] - qpos[..., self._wrist_qpos] * self._wrist_drive)
        effort += i * integral[..., joints]
        effort += d * (goal[..., 1] - qvel[..., self._wrist_dof] * self._wrist_rate)
        return product(self._wrist_effort, effort)

    def observe(
        self,
        state: Array,
        effort: Array,
        rates: Array,
        pid: Array | None = None,
        on: Array | None = None,
    ) -> Array:
        """Return the efforts to add to joints now, (..., R), and go on with the state in place.

        Args:
            state: x [N m or N]
            effort: of PID and observer at the joints, (..., R) [N m or N]
            rates: of the joints' degrees of freedom now, (..., R) [rad/s or m/s]
            pid: as `pid` returns it; None without discs
            on: 1 of observers that act, 0 of those that add nothing and keep their state, (K,);
                None: all act
        """
        damping = product(self._damping, rates)
        change = product(self._effort, effort)
        change += damping
        change -= state
        change *= self._rate
        if on is not None:
            change *= on
        state += change
        added = state - damping
        if pid is not None:
            most = np.minimum(np.maximum(pid + added[..., self.discs], -DISC_EFFORT_MAX), DISC_EFFORT_MAX)
            most -= np.minimum(np.maximum(pid, -DISC_EFFORT_MAX), DISC_EFFORT_MAX)
            added[..., self.discs] = most
        if on is not None:
            added *= on
        return product(self._spread, added)


def product(matrix: Array, vectors: Array) -> Array:
    """Return matrix times each vector, (..., n); of many, each rounds as it would alone."""
    if vectors.ndim == 1:
        return matrix.dot(vectors)
    return (matrix @ vectors[..., None])[..., 0]
