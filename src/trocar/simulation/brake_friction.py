"""Brakes of arms with motors, as dry friction of the hinges that the motors drive."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.modeling.joints import JointTable
from trocar.modeling.options import STIFF_IMPEDANCE, STOP_STEPS

Array = NDArray[np.float64]

#: Ratio of the inverse inertia of a brake's dry friction to the joint's. Source: measured on arms
#: of an Si without power: they creep by 8.6 mrad an hour with 1, by 8.6 urad with this.
EASE = 1e-3


class BrakeFriction:
    """The brakes of a rig's joints in its compiled model.

    MuJoCo's dry friction yields by the inverse inertia of its hinge alone (`dof_invweight0`); of a
    telescope's stage, which another without mass carries, that is 10^4 times the joint's. So an
    engaged brake has `EASE` of the joint's own, and the impedance of a stop.

    Args:
        table: the joints
        model: compiled, with no brake engaged
    """

    def __init__(self, table: JointTable, model: mujoco.MjModel) -> None:
        self._rows = np.flatnonzero(table.brake)
        rate = np.abs(table.rate[self._rows])
        self._dof = rate.argmax(axis=1)  # of the one hinge that a motor drives
        weight = rate[np.arange(len(self._rows)), self._dof]
        self._friction = table.brake[self._rows] * weight
        self._ease = EASE / (weight**2 * _inertia(table, model)[self._rows])
        self._free = tuple(
            field[self._dof].copy()
            for field in (model.dof_solref, model.dof_solimp, model.dof_invweight0)
        )

    def engage(self, model: mujoco.MjModel, engaged: NDArray[np.bool_]) -> None:
        """Write which brakes are engaged, (J,), into a model with the friction of none."""
        on, dof, (solref, solimp, ease) = engaged[self._rows], self._dof, self._free
        stiff = [STOP_STEPS * float(model.opt.timestep), 1.0]
        model.dof_frictionloss[dof] += on * self._friction
        model.dof_solref[dof] = np.where(on[:, None], stiff, solref)
        model.dof_solimp[dof] = np.where(on[:, None], STIFF_IMPEDANCE, solimp)
        model.dof_invweight0[dof] = np.where(on, self._ease, ease)


def _inertia(table: JointTable, model: mujoco.MjModel) -> Array:
    """Return the inertia of each joint with all that follows it, others at rest, (J,)."""
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_makeM):
        compute(model, data)
    mujoco.mj_fullM(model, data, full)
    single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    couple = np.zeros((model.nv, len(table)))
    couple[model.jnt_dofadr[single]] = table.couple[model.jnt_qposadr[single]]
    return np.einsum("vj,vw,wj->j", couple, full, couple)
