"""A force that turns about each instrument's tip: the load of the loop tests."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.simulation.parts import Attached, Part, steps_in

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


class TipLoad(Part):
    """Pushes every PSM's and ECM's tip with a force of constant size [N].

    Raises:
        InputError: the size is below 0 or not finite
    """

    def __init__(self, size: float) -> None:
        if not 0.0 <= size < np.inf:
            raise InputError(f"tip_load_n: got {size!r}; allowed: 0 N or more")
        self.size = size

    def attach(self, physics: Attached) -> None:
        """Find the tips in the physics."""
        self._model, self._data, self._frames = physics.model, physics.data, physics.true_frames
        self.before_every = steps_in(PERIOD_S, physics.timestep) if self.size > 0.0 else 0
        self._tips: list[tuple[int, Array, int]] = []
        for arm in physics.rig.arms:
            if arm.arm.type in ("PSM", "ECM"):
                index = physics.joints.arms[arm.name]
                body, at = index.carrier(arm, arm.arm.mechanism.tip)
                self._tips.append((body, at[:3, 3].copy(), index.bodies[arm.arm.root]))
        self._forces = np.zeros((len(self._tips), 3))

    def before_step(self) -> None:
        """Write this instant's forces."""
        now = self._frames.bodies()
        mujoco.mj_comPos(self._model, now)
        direction = self.size * load_direction(float(self._data.time))
        self._data.qfrc_applied[:] = 0.0
        for (body, point, root), force in zip(self._tips, self._forces, strict=True):
            force[:] = now.xmat[root].reshape(3, 3) @ direction
            at = now.xpos[body] + now.xmat[body].reshape(3, 3) @ point
            mujoco.mj_applyFT(self._model, now, force, NO_TORQUE, at, body, self._data.qfrc_applied)

    def acting(self) -> list[tuple[int, Array, Array]]:
        """Return (body, point in it (3,) [m], force in the world (3,) [N]) of each force.

        None acts between a reset and the first step after it.
        """
        if not self._data.qfrc_applied.any():
            return []
        return [
            (body, point, force.copy())
            for (body, point, _), force in zip(self._tips, self._forces, strict=True)
        ]
