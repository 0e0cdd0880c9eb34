"""The motors of one arm: its rows of the world's servos, and how its loops follow."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigArm
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import coordinate_rates
from trocar.simulation.records import Mode
from trocar.simulation.servos import EFFORT, SET, MotorEffort, Servos

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MODES: tuple[Mode, ...] = ("position", "effort", "set")


class Motors:
    """Reads and writes one arm's part of the physics state.

    Arrays are views of the world's own; set-points *are* the inputs of the servos.

    Attributes:
        arm: description of the arm with its tool
        index: where it is in the model
        welded: whether it is welded into the model; it then has no servos
        brakes: whether its joints have brakes
        position, velocity: set-points, (n,) [rad or m, per s]
        effort: efforts of joints under open-loop control, (n,) [N m or N]
        modes: POSITION, EFFORT or SET, (n,)
        gains: P, I, D, (n, 3)
        limit: largest efforts, (n,) [N m or N]
        locked: whether each joint's brake holds it, (n,) bool
        fingers: joints without a motor, which a person's fingers move, (n,) bool
    """

    def __init__(self, rig_arm: RigArm, servos: Servos, data: mujoco.MjData) -> None:
        self.arm = rig_arm.arm
        self.index = servos.table.arms[rig_arm.name]
        self.welded = not len(self.index.hinges)
        self.brakes = self.arm.type == "SUJ"
        self._servos, self._data = servos, data
        count, rows = len(self.arm.joints), self.index.rows
        if self.welded:
            self.position, self.velocity, self.effort = np.zeros((3, count))
            self.modes, self.gains = np.zeros(count, np.int8), np.zeros((count, 3))
            self.limit, self.locked = np.zeros(count), np.full(count, self.brakes)
            self.fingers = np.zeros(count, np.bool_)
        else:
            self.position, self.velocity = servos.setpoint[rows, 0], servos.setpoint[rows, 1]
            self.effort = servos.commanded[rows]
            self.modes, self.gains = servos.modes[rows], servos.gains[rows]
            self.limit, self.locked = servos.limit[rows], servos.locked[rows]
            self.fingers = servos.table.fingers[rows]
        self._act, self._qpos = data.act[rows], data.qpos
        self._drive = servos.table.drive[rows]
        self._holding = servos.holding[rows]
        self._motors = MotorEffort(servos.table, rows)
        self._still = np.zeros((3, count))
        self._read = np.zeros((0, 0))
        self._revision = self._labelled = -1
        self._labels: tuple[tuple[Mode, ...], tuple[bool, ...]] = (), ()

    # ------------------------------------------------------------------ read

    def read(self) -> Array:
        """Return measured positions, velocities and efforts of every joint, (3, n).

        Efforts are what the motors exert, gravity compensation included; nothing without power,
        though a brake then holds the arm.
        """
        if self.welded:
            self._still[0] = self.position
            return self._still.copy()
        if self._revision != self._servos.revision:
            self._refresh()
        found = self._read.dot(self._servos.state()).reshape(3, -1)
        self._motors.limit(found[2], found[1])
        return found

    def positions(self) -> Array:
        """Return measured positions, (n,) [rad or m]."""
        if self.welded:
            return self.position.copy()
        errors = self._servos.errors
        return self._drive.dot(self._qpos if errors is None else errors.qpos())

    def load(self) -> Array:
        """Return the efforts that hold the links' weight, renewed with it, (n,)."""
        return np.zeros(len(self.position)) if self.welded else self._holding.copy()

    def frame_coordinates(self) -> Array:
        """Return every frame's own coordinate as the simulation has it, (n_frames,)."""
        found = np.zeros(len(self.arm.mechanism.frames))
        found[self.index.hinges] = self._data.qpos[self.index.qpos]
        return found

    @property
    def powered(self) -> bool:
        """Whether the motors have power; without it the arm is held as by a brake."""
        return self.welded or bool(self._servos.powered[self.index.rows].all())

    @property
    def gravity_compensated(self) -> bool:
        """Whether the motors carry the links' weight."""
        return bool(np.count_nonzero(self._servos.balanced[self.index.rows]))  # any() takes 1 us

    @property
    def torque_computed(self) -> bool:
        """Whether the servos get computed torque."""
        return bool(self._servos.computed[self.index.rows].any())

    def labels(self) -> tuple[tuple[Mode, ...], tuple[bool, ...]]:
        """Return the modes of all joints by name, and which brakes are locked."""
        if self._labelled != self._servos.revision:
            self._labels = tuple(MODES[mode] for mode in self.modes), tuple(self.locked.tolist())
            self._labelled = self._servos.revision
        return self._labels

    def mode(self, joint: int) -> Mode:
        """Return a joint's control mode by name."""
        return MODES[int(self.modes[joint])]

    # ------------------------------------------------------------------ write

    def put(self, q: Array, v: Array) -> None:
        """Put the joints at positions with velocities, loops closed, (n,) each."""
        if not self.welded:
            self._put(q, v)

    def place(self, q: Array, v: Array) -> None:
        """Put the arm at joint positions with velocities, at rest inside, (n,) each."""
        if not self.welded:
            self._put(q, v)
            self._forget(range(len(q)))
        self.command(q, v)

    def command(self, q: Array, v: Array) -> None:
        """Write set-points, (n,) each [rad or m, per s]."""
        self.position[:] = q
        self.velocity[:] = v
        self.follow()

    def follow(self) -> None:
        """Put joints in mode "set" at their set-points, with everything that their loops move."""
        kinematic = (self.modes == SET) & ~self.locked
        if kinematic.any():
            q, v, _ = self.read()
            self._put(np.where(kinematic, self.position, q), np.where(kinematic, self.velocity, v))

    def command_effort(self, effort: Array) -> None:
        """Write efforts of the joints in mode "effort", (n,) [N m or N]; others ignore theirs."""
        if not self.welded:
            open_loop = (self.modes == EFFORT) & ~self.fingers
            kept = np.where(self.fingers, self.effort, 0.0)
            self.effort[:] = np.where(open_loop, effort, kept)
            self._servos.write_efforts()

    def finger(self, mode: int, q: float, effort: float) -> None:
        """Put fingers to the last joint: they hold it at q with an effort, or just exert it."""
        self.modes[-1] = mode
        self._servos.apply()
        self.position[-1], self.velocity[-1], self.effort[-1] = q, 0.0, effort
        self._servos.write_efforts()

    def set_mode(self, mode: int, which: Iterable[int]) -> None:
        """Change the mode of joints; all hold their set-points, and those start without effort."""
        chosen = list(which)
        self.modes[chosen] = mode
        self._forget(chosen)
        self.apply()
        self.command(self.position, np.zeros(len(self.position)))

    def set_gains(self, joint: int, gains: Array) -> None:
        """Change P, I, D of a joint, (3,)."""
        self.gains[joint] = gains
        self.apply()

    def set_brakes(self, locked: bool, which: Iterable[int]) -> None:
        """Lock joints where they are, or release them to their servos."""
        chosen = list(which)
        self.locked[chosen] = locked
        self._forget(chosen)
        self.apply()

    def switch(self, powered: bool) -> None:
        """Switch the motors' power on, or off and hold the arm where it is; brakes are engaged."""
        if not self.welded:
            rows = self.index.rows
            self._servos.powered[rows] = powered
            self._servos.engaged[rows] = self._servos.table.brake[rows] > 0.0
            self._forget(range(len(self.position)))
            self.apply()

    @property
    def engaged(self) -> Bools:
        """Mask of the brakes that are engaged, (n,), a view; setup joints have `locked`."""
        return self._servos.engaged[self.index.rows]

    def release(self) -> None:
        """Release the brakes of an arm that has power."""
        self._servos.engaged[self.index.rows] = False
        self.apply()

    def compensate_gravity(self, on: bool) -> None:
        """Switch gravity compensation; setup joints are counterbalanced and always have it."""
        self._servos.balanced[self.index.rows] = ~self.fingers & (on or self.brakes)
        self._servos.write_efforts()

    def compute_torque(self, on: bool) -> None:
        """Switch computed torque of all joints that have a motor."""
        rows = self.index.rows
        self._servos.computed[rows] = ~self.fingers & on
        self._servos.before[rows] = self._servos.setpoint[rows, 1]
        self._servos.forget(np.arange(len(self._servos.limit))[rows])
        self._servos.write_efforts()

    def apply(self) -> None:
        """Write modes, gains, brakes and limits into the model."""
        if not self.welded:
            self._servos.apply()

    # ------------------------------------------------------------------ inside

    def _refresh(self) -> None:
        """Refresh this arm's rows of READ after a change."""
        read, servos = self._servos.matrix(), self._servos
        own, count = self.index.rows, len(servos.limit)
        rows = np.arange(int(own.start), int(own.stop))
        self._read = read[np.concatenate([rows, rows + count, rows + 2 * count])]
        self._motors.renew(servos.lower[own], servos.upper[own])
        self._revision = self._servos.revision

    def _put(self, q: Array, v: Array) -> None:
        if self._servos.errors is not None:
            q = q - self._servos.errors.error[self.index.rows]
        where = coordinates(self.arm.mechanism, q)
        index = self.index
        self._data.qpos[index.qpos] = where[index.hinges]
        self._data.qvel[index.dof] = 0.0
        if np.count_nonzero(v):
            rates = coordinate_rates(self.arm.mechanism, where) @ v
            self._data.qvel[index.dof] = rates[index.hinges]
        # What the last step's forces did is no longer true; sensors look for this mark.
        self._data.qacc[index.dof] = np.nan

    def _forget(self, which: Iterable[int]) -> None:
        chosen = [i for i in which if not self.fingers[i]]
        if not self.welded and chosen:
            self._act[chosen] = 0.0
            self.effort[chosen] = 0.0
            self._servos.forget(self.index.rows.start + np.array(chosen))
            self._servos.write_efforts()
