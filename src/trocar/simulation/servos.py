"""All servos of a world: set-points, modes, gains and brakes, and the one read-out of joints."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.modeling.joints import INPUTS, JointTable
from trocar.simulation.brake_friction import BrakeFriction
from trocar.simulation.computed_torque import ComputedTorque
from trocar.simulation.disturbance_observers import DisturbanceObservers
from trocar.simulation.reading_errors import ReadingErrors

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

#: Control modes of a joint, as small integers in `Servos.modes`.
POSITION, EFFORT, SET = 0, 1, 2
#: Damping of a joint that its brake or the mode "set" holds: a column under its 300 N creeps 1 pm
#: an hour. Source: our own choice; a constraint per brake would cost the cart 10 % of its speed
#: (measured). [N m s/rad or N s/m]
HOLDING_DAMPING = 1e18
#: Attributes that determine gains, brakes and limits in the model.
WRITTEN = ("modes", "gains", "limit", "locked", "powered", "engaged")
#: Attributes that servos save beside the physics state.
SAVED = (*WRITTEN, "balanced", "computed", "commanded", "holding", "before")
#: The part of the physics state that joints are read from, in this order.
READ_STATE = int(
    mujoco.mjtState.mjSTATE_QPOS
    | mujoco.mjtState.mjSTATE_QVEL
    | mujoco.mjtState.mjSTATE_ACT
    | mujoco.mjtState.mjSTATE_CTRL
)


def pid_effort(gains: Array, setpoint: Array, integral: Array, q: Array, qd: Array) -> Array:
    """Return the servos' efforts before they are limited: P e + I integral + D de + feed-forward.

    The integrator is implicit in the servos: what acts during a step is their force at its end.
    MuJoCo's `actuator_force` is the one at its beginning, which is wrong by (P v + D a) dt: 1.2 N
    at 0.2 m/s on the insertion, more than its friction.

    Args:
        gains: P, I, D, (..., J, 3)
        setpoint: position, velocity and effort fed forward, (..., J, 3)
        integral, q, qd: of the position error; measured positions and velocities, (..., J)
    """
    p, i, d = gains[..., 0], gains[..., 1], gains[..., 2]
    servo = p * (setpoint[..., 0] - q) + i * integral + d * (setpoint[..., 1] - qd)
    return servo + setpoint[..., 2]


def read_matrix(table: JointTable, gains: Array, sizes: tuple[int, int]) -> Array:
    """Return READ with (q; qd; effort before the limits) = READ @ (qpos; qvel; act; ctrl).

    `pid_effort` applied to unit vectors: (3 J, nq + nv + 4 J).

    Args:
        table: the joints
        gains: as they act, 0 where no servo does, (J, 3)
        sizes: nq, nv
    """
    (nq, nv), count = sizes, len(table)
    unit = np.eye(nq + nv + (1 + INPUTS) * count)
    velocity, integral, inputs = nq, nq + nv, nq + nv + count
    q, qd = unit[:, :velocity] @ table.drive.T, unit[:, velocity:integral] @ table.rate.T
    setpoint = unit[:, inputs:].reshape(len(unit), count, INPUTS)
    effort = pid_effort(gains, setpoint, unit[:, integral:inputs], q, qd)
    return np.ascontiguousarray(np.concatenate([q, qd, effort], axis=1).T)


class MotorEffort:
    """The efforts that motors exert when their servos call for some.

    Within limits, less what back-EMF takes at speed: slope (qd - clip(qd, -corner, corner)).

    Args:
        table: the joints
        rows: which of them
    """

    def __init__(self, table: JointTable, rows: slice) -> None:
        self.renew(np.zeros(0), np.zeros(0))
        self._slope, self._corner = table.slope[rows], table.corner[rows]
        self._slowest = float(self._corner.min(initial=np.inf)) ** 2

    def renew(self, lower: Array, upper: Array) -> None:
        """Set the limits of efforts as they act, (..., n) [N m or N]; they may change in place."""
        self._lower, self._upper = lower, upper

    def limit(self, effort: Array, qd: Array) -> None:
        """Limit the efforts that servos call for at speeds, in place, (..., n) each."""
        np.minimum(effort, self._upper, out=effort)
        np.maximum(effort, self._lower, out=effort)
        if qd.ndim > 1 or qd.dot(qd) > self._slowest:  # else no joint is fast enough
            effort -= self._slope * (qd - np.clip(qd, -self._corner, self._corner))


class Servos:
    """The servos of one MjData, in the rows of its joint table.

    Args:
        table: the joints
        model: of this world alone: gains, brakes and limits are written into it
        data: the physics state
        errors: of the encoders, None for none

    Attributes:
        setpoint: position, velocity and effort fed forward, (J, 3); a view of `ctrl`, where there
            are no errors
        errors: as given
        modes: POSITION, EFFORT or SET, (J,)
        gains: P, I, D, (J, 3)
        limit: largest efforts, (J,) [N m or N]
        locked, powered: brakes that hold; motors that have power, (J,) bool
        balanced: servos that get gravity compensation, (J,) bool
        computed: servos that get computed torque, which carries the weight as well, (J,) bool
        commanded: efforts of joints under open-loop control, (J,) [N m or N]
        holding: efforts that hold every motor's load, computed last, (J,) [N m or N]
        feed: the sum that is fed forward, see `write_efforts`, a view of `setpoint`, (J,)
        plain: whether the sum is all that `write_efforts` writes
        before: velocities of the set-points at the last physics step with computed torque, (J,)
        engaged: brakes of arms that hold against their motors, (J,) bool
        lower, upper: limits of efforts as they act, (J,) each [N m or N]
        disturbance: disturbance observers, None without any
        revision: counts the changes of modes, gains, brakes and limits
    """

    def __init__(
        self,
        table: JointTable,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        errors: ReadingErrors | None = None,
    ) -> None:
        self.table, self._model, self._data, self.errors = table, model, data, errors
        count = len(table)
        ctrl: Array = data.ctrl.reshape(count, INPUTS)
        self._ctrl, self._force = ctrl, data.actuator_force
        self.setpoint = ctrl if errors is None else errors.setpoint
        self.feed = self.setpoint[:, 2]
        self.modes = np.where(table.fingers, EFFORT, POSITION).astype(np.int8)
        self.gains, self.limit = table.gains.copy(), table.effort_max.copy()
        self.locked, self.powered = table.braked.copy(), np.ones(count, np.bool_)
        self.balanced = ~table.fingers & (table.compensated | table.braked)
        self.commanded, self.holding, self.before = np.zeros((3, count))
        self.computed, self.engaged = np.zeros((2, count), np.bool_)
        self.lower, self.upper = np.zeros((2, count))
        self._capped = np.isfinite(table.output_max)
        self._caps = bool(self._capped.any())
        #: Rows of servos whose PID and observer are capped now, their caps and motors' limits.
        self._bounds = np.zeros(0, np.intp), np.zeros(0), np.zeros(0)
        self._bound_revision, self._ranges = -1, model.actuator_forcerange
        self.plain = not self._caps
        #: Joints whose limits in the model are not always those of their motors.
        self._ranged = np.flatnonzero(self._capped | (table.brake > 0.0))
        self.disturbance = None
        if (table.observer[:, 1] > 0.0).any():
            self.disturbance = DisturbanceObservers(table, float(model.opt.timestep))
            self.plain = False
            self._found_now = np.zeros(3 * len(self.disturbance.rows))
            self._views = self.disturbance.views(self._found_now)
            first, last = self.disturbance.joints[[0, -1]].tolist()
            #: The joints of observers; a slice, which is quicker, where no other is between them.
            self._watched: slice | Index = slice(first, last + 1)
            if last - first >= len(self.disturbance.joints):
                self._watched = self.disturbance.joints
        watched = (0, 0) if self.disturbance is None else self.disturbance.coupled.shape
        #: State of the observers; the rest that is fed forward to their joints, and that of the
        #: last step.
        self._observed, (self._steady, self._fed) = np.zeros(watched[0]), np.zeros((2, watched[1]))
        self._observing: Array | None = None
        #: Matrix of the observers' readings, and the columns of READ that it has.
        self._observer_matrix, self._seen = np.zeros((0, 0)), np.arange(0)
        self._observed_revision = -1
        self._computed_torque: ComputedTorque | None = None
        self.revision = 0
        self._turned = np.zeros((count, model.nv), np.bool_)
        self._brakes = BrakeFriction(table, model) if table.brake.any() else None
        self._braked: list[tuple[slice, int]] = []
        for arm in table.arms.values():
            self._turned[arm.rows, arm.dof] = arm.turned
            if table.braked[arm.rows].any():
                self._braked.append((arm.rows, 1 << arm.group))
        self._dry = model.dof_frictionloss.copy()
        self._viscous = model.dof_damping.copy()
        self._state = np.zeros(mujoco.mj_stateSize(model, READ_STATE))
        self._read = np.zeros((0, 0))
        self._motors = MotorEffort(table, slice(None))
        self._motors.renew(self.lower, self.upper)
        self._read_revision = -1
        self._written: tuple[bytes, ...] = ()

    # ------------------------------------------------------------------ read

    @property
    def driven(self) -> Bools:
        """Mask of the joints that a motor or fingers act on, (J,); none under a brake."""
        return (self.table.fingers | self.powered) & ~self.locked

    @property
    def servoed(self) -> Bools:
        """Mask of the joints that their servos drive, (J,)."""
        return (self.modes == POSITION) & self.driven

    @property
    def effective(self) -> tuple[Array, Array]:
        """Gains (J, 3) and limits (J,) as they act: 0 where no servo, or nothing, does."""
        gains = self.gains * self.servoed[:, None]
        return gains, np.where(self.driven, self.limit, 0.0)

    def matrix(self) -> Array:
        """Return READ as of now, (3 J, n); `lower` and `upper` are as of now, too."""
        if self._read_revision != self.revision:
            gains, limits = self.effective
            self._bound(limits)
            sizes = self._model.nq, self._model.nv
            self._read = read_matrix(self.table, gains, sizes)
            self._read_revision = self.revision
        return self._read

    def read(self, out: Array | None = None) -> Array:
        """Return measured positions, velocities and efforts of every joint, (3, J)."""
        return self._found(self.state(), out)

    def true(self) -> Array:
        """Return true positions, velocities and efforts of every joint, (3, J)."""
        mujoco.mj_getState(self._model, self._data, self._state, READ_STATE)
        return self._found(self._state)

    def state(self, out: Array | None = None) -> Array:
        """Return the factor of READ, in `out` or a buffer that the next call overwrites."""
        found = self._state if out is None else out
        mujoco.mj_getState(self._model, self._data, found, READ_STATE)
        if self.errors is not None:
            self.report(found)
        return found

    def report(self, state: Array) -> None:
        """Overwrite a copy of the physics state, from `qpos` to `ctrl`, with what robots report."""
        if self.errors is not None:
            nq, nv = self._model.nq, self._model.nv
            self.errors.report(state[:nq], state[nq : nq + nv], state[-self.setpoint.size :])

    def qpos(self) -> Array:
        """Return the coordinates as the encoders report them, (nq,); not to be written to."""
        return self._data.qpos if self.errors is None else self.errors.qpos()

    def _found(self, state: Array, out: Array | None = None) -> Array:
        read = self.matrix()
        count, nq, nv = len(self.table), self._model.nq, self._model.nv
        found = np.empty((3, count)) if out is None else out
        q, qd, effort = found
        self.table.drive.dot(state[:nq], out=q)  # READ is zero beside these blocks
        self.table.rate.dot(state[nq : nq + nv], out=qd)
        read[2 * count :].dot(state, out=effort)
        self._motors.limit(effort, qd)
        return found

    # ------------------------------------------------------------------ write

    def write_efforts(self) -> None:
        """Write commanded and balancing efforts into the servos."""
        gravity = self.balanced * self.holding
        np.add(self.commanded, gravity, out=self.feed)
        if self.disturbance is not None:
            self._steady = self.feed[self.disturbance.joints]
        if self._caps and self._bound_revision != self.revision:
            self._write_ranges()
        elif self._caps:
            rows, lower, upper = self._around(gravity)
            self._ranges[rows, 0] = lower
            self._ranges[rows, 1] = upper

    def observe_disturbance(self) -> None:
        """Write the efforts of disturbance observers into the servos, for one step.

        MuJoCo's `actuator_force` is the effort of the last step as of its beginning, limited: that
        of PID and observer, and what was fed forward.
        """
        observers = self.disturbance
        if observers is None:
            return
        if self._observed_revision != self.revision:
            self._observing = observers.acting(self.servoed & ~self.computed)
            matrix = observers.matrix(self.matrix())
            self._seen = np.flatnonzero(matrix.any(axis=0))
            self._observer_matrix = np.ascontiguousarray(matrix[:, self._seen])
            self._observed_revision = self.revision
        joints = self._watched
        effort = self._force[joints] - self._fed
        mujoco.mj_getState(self._model, self._data, self._state, READ_STATE)
        self._observer_matrix.dot(self._state.take(self._seen), out=self._found_now)
        added = observers.observe(self._observed, effort, self._views, self._observing)
        self._fed = self._steady
        added += self._steady
        self.feed[joints] = added
        if self.errors is not None:
            self._ctrl[joints, 2] = added

    def observations(self) -> Array:
        """Return states of observers, and efforts of PID and observer at joints, (2, J)."""
        found = np.zeros((2, len(self.table)))
        if self.disturbance is not None:
            joints = self.disturbance.joints
            found[0, self.disturbance.rows] = self._observed
            found[1, joints] = self._force[joints] - self._fed
        return found

    def begin_observing(self, found: Array) -> None:
        """Have disturbance observers go on from what `observations` returned, (2, J)."""
        if self.disturbance is not None:
            joints = self.disturbance.joints
            self._fed = self._steady = (self.commanded + self.balanced * self.holding)[joints]
            self._observed[:] = found[0, self.disturbance.rows]
            self._force[joints] = self._fed + found[1, joints]

    def forget(self, which: Index) -> None:
        """Forget what disturbance observers found at some joints, by rows of the table."""
        if self.disturbance is not None:
            joints = self.disturbance.joints
            chosen = np.isin(joints, which)
            self._observed[self.disturbance.coupled[:, chosen].any(axis=1)] = 0.0
            self._observed_revision = -1
            self._force[joints[chosen]] = self._fed[chosen]

    def compute_torque(self) -> None:
        """Write the efforts of computed torque into the servos that have it, for one step."""
        if self._computed_torque is None:
            self._computed_torque = ComputedTorque(self.table, self._model)
        ctrl, data = self._data.ctrl.reshape(self.setpoint.shape), self._data
        acceleration = (self.setpoint[:, 1] - self.before) / float(self._model.opt.timestep)
        self.before[:] = self.setpoint[:, 1]
        efforts = self._computed_torque.efforts(
            (data.qpos, data.qvel), ctrl, self.effective[0], acceleration
        )
        which = self.computed & self.servoed
        self.feed[which] = ctrl[which, 2] = efforts[which]

    def apply(self) -> None:
        """Write modes, gains, brakes and limits into the model, where they changed."""
        now = tuple(getattr(self, name).tobytes() for name in WRITTEN)
        if now == self._written:
            return
        self._written = now
        self.revision += 1
        model, table = self._model, self.table
        gains, still = self.gains * self.servoed[:, None], self.locked | (self.modes == SET)
        own = slice(len(table))
        model.actuator_biasprm[own, 1] = -gains[:, 0]
        model.actuator_gainprm[own, 0] = gains[:, 1]
        model.actuator_biasprm[own, 2] = -gains[:, 2]
        self._ranges[own, 0] = -self.limit
        self._ranges[own, 1] = self.limit
        self._write_ranges()
        bare = ~self.powered & (table.brake == 0.0)
        held = self._turned[(still | bare) & ~table.fingers].any(axis=0)
        model.dof_damping[:] = np.where(held, HOLDING_DAMPING, self._viscous)
        locked = self._turned[self.locked].any(axis=0)  # spare the physics what brakes hold
        model.dof_frictionloss[:] = np.where(locked, 0.0, self._dry)
        if self._brakes is not None:
            self._brakes.engage(model, self.engaged)
        for rows, group in self._braked:
            bit = group if self.locked[rows].all() else 0
            model.opt.disableactuator = model.opt.disableactuator & ~group | bit

    def _bound(self, limits: Array) -> None:
        """Set the limits of efforts: of motors, and of PID and observer beside gravity's."""
        self.lower[:], self.upper[:] = -limits, limits
        if self._caps:
            rows = np.flatnonzero(self._capped & self.servoed)
            self._bounds = rows, self.table.output_max[rows], limits[rows]
            self._around(self.balanced * self.holding)

    def _around(self, gravity: Array) -> tuple[Index, Array, Array]:
        """Set the limits of servos whose PID and observer are capped, and return them.

        Args:
            gravity: efforts of gravity compensation, (J,) [N m or N]
        """
        rows, most, limit = self._bounds
        carried = gravity[rows]
        lower = np.minimum(np.maximum(carried - most, -limit), limit)
        upper = np.minimum(np.maximum(carried + most, -limit), limit)
        self.lower[rows], self.upper[rows] = lower, upper
        return rows, lower, upper

    def _write_ranges(self) -> None:
        """Write the limits of efforts into the model, where they are not always the motors'."""
        rows = self._ranged
        if not len(rows):
            return
        self._bound(self.effective[1])
        self._bound_revision = self.revision
        self._ranges[rows, 0] = self.lower[rows]
        self._ranges[rows, 1] = self.upper[rows]

    @property
    def friction(self) -> tuple[Array, Array]:
        """Dry and viscous friction of the degrees of freedom without brakes, copies, (nv,)."""
        return self._dry.copy(), self._viscous.copy()

    def set_friction(self, dry: Array, viscous: Array) -> None:
        """Set the friction of the degrees of freedom that no brake holds; `apply` writes it.

        Args:
            dry: (nv,) [N m or N]
            viscous: (nv,) [N m s/rad or N s/m]
        """
        self._dry, self._viscous = dry, viscous
        self._written = ()

    def restore(self) -> None:
        """Reset to the table's values; set-points and the model are left to the caller."""
        table = self.table
        self.modes[:] = np.where(table.fingers, EFFORT, POSITION)
        self.gains[:], self.limit[:] = table.gains, table.effort_max
        self.locked[:], self.powered[:] = table.braked, True
        self.balanced[:] = ~table.fingers & (table.compensated | table.braked)
        self.computed[:] = self.engaged[:] = False
        self.commanded[:] = self.holding[:] = self.before[:] = 0.0
        self._observed[:] = 0.0

    def save(self) -> dict[str, Array]:
        """Return copies of everything that is set, by name."""
        found: dict[str, Array] = {name: getattr(self, name).copy() for name in SAVED}
        if self.disturbance is not None:
            found["observations"] = self.observations()
        return found

    def load(self, saved: Mapping[str, Array]) -> None:
        """Restore everything that `save` returned and write it into the model."""
        for name in SAVED:
            getattr(self, name)[:] = saved.get(name, False)  # older states lack brakes of arms
        self.apply()
        self._write_ranges()
        if self.disturbance is not None:
            self.begin_observing(saved["observations"])
