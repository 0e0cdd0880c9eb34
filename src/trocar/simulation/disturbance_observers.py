"""Disturbance observers of servos: what they add to the PID's efforts, one physics step at a time.

Source: sawControllers@f98b6a8 mtsPID.cpp:565-600, at the physics' rate in place of 1.5 kHz. The
dVRK's PID is that of actuators, and so are its observers: of an instrument's discs where it has
some (sawIntuitiveResearchKit@9e535e6 mtsIntuitiveResearchKitPSM.cpp:1411-1418).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.modeling.joints import INPUTS, JointTable

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

#: Largest torque of a disc, to which the dVRK limits PID and observer together. Source: torque
#: constant, gear ratio and largest current of SiPSM in dvrk-io-config-generator.py of the same
#: commit. [N m]
DISC_EFFORT_MAX = 0.0385 * 13.813 * 1.1


class Views(NamedTuple):
    """Views of one product with `DisturbanceObservers.matrix`: making them takes longer than sums.

    Attributes:
        damping: M g v of motors, (..., K)
        both: the PID's torques, in two copies, (..., 2 K)
        called, added: the first and the second copy, (..., K) each
    """

    damping: Array
    both: Array
    called: Array
    added: Array


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
        coupled: which joints each observer reads or drives, (K, R) bool
        discs: which observers are of an instrument's discs, (K,) bool
    """

    def __init__(self, table: JointTable, timestep: float) -> None:
        self.rows: Index = np.flatnonzero(table.observer[:, 1] > 0.0)
        velocity = table.observed[self.rows]
        effort: Array = np.linalg.inv(table.observed).T[self.rows].astype(np.float64)
        coupled = (velocity != 0.0) | (effort != 0.0)
        self.joints: Index = np.flatnonzero(coupled.any(axis=0))
        self.coupled: Bools = coupled[:, self.joints]
        self.discs: Bools = (table.observed != np.eye(len(table)))[self.rows].any(axis=1)
        mass, cutoff = table.observer[self.rows].T
        self._effort = np.ascontiguousarray(effort[:, self.joints])
        self._spread = np.ascontiguousarray(velocity[:, self.joints].T)
        self._damping, self._rate = (mass * cutoff)[:, None] * velocity, cutoff * timestep
        self._most = np.tile(np.where(self.discs, DISC_EFFORT_MAX, np.inf), 2)
        self._least = -self._most

    def acting(self, servoed: Bools) -> Array | None:
        """Return 1 of observers whose joints all have a PID, else 0, (K,); None where all have.

        Args:
            servoed: joints that their PID drives, (J,)
        """
        on = ~(self.coupled & ~servoed[self.joints]).any(axis=1)
        return None if on.all() else np.asarray(on, dtype=np.float64)

    def matrix(self, read: Array) -> Array:
        """Return the matrix of M g v of motors and, in two copies, of the PID's torques, (3 K, n).

        It is multiplied by the factor of READ. The PID's torques are without those that are fed
        forward, and 0 of motors other than discs.

        Args:
            read: READ of all joints, (3 J, n)
        """
        _, rate, pid = read.reshape(3, len(read) // 3, -1)
        fed = pid.copy()
        fed[:, INPUTS - INPUTS * len(pid) - 1 :: INPUTS] = 0.0
        called = self._effort @ fed[self.joints] * self.discs[:, None]
        return np.concatenate([self._damping @ rate, called, called])

    def views(self, found: Array) -> Views:
        """Return views of `matrix` times the factor of READ, (..., 3 K)."""
        count = len(self.rows)
        return Views(
            found[..., :count],
            found[..., count:],
            found[..., count : 2 * count],
            found[..., 2 * count :],
        )

    def observe(self, state: Array, effort: Array, views: Views, on: Array | None = None) -> Array:
        """Return the efforts to add to joints now, (..., R), and go on with the state in place.

        Args:
            state: x [N m or N]
            effort: of PID and observer at the joints, (..., R) [N m or N]
            views: of `matrix` times the factor of READ now; overwritten
            on: 1 of observers that act, 0 of those that add nothing and keep their state, (K,);
                None: all act
        """
        damping, both, called, added = views
        change = product(self._effort, effort)
        change += damping
        change -= state
        change *= self._rate
        if on is not None:
            change *= on
        state += change
        added += state
        added -= damping
        np.minimum(both, self._most, out=both)
        np.maximum(both, self._least, out=both)
        added -= called
        if on is not None:
            added *= on
        return product(self._spread, added)


def product(matrix: Array, vectors: Array) -> Array:
    """Return matrix times each vector, (..., n); of many, each rounds as it would alone."""
    if vectors.ndim == 1:
        return matrix.dot(vectors)
    return (matrix @ vectors[..., None])[..., 0]
