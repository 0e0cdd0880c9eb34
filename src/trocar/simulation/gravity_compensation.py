"""Gravity compensation by coefficients of an arm's controller, which the arm may weigh or not."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.modeling.gravity import GravityModel

Array = NDArray[np.float64]


class GravityCompensation:
    """Computes the efforts that controllers feed forward, in a MjData of its own.

    Args:
        model: chains of the controllers
        drive: as of the joint table, (J, nq)
    """

    def __init__(self, model: GravityModel, drive: Array) -> None:
        self._model, self._drive, self._data = model, drive, mujoco.MjData(model.mj)

    def write(self, qpos: Array, out: Array) -> None:
        """Write the efforts of the joints that have coefficients; leave those of others.

        Args:
            qpos: coordinates of the rig as the encoders report them, (nq,)
            out: written, (J,) [N m or N]
        """
        model, data = self._model, self._data
        data.qpos[:] = model.couple.dot(self._drive.dot(qpos))
        mujoco.mj_kinematics(model.mj, data)
        mujoco.mj_comPos(model.mj, data)
        mujoco.mj_rne(model.mj, data, 0, data.qfrc_bias)
        np.copyto(out, data.qfrc_bias.dot(model.couple), where=model.rows)
