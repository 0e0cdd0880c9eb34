"""A force that turns about each instrument's tip: the load of the loop tests."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigArm, RigDescription
from trocar.errors import InputError
from trocar.simulation.drives import Drives

Array = NDArray[np.float64]

#: Turns about z of frame 0 at this rate, with this share along z. Source: our own choice.
RATE_RAD_S = 7.0
SHARE_ALONG_Z = 0.3
#: The force is renewed this often. Source: our own choice; it turns by 2 deg in this time. [s]
PERIOD_S = 0.005
NO_TORQUE = np.zeros(3)


def load_direction(time: float) -> Array:
    """Return the unit direction of the load in the arm's frame 0 at a time, (3,)."""
    across = np.sqrt(1.0 - SHARE_ALONG_Z**2)
    angle = RATE_RAD_S * time
    return np.array([across * np.cos(angle), across * np.sin(angle), SHARE_ALONG_Z])


class TipLoad:
    """Pushes every PSM's and ECM's tip with a force of constant size [N]."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        rig: RigDescription,
        drives: Mapping[str, Drives],
        size: float,
    ) -> None:
        if not 0.0 <= size < np.inf:
            raise InputError(f"tip_load_n: got {size!r}; allowed: 0 N or more")
        self.size = size
        self._model, self._data = model, data
        self._tips = [
            (*_tip_body(arm, drives[arm.name]), drives[arm.name].binding.frame_bodies)
            for arm in rig.arms
            if arm.arm.type in ("PSM", "ECM")
        ]
        self._roots = [arm.arm.root for arm in rig.arms if arm.arm.type in ("PSM", "ECM")]

    def apply(self) -> None:
        """Write this instant's forces; kinematics and centres of mass must be up to date."""
        direction = self.size * load_direction(float(self._data.time))
        self._data.qfrc_applied[:] = 0.0
        for (body, point, bodies), root in zip(self._tips, self._roots, strict=True):
            base = self._data.xmat[bodies[root]].reshape(3, 3)
            force = base @ direction
            at = self._data.xpos[body] + self._data.xmat[body].reshape(3, 3) @ point
            mujoco.mj_applyFT(
                self._model, self._data, force, NO_TORQUE, at, body, self._data.qfrc_applied
            )


def _tip_body(arm: RigArm, drives: Drives) -> tuple[int, Array]:
    """Return the body that carries the tip's point, and the point in it, (3,) [m]."""
    mechanism = arm.arm.mechanism
    at = np.eye(4)
    frame = mechanism.frame(mechanism.tip)
    while frame.name not in drives.binding.frame_bodies and frame.parent is not None:
        at = frame.before @ frame.after @ at
        frame = mechanism.frame(frame.parent)
    return drives.binding.frame_bodies[frame.name], at[:3, 3].copy()
