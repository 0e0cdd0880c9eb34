"""Play tables of set-points: checked once, written row by row, sampled as it goes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.errors import InputError, UnknownNameError
from trocar.simulation.arm import Arm
from trocar.simulation.drives import INPUTS, UNLIMITED, Drives
from trocar.simulation.records import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Table:
    """Checked inputs of every servo, (k, nu, 3), and how many samples were clipped."""

    inputs: Array
    played: tuple[str, ...]
    clipped: dict[str, int]


class Player:
    """Writes tables into the servos and keeps the motors' effort within limits."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        rig: RigDescription,
        drives: Mapping[str, Drives],
    ) -> None:
        self._model, self._data = model, data
        self._drives = {name: d for name, d in drives.items() if not d.welded}
        self._names = tuple(a.name for a in rig.arms)
        self._inputs = data.ctrl.reshape(model.nu // INPUTS, INPUTS)
        self._share = np.zeros((model.nu // INPUTS, model.nv))
        self._limit = np.full(len(self._share), UNLIMITED)
        self.read_limits()
        for d in self._drives.values():
            self._share[np.ix_(d.binding.actuators, d.binding.dof)] = d.binding.share

    def read_limits(self) -> None:
        """Take over the motors' effort limits."""
        for d in self._drives.values():
            self._limit[d.binding.actuators] = d.effort_limit

    def limit_efforts(self) -> None:
        """Leave each servo what gravity compensation takes of its motor's limit."""
        limit = self._limit
        weight = self._share @ self._data.qfrc_gravcomp
        self._model.actuator_forcerange[:, 0] = -limit - weight
        self._model.actuator_forcerange[:, 1] = limit - weight

    def table(
        self,
        positions: Mapping[str, Array],
        velocities: Mapping[str, Array],
        efforts: Mapping[str, Array],
    ) -> Table:
        """Check and clip set-points of some arms; the others hold theirs.

        Raises:
            UnknownNameError: no such arm
            InputError: wrong shape, NaN or infinity
        """
        rows = {len(np.asarray(p)) for p in positions.values()}
        if len(rows) != 1:
            raise InputError(f"play: got tables of {sorted(rows)} rows; allowed: one length")
        count = rows.pop()
        inputs = np.tile(self._inputs, (count, 1, 1))
        inputs[:, :, 1] = 0.0
        clipped: dict[str, int] = {}
        for name, wanted in positions.items():
            if name not in self._drives:
                raise UnknownNameError("arm", name, self._drives, "play")
            d = self._drives[name]
            mechanism = d.arm.mechanism
            target = _checked(name, wanted, (count, len(mechanism.joints)), "positions")
            inside = np.clip(target, mechanism.lower, mechanism.upper)
            clipped[name] = int((inside != target).any(axis=1).sum())
            used = d.binding.actuators
            inputs[:, used, 0] = inside
            if name in velocities:
                inputs[:, used, 1] = _checked(name, velocities[name], target.shape, "velocities")
            if name in efforts:
                wanted_efforts = _checked(name, efforts[name], target.shape, "efforts")
                open_loop = np.array([mode == "effort" for mode in d.modes])
                inputs[:, used, 2] = np.where(open_loop, wanted_efforts, 0.0)
        return Table(inputs, tuple(positions), clipped)

    def run(
        self,
        table: Table,
        every: int,
        record: bool,
        advance: Callable[[int], None],
        arms: Mapping[str, Arm],
    ) -> Recording:
        """Write each row, advance, sample."""
        count = len(table.inputs) if record else 0
        times = np.zeros(count)
        qpos, qvel = np.zeros((count, self._model.nq)), np.zeros((count, self._model.nv))
        act, weight = np.zeros((count, self._model.na)), np.zeros((count, self._model.nv))
        data, inputs = self._data, self._inputs
        for row, wanted in enumerate(table.inputs):
            inputs[:] = wanted
            advance(every)
            if record:
                times[row] = data.time
                qpos[row], qvel[row] = data.qpos, data.qvel
                act[row], weight[row] = data.act, data.qfrc_gravcomp
        for name in table.played:
            used = self._drives[name].binding.actuators
            arms[name].note_setpoint(table.inputs[-1, used, 0], table.inputs[-1, used, 1])
        return self._recording(times, (qpos, qvel, act, weight), table)

    def _recording(
        self, times: Array, samples: tuple[Array, Array, Array, Array], table: Table
    ) -> Recording:
        qpos, qvel, act, weight = samples
        inputs = table.inputs[: len(times)]
        positions: dict[str, Array] = {}
        velocities: dict[str, Array] = {}
        efforts: dict[str, Array] = {}
        coordinates: dict[str, Array] = {}
        for name, d in self._drives.items():
            b = d.binding
            positions[name] = qpos[:, b.qpos] @ b.drive.T
            velocities[name] = qvel[:, b.dof] @ b.drive.T
            state = (positions[name], velocities[name], act[:, b.act])
            weights = weight[:, b.dof] @ b.share.T
            efforts[name] = d.servo_efforts(inputs[:, b.actuators], state, weights)
            coordinates[name] = np.zeros((len(times), len(d.arm.mechanism.frames)))
            coordinates[name][:, b.hinges] = qpos[:, b.qpos]
        return Recording(times, positions, velocities, efforts, coordinates, table.clipped)


def _checked(name: str, values: Array, shape: tuple[int, int], what: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"play: {name}: got {what} of shape {array.shape}; allowed: {shape}")
    if not np.isfinite(array).all():
        row = int(np.argmin(np.isfinite(array).all(axis=1)))
        raise InputError(
            f"play: {name}: {what} must be finite, got {array[row].tolist()} in row {row}"
        )
    return array
