"""Many states of one rig, stepped side by side on CPU threads."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch as Rows  # pyright: ignore[reportMissingTypeStubs]  it has none
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import RigArm, RigDescription
from trocar.descriptions.rig_frames import Places, pose_origin
from trocar.errors import DivergedError, InputError, UnknownNameError
from trocar.geometry.se3 import check_transform, inverse
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import nearest_solutions
from trocar.modeling.build import RigModel
from trocar.modeling.joints import INPUTS
from trocar.simulation.batch_grasps import BatchGrasps, WeldedGrasps, sensed_model
from trocar.simulation.computed_torque import ComputedTorque
from trocar.simulation.disturbance_observers import product
from trocar.simulation.drives import (
    SPRING_FIELDS,
    Drivetrains,
    SpringFields,
    Springs,
    spring_fields,
)
from trocar.simulation.frames import Frames
from trocar.simulation.objects import ObjectKinematics
from trocar.simulation.reading_errors import ReadingErrors
from trocar.simulation.servos import POSITION, MotorEffort, pid_effort, read_matrix
from trocar.simulation.supervision import (
    GRAVITY_PERIOD_S,
    STEP,
    TRACKING_PERIOD_S,
    GravityCompensation,
)
from trocar.simulation.world import World

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Model fields that the gains of one world are written into.
GAIN_FIELDS = ("actuator_biasprm", "actuator_gainprm")
LIMIT_FIELD = "actuator_forcerange"


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of n worlds after a step; J joints in the order of `Batch.names`.

    Attributes:
        time: (n,) [s]
        q, qd, effort: measured positions, velocities and efforts, (n, J)
        rejected: arms whose tip set-point could not be reached and was left out, {arm: (n,) bool}
        objects: {object: position and quaternion wxyz in the world, (n, 7)}
    """

    time: Array
    q: Array
    qd: Array
    effort: Array
    rejected: Mapping[str, NDArray[np.bool_]]
    objects: Mapping[str, Array]
    batch: Batch

    @cached_property
    def local_tips(self) -> dict[str, Array]:
        """{arm: pose of the tip in its own reference frame, (n, 4, 4)}, as `Arm.local`."""
        return self.batch.local_tips(self.q)

    @cached_property
    def tips(self) -> dict[str, Array]:
        """{arm: pose of the tip in the frame of its public poses, (n, 4, 4)}, as `measured_cp`."""
        return self.batch.tips(self.local_tips)


