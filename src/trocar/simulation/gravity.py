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
        self._model, self._data = model, data
        self._servos = servos
        self._bodies = model.jnt_bodyid.astype(np.intp)
        weight = -float(model.opt.gravity[2]) * model.body_subtreemass[self._bodies]
        turns = model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)
        turning, sliding = np.where(turns, weight, 0.0), np.where(turns, 0.0, weight)
        share = np.zeros((len(servos.table), model.njnt))
        for b in (d.binding for d in drives if not d.welded):
            share[np.ix_(b.actuators, model.dof_jntid[b.dof])] = b.share
        #: What `_terms` of every joint count for in every effort, (n_servos, 3 joints).
        factors = np.stack([turning, -turning, sliding], axis=1)
        self._weights = (share[:, :, None] * factors).reshape(len(share), -1)
        #: Per joint: axis_x lever_y, axis_y lever_x, axis_z.
        self._terms = np.zeros((model.njnt, 3))
        self._products, self._upward = self._terms[:, :2], self._terms[:, 2]
        self._lever = np.zeros((model.njnt, 3))
        self._across = self._lever[:, 1::-1]
        self._com, self._anchor = data.subtree_com, data.xanchor
        self._axis, self._axis_up = data.xaxis[:, :2], data.xaxis[:, 2]

    def efforts(self) -> Array:
        """Return the efforts that hold every motor's load now, (n_servos,) [N m or N]."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return self._compute(np.zeros(len(self._weights)))

    def renew(self) -> None:
        """Feed forward what the servos that want it need, at the last step's beginning."""
        self._compute(self._servos.holding)
        self._servos.write_efforts()

    def renew_here(self) -> None:
        """Feed forward what they need where the arms are now, after they were put there."""
        self._servos.holding[:] = self.efforts()
        self._servos.write_efforts()

    def renew_one(self, drives: Drives) -> None:
        """Feed forward what one arm's servos need where it is now; the others keep theirs."""
        used = drives.binding.actuators
        self._servos.holding[used] = self.efforts()[used]
        self._servos.write_efforts()

    def _compute(self, out: Array) -> Array:
        self._com.take(self._bodies, 0, self._lever, "clip")
        np.subtract(self._lever, self._anchor, self._lever)
        np.multiply(self._axis, self._across, self._products)
        self._upward[:] = self._axis_up
        return self._weights.dot(self._terms.ravel(), out)
