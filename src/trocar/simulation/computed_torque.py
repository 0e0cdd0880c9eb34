"""Computed torque: efforts that decouple an arm's joints, added to those of its servos."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.modeling.joints import JointTable

Array = NDArray[np.float64]


class ComputedTorque:
    """Inverse dynamics of the model, loops closed, in a MjData of its own.

    With the inertia M(q) of the joints, e and e' the errors of positions and velocities, and a the
    acceleration of the set-points, the joints get

        tau = M (a + K e + D e') + h,   K = P / diag(M),   D = D_servo / diag(M)

    so that each error decays by itself: e'' + D e' + K e = 0. h is what weight, Coriolis forces,
    friction, springs, cables and biases take. The servos exert the diagonal, P e + D_servo e',
    implicitly; `efforts` is the rest.
    Source: Siciliano and others 2009, Robotics, section 8.5.2; gains: ours, as stiff as the servos.

    Args:
        table: the joints
        model: compiled
    """

    def __init__(self, table: JointTable, model: mujoco.MjModel) -> None:
        self._table, self._model, self._data = table, model, mujoco.MjData(model)
        self._full = np.zeros((model.nv, model.nv))
        # Rates of hinges and slides of joint rates; free objects have more coordinates than rates.
        single = model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
        self._couple = np.zeros((model.nv, table.couple.shape[1]))
        self._couple[model.jnt_dofadr[single]] = table.couple[model.jnt_qposadr[single]]

    def efforts(
        self, state: tuple[Array, Array], setpoint: Array, gains: Array, acceleration: Array
    ) -> Array:
        """Compute the efforts that are added to P e + I integral + D e', (J,).

        Args:
            state: coordinates and rates, (nq,) and (nv,)
            setpoint: positions and velocities, (J, 2) or more columns
            gains: P, I, D as they act, 0 where no servo does, (J, 3)
            acceleration: of the set-points, (J,)
        """
        table, model, data = self._table, self._model, self._data
        data.qpos[:], data.qvel[:] = state
        # as the servos and springs act: at the end of the step
        mujoco.mj_integratePos(model, data.qpos, data.qvel, float(model.opt.timestep))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fullM(model, data, self._full)
        inertia = self._full @ self._couple
        own = gains[:, 0] * (setpoint[:, 0] - table.drive @ data.qpos)
        own += gains[:, 2] * (setpoint[:, 1] - table.rate @ data.qvel)
        diagonal = np.einsum("vj,vj->j", self._couple, inertia)
        growth = acceleration + own / np.maximum(diagonal, mujoco.mjMINVAL)
        force = inertia @ growth + data.qfrc_bias - data.qfrc_passive
        force += model.dof_frictionloss * np.sign(self._couple @ setpoint[:, 1])
        return table.share @ force - own
