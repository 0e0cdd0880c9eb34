"""Play tables of set-points: checked once, written row by row, sampled as it goes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError, UnknownNameError
from trocar.simulation.arm import Arm
from trocar.simulation.control import LARGEST
from trocar.simulation.records import Recording
from trocar.simulation.servos import EFFORT, SET, Servos

Array = NDArray[np.float64]


#: Velocities of a table, and of `set_state`, are at most so many times the limits that moves keep
#: to, and FASTEST where these have none: recordings of fast motion are faster than moves. Source:
#: our own choice; joints that are put to much faster motion diverge.
FASTER = 10.0
FASTEST = 100.0


def fastest(arm: ArmDescription) -> Array:
    """Return the largest velocities that tables and states of an arm may have, (n,)."""
    most = np.array([joint.velocity_max for joint in arm.joints])
    return np.where(np.isfinite(most), FASTER * most, FASTEST)


@dataclass(frozen=True, eq=False)
class SetpointTable:
    """Checked set-points of every servo, (k, n_servos, 2), and efforts, (k, n_servos) or None."""

    setpoints: Array
    efforts: Array | None
    played: tuple[str, ...]
    clipped: dict[str, int]


class SetpointPlayer:
    """Writes tables into the servos and samples what comes of it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        servos: Servos,
        arms: Mapping[str, Arm],
    ) -> None:
        self._model, self._data = model, data
        self._motors = {
            name: arm.runtime.motors for name, arm in arms.items() if not arm.runtime.motors.welded
        }
        self._servos = servos
        self._fastest = {name: fastest(motors.arm) for name, motors in self._motors.items()}

    def table(
        self,
        positions: Mapping[str, Array],
        velocities: Mapping[str, Array],
        efforts: Mapping[str, Array],
    ) -> SetpointTable:
        """Check and clip set-points of some arms; the others hold theirs.

        Raises:
            UnknownNameError: no such arm
            InputError: wrong shape, NaN or infinity; an arm that cannot follow
        """
        rows = {1 if np.isscalar(p) else len(p) for p in positions.values()}
        if len(rows) != 1 or rows == {0}:
            raise InputError(
                f"play: got tables of {sorted(rows)} rows; allowed: one length, above 0"
            )
        for name in (*velocities, *efforts):
            if name not in positions:
                raise InputError(f"play: {name}: got no positions beside its other tables")
        count = rows.pop()
        setpoints = np.zeros((count, len(self._servos.setpoint), 2))
        setpoints[:, :, 0] = self._servos.setpoint[:, 0]
        open_loop = np.tile(self._servos.commanded, (count if efforts else 0, 1))
        clipped: dict[str, int] = {}
        for name, values in positions.items():
            if name not in self._motors:
                raise UnknownNameError("arm", name, self._motors, "play")
            d = self._motors[name]
            if (d.modes == SET).any():
                raise InputError(f'play: {name}: joints in mode "set" follow servo_jp only')
            if d.locked.any():
                raise InputError(f"play: {name}: the brakes are locked; release them first")
            mechanism = d.arm.mechanism
            target = _checked(name, values, (count, len(mechanism.joints)), "positions")
            inside = np.clip(target, mechanism.lower, mechanism.upper)
            clipped[name] = int((inside != target).any(axis=1).sum())
            used = d.index.rows
            setpoints[:, used, 0] = inside
            if name in velocities:
                speed = _checked(name, velocities[name], target.shape, "velocities")
                most = self._fastest[name]
                if (np.abs(speed) > most).any():
                    row = int(np.argmax((np.abs(speed) > most).any(axis=1)))
                    raise InputError(
                        f"play: {name}: got velocities {speed[row].tolist()} in row {row}; allowed:"
                        f" up to {most.tolist()}"
                    )
                setpoints[:, used, 1] = speed
            if name in efforts:
                effort = _checked(name, efforts[name], target.shape, "efforts")
                open_loop[:, used] = effort
        return SetpointTable(setpoints, open_loop if efforts else None, tuple(positions), clipped)

    def run(
        self,
        table: SetpointTable,
        every: int,
        record: bool,
        advance: Callable[[int], None],
        arms: Mapping[str, Arm],
    ) -> Recording:
        """Write each row, advance, sample. Moves under way end; their arms hold.

        Raises:
            InputError: `every` is no whole number above 0
            DivergedError: the simulation left the finite numbers
        """
        if isinstance(every, bool) or not isinstance(every, (int, np.integer)) or every < 1:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
            raise InputError(f"play: got every={every!r}; allowed: a whole number above 0")
        for name, arm in arms.items():
            run = arm.runtime
            moving = run.active or run.motors.velocity.any()
            if moving and (run.active or name not in table.played):
                run.states.stop()  # else its set-points follow the last ones
        for name in table.played:
            run = arms[name].runtime
            run.forces.end()
            run.control.under_position(run.every)
        if table.efforts is not None:
            self._leave_to_servos(table.efforts, table.played)
        begin = self._data.time
        samples = np.zeros((len(table.setpoints) if record else 0, len(self._servos.state())))
        setpoints = self._servos.setpoint[:, :2]
        for row, setpoint in enumerate(table.setpoints):
            setpoints[:] = setpoint
            if table.efforts is not None:
                self._servos.commanded[:] = table.efforts[row]
                self._servos.write_efforts()
            advance(every)
            if record:
                self._servos.state(samples[row])
        for name in table.played:
            used = self._motors[name].index.rows
            last = table.setpoints[-1, used]
            run, effort = arms[name].runtime, self._servos.commanded[used].copy()
            if run.control.states.powered:
                run.control.put(last[:, 0])
                run.motors.velocity[:], run.motors.effort[:] = last[:, 1], effort
        steps = np.full(len(samples) * every + 1, self._model.opt.timestep)
        steps[0] = begin
        return self._recording(np.add.accumulate(steps)[every::every], samples, table.clipped)

    def _leave_to_servos(self, efforts: Array, played: tuple[str, ...]) -> None:
        """Blank the efforts of joints that are not in mode "effort", now that all modes are."""
        for name in played:
            d = self._motors[name]
            efforts[:, d.index.rows][:, d.modes != EFFORT] = 0.0

    def _recording(self, times: Array, samples: Array, clipped: dict[str, int]) -> Recording:
        """Take samples of the state apart."""
        if not len(samples):
            return Recording(times, {}, {}, {}, {}, clipped)
        read = self._servos.matrix()
        lower, upper = self._servos.lower, self._servos.upper
        count = len(upper)
        found = samples @ read.T
        q, qd, effort = found[:, :count], found[:, count : 2 * count], found[:, 2 * count :]
        effort = np.clip(effort, lower, upper)
        positions: dict[str, Array] = {}
        velocities: dict[str, Array] = {}
        efforts: dict[str, Array] = {}
        coordinates: dict[str, Array] = {}
        for name, motors in self._motors.items():
            index, rows = motors.index, motors.index.rows
            positions[name], velocities[name] = q[:, rows], qd[:, rows]
            efforts[name] = effort[:, rows]
            coordinates[name] = np.zeros((len(samples), len(motors.arm.mechanism.frames)))
            coordinates[name][:, index.hinges] = samples[:, index.qpos]
        return Recording(times, positions, velocities, efforts, coordinates, clipped)


def check_playable(arm: Arm) -> None:
    """Reject a table of set-points while an arm accepts no commands.

    Raises:
        InputError: the reason
    """
    why = arm.runtime.control.states.why_not_ready()
    if why and not arm.runtime.motors.welded:
        raise InputError(f"play: {arm.name}: {why}")


def _checked(name: str, values: Array, shape: tuple[int, int], what: str) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"play: {name}: got {what} that are no numbers") from None
    if array.shape != shape:
        raise InputError(f"play: {name}: got {what} of shape {array.shape}; allowed: {shape}")
    inside = (np.abs(array) <= LARGEST).all(axis=1)  # NaN is not
    if not inside.all():
        row = int(np.argmin(inside))
        raise InputError(
            f"play: {name}: {what} must be finite, got {array[row].tolist()} in row {row}; allowed:"
            f" magnitude up to {LARGEST:g}"
        )
    return array
