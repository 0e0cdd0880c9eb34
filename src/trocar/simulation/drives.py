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
from trocar.simulation.servos import ServoInputs

Array = NDArray[np.float64]

#: Stands for "no limit" where MuJoCo wants a number. [N m or N]
UNLIMITED = 1e6
#: Damping of a joint that its brake or the mode "set" holds: a column under its 300 N creeps 1 um
#: an hour. Source: our own choice; a constraint per brake would cost the cart 10 % of its speed
#: (measured). [N m s/rad or N s/m]
HOLDING_DAMPING = 1e12


class Drives:
    """Reads and writes one arm's part of the physics state.

    Attributes:
        binding: where the arm's joints are in the model
        modes: control mode of each joint
        gains: (n, 3) P, I, D of each joint
        locked: whether each joint's brake holds it, (n,) bool
        powered: whether the motors have power; without it the arm is held as by a brake
        effort_limit: largest effort of each motor, (n,) [N m or N]
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        servos: ServoInputs,
        rig_arm: RigArm,
        control: Control,
    ) -> None:
        self._rig_arm, self.arm = rig_arm, rig_arm.arm
        self._find(model, data, servos)
        joints = self.arm.joints
        self.welded = not len(self.binding.hinges)
        self.brakes = self.arm.type == "SUJ"
        self.gains = np.array([[g.p, g.i, g.d] for g in (control.pid[j.name] for j in joints)])
        self.locked = np.full(len(joints), self.brakes)
        #: A gripper has no motor: its servo stands for a person's fingers.
        self._fingers = np.array([j.spring is not None for j in joints])
        self.restore()
        #: A jaw below 0 or on an object is force, not error; a master is moved by hand. Source: SAW
        #: mtsIntuitiveResearchKitMTM.h, should_use_measured_setpoint_check.
        held = ["jaw"] if self.arm.type != "MTM" else [j.name for j in joints]
        self._tolerance = np.array(
            [np.inf if j.name in held else j.tracking_tolerance for j in joints]
        )
        self.limit_efforts(control.effort_limits)

    def attach(self, model: mujoco.MjModel, data: mujoco.MjData, servos: ServoInputs) -> None:
        """Go on in a model that was compiled anew, with modes, gains, brakes and limits as set."""
        balanced = self._servos.balanced[self.binding.actuators]
        self._find(model, data, servos)
        servos.balanced[self.binding.actuators] = balanced
        self._write_limits()
        self.apply()

    def _find(self, model: mujoco.MjModel, data: mujoco.MjData, servos: ServoInputs) -> None:
        self.binding: Binding = bind(model, self._rig_arm)
        self._model, self._data, self._servos = model, data, servos
        self._dry = model.dof_frictionloss[self.binding.dof].copy()
        self._viscous = model.dof_damping[self.binding.dof].copy()

    def limit_efforts(self, on: bool) -> None:
        """Switch the motors' effort limits; a jaw's grip is always limited."""
        self.effort_limit = np.array(
            [
                j.effort_max
                if (on or j.name == "jaw" or j.spring) and np.isfinite(j.effort_max)
                else UNLIMITED
                for j in self.arm.joints
            ]
        )
        self._write_limits()

    def _write_limits(self) -> None:
        self._servos.revision += 1
        if not self.welded:
            limits = np.column_stack([-self.effort_limit, self.effort_limit])
            self._model.actuator_forcerange[self.binding.actuators] = limits

    def apply(self) -> None:
        """Write modes, gains and brakes into the model."""
        if self.welded:
            return
        self._servos.revision += 1
        ids, on = self.binding.actuators, self.gains * self._servoed()[:, None]
        self._model.actuator_biasprm[ids, 1] = -on[:, 0]
        self._model.actuator_gainprm[ids, 0] = on[:, 1]
        self._model.actuator_biasprm[ids, 2] = -on[:, 2]
        still = self.locked | np.array([m == "set" for m in self.modes]) | (not self.powered)
        held = (still & ~self._fingers) @ self.binding.driven
        self._model.dof_damping[self.binding.dof] = np.where(held, HOLDING_DAMPING, self._viscous)
        self._servos.tolerance[ids] = np.where(self._servoed(), self._tolerance, np.inf)
        if self.brakes:
            self._rest()

    def switch(self, powered: bool) -> None:
        """Give the motors power, or take it and hold the arm where it is."""
        self.powered = powered
        self._forget(range(len(self.modes)))
        self.apply()

    def _rest(self) -> None:
        """Spare the physics the servos and the dry friction of joints whose brakes hold them."""
        group = 1 << int(self._model.actuator_group[self.binding.actuators[0]])
        asleep = self._model.opt.disableactuator & ~group
        self._model.opt.disableactuator = asleep | (group if self.locked.all() else 0)
        self._model.dof_frictionloss[self.binding.dof] = np.where(self.locked, 0.0, self._dry)

    def compensate_gravity(self, on: bool) -> None:
        """Switch gravity compensation; setup joints are counterbalanced and always have it."""
        if not self.welded:
            self._servos.balanced[self.binding.actuators] = ~self._fingers & (on or self.brakes)
        self._servos.write_efforts()

    @property
    def gravity_compensated(self) -> bool:
        """Whether the motors carry the links' weight."""
        return bool(self._servos.balanced[self.binding.actuators].any())

    def restore(self) -> None:
        """Go back to position mode, brakes locked, no fingers; gains and compensation stay."""
        self.modes: list[Mode] = ["effort" if f else "position" for f in self._fingers]
        self.locked[:] = self.brakes
        self.powered = True

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
        self.locked[chosen] = locked
        self._forget(chosen)
        self.apply()

    def command(self, q: Array, v: Array) -> None:
        """Write set-points, (n,) each [rad or m, per s].

        Joints in mode "set" are put there at once, with everything that their loops move.
        """
        if self.welded:
            return
        self._servos.table[self.binding.actuators, 0] = q
        self._servos.table[self.binding.actuators, 1] = v
        kinematic = np.array([m == "set" for m in self.modes]) & ~self.locked
        if kinematic.any():
            here, rate = self.positions(), self.velocities()
            self._put(np.where(kinematic, q, here), np.where(kinematic, v, rate))

    def command_effort(self, effort: Array) -> None:
        """Write efforts of the joints in mode "effort", (n,) [N m or N]; others ignore theirs."""
        if self.welded:
            return
        open_loop = np.array([m == "effort" for m in self.modes]) & ~self._fingers
        ids = self.binding.actuators
        kept = np.where(self._fingers, self._servos.commanded[ids], 0.0)
        self._servos.commanded[ids] = np.where(open_loop, effort, kept)
        self._servos.write_efforts()

    def finger(self, mode: Mode, q: float, effort: float) -> None:
        """Put fingers to the last joint: they hold it at q with an effort, or just exert it."""
        servo = self.binding.actuators[-1]
        self.modes[-1] = mode
        self.apply()
        self._servos.table[servo, :2] = q, 0.0
        self._servos.commanded[servo] = effort
        self._servos.write_efforts()

    def place(self, q: Array, v: Array) -> None:
        """Put the arm at joint positions with velocities, at rest inside, (n,) each."""
        if self.welded:
            return
        self._put(q, v)
        self._forget(range(len(q)))
        self.command(q, v)

    def positions(self) -> Array:
        """Return measured positions, (n,) [rad or m]."""
        return self.binding.drive @ self._data.qpos[self.binding.qpos]

    def velocities(self) -> Array:
        """Return measured velocities, (n,) [rad/s or m/s]."""
        return self.binding.drive @ self._data.qvel[self.binding.dof]

    def efforts(self) -> Array:
        """Return what the motors exert, gravity compensation included, (n,) [N m or N].

        Nothing without power, though a brake then holds the arm.
        """
        b = self.binding
        state = (self.positions(), self.velocities(), self._data.act[b.act])
        return self.servo_efforts(self._servos.table[b.actuators], state)

    def servo_efforts(self, inputs: Array, state: tuple[Array, Array, Array]) -> Array:
        """Return the motors' efforts in a state: the servos' law and what is fed forward.

        The integrator is implicit in the servos: what acts during a period is their force at its
        end. MuJoCo's `actuator_force` is the one at its beginning, which is wrong by
        (P v + D a) dt: 1.2 N at 0.2 m/s on the insertion, more than its friction.

        Args:
            inputs: set-points and fed-forward effort, (..., n, 3)
            state: positions, velocities, integrals of the position error, (..., n) each

        Returns:
            (..., n) [N m or N]
        """
        q, v, integral = state
        p, i, d = (self.gains * self._servoed()[:, None]).T
        servo = p * (inputs[..., 0] - q) + i * integral + d * (inputs[..., 1] - v)
        total = np.clip(servo + inputs[..., 2], -self.effort_limit, self.effort_limit)
        return np.where(self._driven(), total, 0.0)

    def load(self) -> Array:
        """Return the efforts that the weight of the links asks for, renewed with it, (n,)."""
        if self.welded:
            return np.zeros(len(self.modes))
        return self._servos.holding[self.binding.actuators].copy()

    def law(self) -> Array:
        """Return P, I, D as they act now, 0 where no servo does, and the limit, (n, 4)."""
        limit = np.where(self._driven(), self.effort_limit, 0.0)
        return np.column_stack([self.gains * self._servoed()[:, None], limit])

    def target(self, joint: int) -> float:
        """Return the position that a joint's servo was told last [rad or m]."""
        return float(self._servos.table[self.binding.actuators[joint], 0])

    def frame_coordinates(self) -> Array:
        """Return every frame's own coordinate as the simulation has it, (n_frames,)."""
        found = np.zeros(len(self.arm.mechanism.frames))
        found[self.binding.hinges] = self._data.qpos[self.binding.qpos]
        return found

    def _driven(self) -> NDArray[np.bool_]:
        """Return which joints a motor or a person's fingers act on, (n,); brakes let none."""
        return (self._fingers | self.powered) & ~self.locked

    def _servoed(self) -> NDArray[np.bool_]:
        """Return which joints their servos drive, (n,)."""
        return np.array([m == "position" for m in self.modes]) & self._driven()

    def _put(self, q: Array, v: Array) -> None:
        where = coordinates(self.arm.mechanism, q)
        rates = coordinate_rates(self.arm.mechanism, where) @ v
        self._data.qpos[self.binding.qpos] = where[self.binding.hinges]
        self._data.qvel[self.binding.dof] = rates[self.binding.hinges]
        # What the last period's forces did is no longer true; sensors look for this mark.
        self._data.qacc[self.binding.dof] = np.nan

    def _forget(self, which: Iterable[int]) -> None:
        chosen = np.array([i for i in which if not self._fingers[i]], dtype=np.intp)
        if self.welded or not len(chosen):
            return
        self._data.act[self.binding.act[chosen]] = 0.0
        self._servos.commanded[self.binding.actuators[chosen]] = 0.0
        self._servos.write_efforts()