class Batch:
    """n worlds of one rig: set-points in, readings out, no operating states and no moves.

    Joints follow their servos with the rig's gains and gravity compensation, brakes hold, limits
    clip. A world of the batch moves as a `World` does, to the last bit, that is given the same
    set-points at the same steps, as long as no jaw holds anything: without `watch` it does here by
    friction alone, with it by the rig's model of grasps.
    Errors of the robots are those of the world that the batch begins with, in every world.

    `step` checks its arguments and returns readings; `drive`, `advance`, `put_back` and `place` are
    its parts, unchecked, for loops that do more than follow set-points.

    Args:
        rig: a world, whose model and state every world of the batch begins with; or a rig as
            `World` takes it
        n: number of worlds
        threads: CPU threads; None: one for each CPU
        seed: worlds have random generators spawned from it, for users of the batch
        watch: whether to watch the objects that jaws hold, see `grasps`

    Attributes:
        names: joints, "PSM1/yaw", ...; columns of `setpoints` and of readings
        n: number of worlds
        setpoints: positions that the servos follow, (n, J) [rad or m]; read-only
        rngs: a random generator for each world
        grasps: objects that jaws hold, by `watch`; None where no jaw can hold any
        periods: physics steps of each world since it was put back, (n,)
        tripped: actuators whose tracking errors were beyond what is allowed since then, (n, J): a
            World puts their arms into FAULT, a batch goes on

    Raises:
        InputError: n or threads is not a whole number above 0, or an object has a script
        UnknownNameError, DescriptionError: as `World` raises
    """

    def __init__(
        self,
        rig: World | RigModel | RigDescription | str | Path,
        n: int,
        *,
        threads: int | None = None,
        seed: int = 0,
        watch: bool = False,
    ) -> None:
        for name, value in (("n", n), ("threads", 1 if threads is None else threads)):
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
                raise InputError(f"Batch: got {name}={value!r}; allowed: a whole number above 0")
        world = rig if isinstance(rig, World) else World(rig)
        if scripted := [prop.name for prop in world.rig.objects if prop.script]:
            raise InputError(
                f"Batch: got a rig whose {', '.join(scripted)} has a before_step script; allowed:"
                " objects without"
            )
        if world.tissues:
            raise InputError(
                f"Batch: got a rig with soft tissue, {', '.join(world.tissues)}; allowed: without"
            )
        self.rig, self.n, self._table = world.rig, int(n), world.joints
        self.timestep = world.timestep
        self.names = self._table.names
        self._arms: dict[str, RigArm] = {arm.name: arm for arm in self.rig.arms}
        watch = watch and bool(world.grasps())
        self._model = (
            sensed_model(world.model, world.mj_model) if watch else copy.copy(world.mj_model)
        )
        first = world.save()
        self._first = first.row
        sleeps = bool(self._model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP)
        self._rows = Rows(self._model, self.n, 0 if threads is None else int(threads), sleeps)
        self.grasps: BatchGrasps | WeldedGrasps | None = None
        if watch:
            kind = BatchGrasps if self.rig.grasp == "friction" else WeldedGrasps
            self.grasps = kind(world.model, self._rows)
        #: The worlds at rest, with nothing but their weight.
        self._still = Rows(_weight_only(self._model), self.n, self._rows.nthread)
        self._still_qpos, self._weight = self._still.bind("qpos"), self._still.bind("qfrc_bias")
        gravity = self._table.gravity
        self._coefficients = (
            None if gravity is None else GravityCompensation(gravity, self._table.drive)
        )
        self._servos = world.servos.save()
        self._gains = np.broadcast_to(self._effective(), (self.n, len(self.names), 3))
        self._read = self._own_read()
        driven = (self._servos["locked"] == 0) & self._servos["powered"]
        self._motors = MotorEffort(self._table, slice(None))
        limits = np.where(driven, self._servos["limit"], 0.0)
        self._capped = np.isfinite(self._table.output_max) & self._on & driven
        if self._capped.any():  # each world has its own
            limits = np.tile(limits, (self.n, 1))
            self._ranges = self._rows.expand(LIMIT_FIELD)
        self._lower, self._upper = -limits, limits
        self._motors.renew(self._lower, self._upper)
        self._observers = world.servos.disturbance
        self._observing, watched = None, (0, 0)
        if self._observers is not None:
            watched = self._observers.coupled.shape
            servoed = self._on & driven & ~self._servos["computed"].astype(np.bool_)
            self._observing = self._observers.acting(servoed)
        self._find_observer_matrix()
        #: State of the observers; the rest that is fed forward to their joints, that of the last
        #: step, and what motors exerted there.
        self._observed = np.zeros((self.n, watched[0]))
        self._steady, self._fed, self._efforts = np.zeros((3, self.n, watched[1]))
        self._force = self._rows.bind("actuator_force")
        self._ctrl = self._rows.bind("ctrl")
        self._qpos, self._qvel = self._rows.bind("qpos"), self._rows.bind("qvel")
        self._warmstart = self._rows.bind("qacc_warmstart")
        self._objects = ObjectKinematics(self.rig, self._model)
        self._springs: list[Springs] = []
        self._errors: list[ReadingErrors] = []
        self._drives, self._trains = world.part(Drivetrains).drives, first.parts.get("drives")
        if self._drives is not None and self._trains is not None:
            own = [self._expanded(name) for name in SPRING_FIELDS]
            anchor, _, slips = self._trains
            self._springs = [
                Springs(SpringFields(*rows), anchor.copy(), slips)
                for rows in zip(*own, strict=True)
            ]
        self._computed = self._servos["computed"].astype(np.bool_) & self._on
        self._computed_torque = ComputedTorque(self._table, self._model)
        self._nominal = spring_fields(self._model)
        self._before = np.zeros((self.n, len(self.names)))
        #: Positions, velocities and efforts of the set-points, (n, J, 3): a view of `ctrl`, where
        #: there are no errors.
        self._inputs = self._ctrl.reshape(self.n, len(self.names), INPUTS)
        self._error_state: Mapping[str, Any] = {"registration": {}}
        if world.errors is not None and "errors" in first.parts:
            self._inputs = np.zeros(self._inputs.shape)
            self._error_state = first.parts["errors"]
            for ctrl, qpos, qvel, setpoint in zip(
                self._ctrl, self._qpos, self._qvel, self._inputs, strict=True
            ):
                own = SimpleNamespace(ctrl=ctrl, qpos=qpos, qvel=qvel)
                errors = ReadingErrors(self.rig, self._table, self._model, own, world.errors)
                errors.setpoint = setpoint
                self._errors.append(errors)
        self._renewal = max(1, round(GRAVITY_PERIOD_S / self.timestep))
        self._tracking = max(1, round(TRACKING_PERIOD_S / self.timestep))
        self.tripped = np.zeros((self.n, len(self.names)), np.bool_)
        #: Positions and set-points at the last look at tracking errors, NaN before the first.
        self._tracked = np.full((2, self.n, len(self.names)), np.nan)
        self._actuators = self._table.actuators * self._on[:, None]
        self.periods, self._every_world = np.zeros(self.n, np.int64), np.arange(self.n)
        scratch = mujoco.MjData(self._model)
        self._scratch, self._frames = scratch, Frames(self.rig, self._table, self._model, scratch)
        self._linear = self._frames.linear
        places = Places(self.rig, lambda name: world.arm(name).joints.positions())
        self._references = {name: places.reference_pose(name) for name in self._arms}
        self._seed = np.random.SeedSequence(seed)
        self.rngs: list[np.random.Generator] = []
        self.reset(seeds=self._seed.spawn(self.n))

    # ------------------------------------------------------------------ time

    def reset(
        self,
        mask: ArrayLike | None = None,
        seeds: Sequence[int | np.random.SeedSequence] | None = None,
    ) -> Readings:
        """Put worlds back to where the batch began.

        Args:
            mask: which, (n,) bool; all when omitted
            seeds: of their new random generators, one for each world that is put back; the
                generators go on when omitted

        Raises:
            InputError: a mask or seeds of another length
        """
        which = np.arange(self.n)
        if mask is not None:
            chosen = np.asarray(mask)
            if chosen.shape != (self.n,) or chosen.dtype != np.bool_:
                raise InputError(f"reset: got a mask {mask!r}; allowed: {self.n} of True and False")
            which = which[chosen]
        if seeds is not None:
            if len(seeds) != len(which):
                raise InputError(f"reset: got {len(seeds)} seeds; allowed: {len(which)}")
            if not self.rngs:
                self.rngs = [np.random.default_rng(seed) for seed in seeds]
            for world, seed in zip(which, seeds, strict=True):
                self.rngs[world] = np.random.default_rng(seed)
        if len(which):
            self.put_back(which)
        return self.read()

    def put_back(self, worlds: Index, state: Array | None = None) -> None:
        """Put worlds back to where the batch began.

        Args:
            worlds: their numbers, (k,)
            state: in place of that state, as in `State.row`, (size,)
        """
        self._rows.reset(worlds, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._rows.state[worlds] = self._first if state is None else state
        self.periods[worlds], self._before[worlds] = 0, self._servos["before"]
        self.tripped[worlds], self._tracked[:, worlds] = False, np.nan
        if self._observers is not None:
            joints, observed = self._observers.joints, self._servos["observations"]
            self._observed[worlds] = observed[0, self._observers.rows]
            fed = self._servos["commanded"] + self._servos["balanced"] * self._servos["holding"]
            self._steady[worlds] = self._fed[worlds] = fed[joints]
            self._efforts[worlds] = fed[joints] + observed[1, joints]
        if self.grasps is not None:
            self.grasps.forget(worlds)
        numbers: list[int] = worlds.tolist()
        for world in numbers if self._errors else ():
            self._errors[world].load(self._error_state)
        if self._drives is not None and self._trains is not None:
            for world in numbers:
                self._drives.load(self._springs[world], self._trains)

    def place(self, world: int, names: Sequence[str], at: Array) -> None:
        """Put free objects somewhere in one world, at rest, after it was put back.

        Args:
            world: its number
            names: of the objects, none of them a thread
            at: position and quaternion wxyz of each in the world, (k, 7)
        """
        places, rates = self._objects.free_rows(names)
        self._qpos[world, places] = at
        self._qvel[world, rates] = self._warmstart[world, rates] = 0.0

    def step(
        self, setpoints: ArrayLike | Mapping[str, ArrayLike] | None = None, n: int = 1
    ) -> Readings:
        """Set what the servos follow, then advance every world by n physics steps.

        Args:
            setpoints: positions of every joint, (n, J); or by name, what is left out stays:
                "PSM1": joints without the jaw, (n, k); "PSM1/jaw": opening, (n,);
                "PSM1/tip": pose in the frame of the arm's public poses, (n, 4, 4), solved for the
                joints nearest to their set-points; where it cannot be reached the set-points stay
            n: physics steps

        Raises:
            UnknownNameError: no such arm
            InputError: numbers of another shape or not finite, or n is not a whole number above 0;
                nothing moves
            DivergedError: the state of a world is no longer finite
        """
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
            raise InputError(f"step: got n={n!r}; allowed: a whole number above 0")
        rejected: dict[str, NDArray[np.bool_]] = {}
        if setpoints is not None:
            positions, rejected = self._requested(setpoints)
            self.drive(positions, 0.0)
        self.advance(int(n))
        return self.read(rejected)

    def drive(self, positions: Array, velocities: Array | float) -> None:
        """Set what the servos follow, inside the limits, (n, J) [rad or m, per s]."""
        np.clip(positions, self._table.lower, self._table.upper, out=self._inputs[:, :, 0])
        self._inputs[:, :, 1] = velocities

    def advance(self, n: int, worlds: Index | None = None) -> None:
        """Advance worlds by n physics steps.

        Args:
            n: physics steps
            worlds: their numbers, (k,), k > 0; all when omitted

        Raises:
            DivergedError: the state of a world is no longer finite
        """
        which = self._every_world if worlds is None else worlds
        left = n
        while left > 0:
            periods = self.periods[which]
            since = periods % self._renewal
            if (due := since == 0).any():
                self._balance(which[due])
            if (due := periods % self._tracking == 0).any():
                self._track(which[due])
            run = min(left, int((self._renewal - since).min()))
            run = min(run, int((self._tracking - periods % self._tracking).min()))
            for errors in self._errors:
                errors.command()
                run = min(run, int((errors.every - periods % errors.every).min()))
            if self._observers is not None:
                self._observe(which)
                run = 1
            if self._computed.any():
                self._compute_torque()
                run = 1
            for part in (self.grasps, self._drives):
                if part is not None:
                    run = min(run, int((part.every - periods % part.every).min()))
            self._rows.step(worlds, nstep=run)
            if self._observers is not None:
                self._efforts[which] = self._force[which][:, self._observers.joints]
            self.periods[which] = periods = periods + run
            left -= run
            if self.grasps is not None and (due := periods % self.grasps.every == 0).any():
                self.grasps.look(which[due])
            if self._drives is not None:
                numbers: list[int] = which[periods % self._drives.every == 0].tolist()
                for world in numbers:
                    self._drives.renew(self._qpos[world], self._springs[world])
            for world in which.tolist() if self._errors else ():
                if self.periods[world] % self._errors[world].every == 0:
                    effort = self._found(self._numbers())[2][world]
                    self._errors[world].step(effort, int(self.periods[world]))
        self._check()

    def read(self, rejected: Mapping[str, NDArray[np.bool_]] | None = None) -> Readings:
        """Return the readings of all worlds now."""
        numbers = self._numbers()
        for errors, row in zip(self._errors, numbers, strict=False):
            nq, nv = self._model.nq, self._model.nv
            errors.report(row[:nq], row[nq : nq + nv], row[-errors.setpoint.size :])
        q, qd, effort = self._found(numbers)
        placed = np.moveaxis(self._objects.poses(self._qpos), 1, 0)
        objects = dict(zip(self._objects.names, placed, strict=True))
        return Readings(self._rows.state[:, 0].copy(), q, qd, effort, rejected or {}, objects, self)

    def motion(self, worlds: Index) -> tuple[Array, Array]:
        """Return true positions and velocities of the joints in some worlds, (k, J) each."""
        places, rates = self._qpos[worlds][:, :, None], self._qvel[worlds][:, :, None]
        q, qd = np.empty((2, len(worlds), len(self.names)))
        for index in self._table.arms.values():  # arm by arm, as a World rounds
            rows = index.rows
            q[:, rows] = (self._table.drive[rows] @ places)[..., 0]
            qd[:, rows] = (self._table.rate[rows] @ rates)[..., 0]
        return q, qd

    def object_poses(self, worlds: Index) -> Array:
        """Return position and quaternion wxyz of each object in some worlds, (k, O, 7)."""
        return self._objects.poses(self._qpos[worlds])

    def object_rates(self, name: str, worlds: Index) -> Array:
        """Return the rates of an object's joint in some worlds, (k, w) [rad/s or m/s]."""
        return self._qvel[worlds, self._objects.joints[self._objects.names.index(name)].qvel]

    def show(self, world: int, qpos: Array) -> None:
        """Write the coordinates of a world into those of another MjData of the model, (nq,)."""
        qpos[:] = self._qpos[world]

    def times(self) -> Array:
        """Return the time of each world, (n,) [s]."""
        return self._rows.state[:, 0].copy()

    # ------------------------------------------------------------------ what may differ

    def set_gains(self, p: ArrayLike, i: ArrayLike, d: ArrayLike) -> None:
        """Set gains of each world, (n, J) each or anything that broadcasts to it."""
        shape = (self.n, len(self.names))
        try:
            gains = np.stack([np.broadcast_to(np.asarray(g, float), shape) for g in (p, i, d)], -1)
        except (TypeError, ValueError):
            raise InputError(f"set_gains: got other shapes; allowed: {shape}") from None
        if not (np.isfinite(gains).all() and (gains >= 0.0).all()):
            raise InputError("set_gains: got a gain below 0 or not finite; allowed: 0 or more")
        self._gains = gains * self._on[:, None]
        self._find_observer_matrix()
        bias, gain = (self._rows.expand(name) for name in GAIN_FIELDS)
        own = slice(len(self.names))
        bias[:, own, 1], bias[:, own, 2] = -self._gains[..., 0], -self._gains[..., 2]
        gain[:, own, 0] = self._gains[..., 1]

    def expand(self, field: str) -> Array:
        """Return a field of MjModel with a value for each world, (n, ...), to be written.

        "dof_damping", "dof_frictionloss", "body_mass", "geom_friction", ...: names as in MuJoCo,
        joints in the order of `model`; gains have `set_gains`.

        Raises:
            InputError: no such field, or one that this class writes
        """
        if field in (*GAIN_FIELDS, LIMIT_FIELD):
            raise InputError(f"expand: got {field!r}; allowed: other fields; use set_gains")
        if self._drives is not None and field in SPRING_FIELDS:
            raise InputError(f"expand: got {field!r}; allowed: fields without identified springs")
        try:
            return self._rows.expand(field)
        except (AttributeError, ValueError, KeyError) as problem:
            raise InputError(f"expand: {problem}") from None

    # ------------------------------------------------------------------ tips

    def local_tips(self, q: Array) -> dict[str, Array]:
        """Return {arm: tip in its own reference frame, (n, 4, 4)} at joint positions, (n, J)."""
        return {
            name: chain_pose(arm.arm.mechanism)(q[:, self._table.arms[name].rows])
            for name, arm in self._arms.items()
            if len(self._table.arms[name].hinges)
        }

    def tips(self, local: Mapping[str, Array]) -> dict[str, Array]:
        """Return {arm: tip in the frame of its public poses, (n, 4, 4)} from local ones.

        Setup joints stand where the batch began.
        """
        return {name: self._base(name, local) @ T for name, T in local.items()}

    # ------------------------------------------------------------------ state

    @property
    def rows(self) -> Array:
        """MuJoCo's INTEGRATION state of every world, (n, size); read-only."""
        state = self._rows.state.view()
        state.setflags(write=False)
        return state

    @property
    def setpoints(self) -> Array:
        """Positions that the servos follow, (n, J) [rad or m]; read-only."""
        positions = self._inputs[:, :, 0].copy()
        positions.setflags(write=False)
        return positions

    # ------------------------------------------------------------------ inside

    @property
    def _on(self) -> NDArray[np.bool_]:
        """Mask of the joints that their servos drive, (J,)."""
        return (self._servos["modes"] == POSITION) & (self._servos["locked"] == 0)

    def _numbers(self) -> Array:
        """Return the factor of READ in every world, a copy, (n, size)."""
        state = self._rows.state
        behind = 1 + self._model.nq + self._model.nv + self._model.na  # the time is first
        return np.concatenate([state[:, 1:behind], self._ctrl], axis=1)

    def _found(self, numbers: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and efforts of the joints, (n, J) each."""
        count, nu = len(self.names), self._ctrl.shape[1]
        if self._errors:  # cables stretch by efforts: round these as a World does
            found = np.stack([self._read.dot(row) for row in numbers])
        else:
            found = numbers @ self._read.T
        q, qd, effort = found[:, :count], found[:, count : 2 * count], found[:, 2 * count :]
        if self._gains.strides[0]:  # each world has its own
            inputs = numbers[:, -nu:].reshape(self._inputs.shape)
            act = numbers[:, self._model.nq + self._model.nv : -nu]
            effort = pid_effort(self._gains, inputs, act, q, qd)
        self._motors.limit(effort, qd)
        return q, qd, effort

    def _effective(self) -> Array:
        return self._servos["gains"] * self._on[:, None]

    def _own_read(self) -> Array:
        sizes = self._model.nq, self._model.nv
        return read_matrix(self._table, self._effective(), sizes)

    def _find_observer_matrix(self) -> None:
        """Compute the matrix of the observers' readings, of all worlds or of each world."""
        if self._observers is None:
            return
        sizes = self._model.nq, self._model.nv
        each = self._gains if self._gains.strides[0] else self._gains[:1]
        reads = [read_matrix(self._table, gains, sizes) for gains in each]
        found = np.stack([self._observers.matrix(read) for read in reads])
        self._seen = np.flatnonzero(found.any(axis=(0, 1)))
        own = found if len(found) > 1 else found[0]
        self._observer_matrix = np.ascontiguousarray(own[..., self._seen])

    def _requested(
        self, setpoints: ArrayLike | Mapping[str, ArrayLike]
    ) -> tuple[Array, dict[str, NDArray[np.bool_]]]:
        """Return every joint's set-point (n, J), checked, and which tips are out of reach."""
        if not isinstance(setpoints, Mapping):
            return self._checked("setpoints", setpoints, (self.n, len(self.names))), {}
        positions, rejected = self._inputs[:, :, 0].copy(), dict[str, NDArray[np.bool_]]()
        for key, values in setpoints.items():
            name, _, part = str(key).partition("/")
            arm = self._arms.get(name)
            if arm is None or part not in ("", "jaw", "tip"):
                known = [n + p for n in self._arms for p in ("", "/jaw", "/tip")]
                raise UnknownNameError("set-point", key, known, "Batch.step")
            rows, own = self._table.arms[name].rows, arm.arm.own_joints
            if rows.start == rows.stop or (part == "jaw" and not arm.arm.has_jaw):
                raise InputError(f"Batch.step: {key}: has no servo to follow it")
            first = rows.start
            if part == "tip":
                T = self._checked(str(key), values, (self.n, 4, 4))
                rejected[name] = self._solve(name, T, positions)
            elif part == "jaw":
                positions[:, rows.stop - 1] = self._checked(str(key), values, (self.n,))
            else:
                q = self._checked(str(key), values, (self.n, own))
                positions[:, first : first + own] = q
        return positions, rejected

    def _checked(self, name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.full(1, np.nan)
        if array.shape != shape or not np.isfinite(array).all():
            got = f"shape {array.shape}" if array.shape != shape else "numbers that are not finite"
            raise InputError(f"Batch.step: {name}: got {got}; allowed: finite numbers, {shape}")
        return array

    def _solve(self, name: str, T: Array, positions: Array) -> NDArray[np.bool_]:
        """Write the joints of tip poses into set-points; return which could not be reached."""
        arm, rows = self._arms[name].arm, self._table.arms[name].rows
        own = slice(rows.start, rows.start + arm.own_joints)
        local = self.local_tips(self._inputs[:, :, 0])
        goals = inverse(self._base(name, local)) @ check_transform(T)
        found = nearest_solutions(arm.mechanism, arm.inverse_kinematics, goals, positions[:, own])
        rejected = np.isnan(found[:, 0])
        positions[~rejected, own] = found[~rejected]
        return rejected

    def _base(self, name: str, local: Mapping[str, Array]) -> Array:
        """Return an arm's reference frame in the frame of its public poses, (n, 4, 4) or (4, 4)."""

        def tip(other: str) -> Array:
            return self._references[other] @ local[other]

        origin = pose_origin(self.rig, name, self.rig.reference_arm)
        base = origin.base_pose(name, self._references.__getitem__, tip)
        if not origin.tip:
            return base
        return self._error_state["registration"].get(name, np.eye(4)) @ base

    def _track(self, worlds: Index) -> None:
        """Look at tracking errors in some worlds, as `Tracking` does."""
        setpoint = self._inputs[worlds, :, 0]
        q = self._qpos[worlds] @ self._table.drive.T
        if self._errors:
            numbers: list[int] = worlds.tolist()
            q += np.array([self._errors[world].error for world in numbers])
        was, wanted = self._tracked[:, worlds]
        stepped = (np.abs(setpoint - wanted) > STEP).any(axis=1)  # never of NaN
        self._tracked[0, worlds], self._tracked[1, worlds] = q, setpoint
        beyond = self._beyond(q - setpoint)
        stepped &= ~beyond.any(axis=1)
        beyond[stepped] = self._beyond((was - setpoint)[stepped])
        self.tripped[worlds] |= beyond

    def _beyond(self, error: Array) -> NDArray[np.bool_]:
        """Judge whether actuators are farther off than allowed, by errors of joints, (k, J)."""
        found: NDArray[np.bool_] = np.abs(error @ self._actuators.T) > self._table.tolerance
        return found

    def _balance(self, worlds: Index) -> None:
        """Feed forward what holds every motor's load in some worlds."""
        self._still_qpos[worlds] = self._qpos[worlds]
        self._still.forward(worlds, int(mujoco.mjtStage.mjSTAGE_VEL))
        forces = self._weight[worlds]
        if self._linear:  # a product for each world rounds as in a World
            holding = (self._table.share @ forces[:, :, None])[..., 0]
        else:
            holding = np.empty((len(worlds), len(self.names)))
            for world, force, out in zip(worlds.tolist(), forces, holding, strict=True):
                self._scratch.qpos[:] = self._qpos[world]
                self._frames.joint_efforts(force, out)
        if self._drives is not None:
            for world, out in zip(worlds.tolist(), holding, strict=True):
                out += self._drives.holding(self._qpos[world])
        if self._coefficients is not None:
            numbers: list[int] = worlds.tolist()
            for world, out in zip(numbers, holding, strict=True):
                qpos = self._errors[world].qpos() if self._errors else self._qpos[world]
                self._coefficients.write(qpos, out)
        feed = self._servos["balanced"] * holding
        self._inputs[worlds, :, 2] = feed
        if self._observers is not None:
            self._steady[worlds] = feed[:, self._observers.joints]
        if self._capped.any():
            which = np.ix_(worlds, self._capped)
            gravity = feed[:, self._capped]
            most, limit = (a[self._capped] for a in (self._table.output_max, self._servos["limit"]))
            self._lower[which] = np.clip(gravity - most, -limit, limit)
            self._upper[which] = np.clip(gravity + most, -limit, limit)
            self._ranges[(*which, 0)], self._ranges[(*which, 1)] = (
                self._lower[which],
                self._upper[which],
            )

    def _observe(self, worlds: Index) -> None:
        """Feed forward the efforts of disturbance observers for one step in some worlds."""
        observers = self._observers
        if observers is None:
            return
        effort = self._efforts[worlds] - self._fed[worlds]
        state = self._observed[worlds]
        matrix = self._observer_matrix
        matrix = matrix if matrix.ndim == 2 else matrix[worlds]
        found = product(matrix, self._numbers()[np.ix_(worlds, self._seen)])
        added = observers.observe(state, effort, observers.views(found), self._observing)
        self._observed[worlds], self._fed[worlds] = state, self._steady[worlds]
        fed = added + self._steady[worlds]
        here = worlds[:, None]
        self._inputs[here, observers.joints, 2] = fed
        if self._errors:
            self._ctrl.reshape(self._inputs.shape)[here, observers.joints, 2] = fed

    def _compute_torque(self) -> None:
        """Feed forward computed torque for one step in every world."""
        inputs, qvel = self._inputs, self._qvel
        ctrl = self._ctrl.reshape(inputs.shape)
        for world in range(self.n):
            if self._drives is not None:
                self._drives.write(self._nominal, self._drives.read(self._springs[world].fields))
            acceleration = (inputs[world, :, 1] - self._before[world]) / self.timestep
            efforts = self._computed_torque.efforts(
                (self._qpos[world], qvel[world]), ctrl[world], self._gains[world], acceleration
            )
            inputs[world, self._computed, 2] = efforts[self._computed]
            ctrl[world, self._computed, 2] = efforts[self._computed]
        self._before[:] = inputs[:, :, 1]

    def _expanded(self, field: str) -> Array:
        """Return a field of every world's model, (n, ...), as it is where it is empty."""
        nominal = getattr(self._model, field)
        return self._rows.expand(field) if nominal.size else np.stack([nominal] * self.n)

    def _check(self) -> None:
        """Reject a state that is no longer finite."""
        fine = np.isfinite(self._rows.state).all(axis=1)
        if not fine.all():
            world = int(np.argmin(fine))
            raise DivergedError(
                float(self._rows.state[world, 0]), "any", None, f"world {world} of the batch"
            )


def _weight_only(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model whose bias forces at rest take the least to compute."""
    made, off = copy.copy(model), mujoco.mjtDisableBit
    for flag in (off.mjDSBL_CONSTRAINT, off.mjDSBL_CONTACT, off.mjDSBL_ACTUATION):
        made.opt.disableflags |= int(flag)
    made.opt.disableflags |= int(off.mjDSBL_SENSOR)
    made.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    return made
