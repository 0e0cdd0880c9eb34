"""The motors of one arm: modes, gains, brakes and limits, written into the model's servos."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import Control, RigArm
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import coordinate_rates
from trocar.simulation.binding import Binding, bind
from trocar.simulation.records import Mode

Array = NDArray[np.float64]

#: A servo's inputs lie side by side in `ctrl`: position, velocity, feed-forward effort.
INPUTS = 3
#: Stands for "no limit" where MuJoCo wants a number. [N m or N]
UNLIMITED = 1e6


class Drives:
    """Reads and writes one arm's part of the physics state.

    Attributes:
        binding: where the arm's joints are in the model
        modes: control mode of each joint
        gains: (n, 3) P, I, D of each joint
        locked: whether each joint's brake holds it, (n,) bool
        effort_limit: largest effort of each motor, (n,) [N m or N]
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, rig_arm: RigArm, control: Control
    ) -> None:
        self.binding: Binding = bind(model, rig_arm)
        self.arm = rig_arm.arm
        self._model, self._data = model, data
        joints = self.arm.joints
        self.welded = not len(self.binding.hinges)
        self.brakes = self.arm.type == "SUJ"
        self.modes: list[Mode] = ["position"] * len(joints)
        self.gains = np.array([[g.p, g.i, g.d] for g in (control.pid[j.name] for j in joints)])
        self.locked = np.full(len(joints), self.brakes)
        self.limit_efforts(control.effort_limits)

    def limit_efforts(self, on: bool) -> None:
        """Switch the motors' effort limits; a jaw's grip is always limited."""
        self.effort_limit = np.array(
            [
                j.effort_max if (on or j.name == "jaw") and np.isfinite(j.effort_max) else UNLIMITED
                for j in self.arm.joints
            ]
        )
        if not self.welded:
            limits = np.column_stack([-self.effort_limit, self.effort_limit])
            self._model.actuator_forcerange[self.binding.actuators] = limits

    def apply(self) -> None:
        """Write modes, gains and brakes into the model."""
        if self.welded:
            return
        servo = np.array([m == "position" for m in self.modes]) & ~self.locked
        ids, on = self.binding.actuators, self.gains * servo[:, None]
        self._model.actuator_biasprm[ids, 1] = -on[:, 0]
        self._model.actuator_gainprm[ids, 0] = on[:, 1]
        self._model.actuator_biasprm[ids, 2] = -on[:, 2]
        held = self.locked | np.array([m == "set" for m in self.modes])
        self._data.eq_active[self.binding.pins] = held

    def compensate_gravity(self, on: bool) -> None:
        """Switch gravity compensation; setup joints are counterbalanced and always have it."""
        self._model.body_gravcomp[self.binding.bodies] = 1.0 if on or self.brakes else 0.0

    @property
    def gravity_compensated(self) -> bool:
        """Whether the motors carry the links' weight."""
        return bool(self._model.body_gravcomp[self.binding.bodies].any())

    def set_mode(self, mode: Mode, which: Iterable[int], hold: Array) -> None:
        """Change the mode of joints; they start from `hold`, (n,), without effort."""
        chosen = list(which)
        for index in chosen:
            self.modes[index] = mode
        self._forget(chosen)
        self.apply()
        self.command(hold, np.zeros(len(hold)))

    def set_brakes(self, locked: bool, which: Iterable[int]) -> None:
        """Lock joints where they are, or release them to their servos."""
        chosen = list(which)
        here = self.positions()
        self.locked[chosen] = locked
        self._forget(chosen)
        self._model.eq_data[self.binding.pins[chosen], 0] = (
            self.binding.pin_scale[chosen] * here[chosen]
        )
        self.apply()

    def command(self, q: Array, v: Array) -> None:
        """Write set-points, (n,) each [rad or m, per s].

        Joints in mode "set" are put there at once, with everything that their loops move.
        """
        if self.welded:
            return
        address = INPUTS * self.binding.actuators
        self._data.ctrl[address] = q
        self._data.ctrl[address + 1] = v
        kinematic = np.array([m == "set" for m in self.modes]) & ~self.locked
        if kinematic.any():
            pins = self.binding.pins[kinematic]
            self._model.eq_data[pins, 0] = (self.binding.pin_scale * q)[kinematic]
            here, rate = self.positions(), self.velocities()
            self._put(np.where(kinematic, q, here), np.where(kinematic, v, rate))

    def command_effort(self, effort: Array) -> None:
        """Write efforts of the joints in mode "effort", (n,) [N m or N]; others ignore theirs."""
        if self.welded:
            return
        open_loop = np.array([m == "effort" for m in self.modes])
        limited = np.clip(effort, -self.effort_limit, self.effort_limit)
        address = INPUTS * self.binding.actuators + 2
        self._data.ctrl[address] = np.where(open_loop, limited, 0.0)

    def place(self, q: Array, v: Array) -> None:
        """Put the arm at joint positions with velocities, at rest inside, (n,) each."""
        if self.welded:
            return
        self._put(q, v)
        self._forget(range(len(q)))
        self._model.eq_data[self.binding.pins, 0] = self.binding.pin_scale * q
        self.command(q, v)

    def positions(self) -> Array:
        """Return measured positions, (n,) [rad or m]."""
        return self.binding.drive @ self._data.qpos[self.binding.qpos]

    def velocities(self) -> Array:
        """Return measured velocities, (n,) [rad/s or m/s]."""
        return self.binding.drive @ self._data.qvel[self.binding.dof]

    def efforts(self) -> Array:
        """Return what the motors exert, gravity compensation included, (n,) [N m or N]."""
        motor = self._data.actuator_force[self.binding.actuators]
        return motor + self.binding.share @ self._data.qfrc_gravcomp[self.binding.dof]

    def frame_coordinates(self) -> Array:
        """Return every frame's own coordinate as the simulation has it, (n_frames,)."""
        found = np.zeros(len(self.arm.mechanism.frames))
        found[self.binding.hinges] = self._data.qpos[self.binding.qpos]
        return found

    def _put(self, q: Array, v: Array) -> None:
        where = coordinates(self.arm.mechanism, q)
        rates = coordinate_rates(self.arm.mechanism, where) @ v
        self._data.qpos[self.binding.qpos] = where[self.binding.hinges]
        self._data.qvel[self.binding.dof] = rates[self.binding.hinges]

    def _forget(self, which: Iterable[int]) -> None:
        chosen = np.array(list(which), dtype=np.intp)
        if self.welded or not len(chosen):
            return
        self._data.act[self.binding.act[chosen]] = 0.0
        self._data.ctrl[INPUTS * self.binding.actuators[chosen] + 2] = 0.0
