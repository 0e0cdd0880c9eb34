"""Gravity compensation: what each motor must exert to hold its load still, fed forward.

By virtual work: a body's weight does work when a hinge ahead of it moves, and a joint moves its
hinges (those inside loops too) in fixed ratios. So effort = share @ Q with, for each hinge,
Q = axis . ((com - anchor) x weight), com and weight being those of everything beyond it.
"""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.simulation.drives import Drives
from trocar.simulation.servos import ServoInputs

Array = NDArray[np.float64]

#: Renewed this often. Source: our own choice; at 0.6 rad/s a PSM's gravity torque changes by less
#: than 0.02 N m in this time, which its servos answer with 0.2 mrad. [s]
PERIOD_S = 0.02


class GravityCompensation:
    """Efforts that balance the weight of everything that each motor moves."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        servos: ServoInputs,
        drives: Iterable[Drives],
    ) -> None:
        live = [d.binding for d in drives if not d.welded]
        self._model, self._data = model, data
        self._servos = servos
        dofs = np.concatenate([np.zeros(0, dtype=np.intp), *(b.dof for b in live)])
        joints = model.dof_jntid[dofs]
        #: A slice where the arms' joints stand in one row: twice as fast as an index.
        self._joints = _row_or_index(joints)
        self._bodies = model.jnt_bodyid[joints]
        self._lever = np.zeros((len(joints), 3))
        weight = -float(model.opt.gravity[2]) * model.body_subtreemass[self._bodies]
        turns = model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_HINGE)
        self._turning = np.where(turns, weight, 0.0)
        self._sliding = np.where(turns, 0.0, weight)
        self._share = np.zeros((len(servos.table), len(joints)))
        column = 0
        for b in live:
            self._share[b.actuators, column : column + len(b.dof)] = b.share
            column += len(b.dof)

    def efforts(self) -> Array:
        """Return the efforts that hold every motor's load now, (n_servos,) [N m or N]."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return self._efforts()

    def renew(self) -> None:
        """Feed forward what the servos that want it need, at the last step's beginning."""
        self._servos.holding = self._efforts()
        self._servos.write_efforts()

    def renew_here(self) -> None:
        """Feed forward what they need where the arms are now, after they were put there."""
        self._servos.holding = self.efforts()
        self._servos.write_efforts()

    def _efforts(self) -> Array:
        axis, lever = self._data.xaxis[self._joints], self._lever
        np.take(self._data.subtree_com, self._bodies, axis=0, out=lever, mode="clip")
        lever -= self._data.xanchor[self._joints]
        load = axis[:, 0] * lever[:, 1]
        load -= axis[:, 1] * lever[:, 0]
        load *= self._turning
        load += self._sliding * axis[:, 2]
        return self._share @ load


def _row_or_index(joints: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    if len(joints) and np.array_equal(joints, np.arange(joints[0], joints[0] + len(joints))):
        return slice(int(joints[0]), int(joints[0]) + len(joints))
    return joints
