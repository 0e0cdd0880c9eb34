"""A rig in time: the only owner of the physics state."""

from __future__ import annotations

import copy
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import RigDescription, load_rig, rig_with_tool
from trocar.descriptions.calibrated import Calibration, calibrated_rig
from trocar.descriptions.records import DynamicsKind
from trocar.descriptions.robot_errors import robot_errors
from trocar.descriptions.sensor_records import SensorReading
from trocar.descriptions.sensors import ALL_CONTACTS, ContactsReading
from trocar.errors import DivergedError, InputError, UnknownNameError
from trocar.kinematics.chain_pose import chain_pose
from trocar.modeling import naming
from trocar.modeling.build import RigModel, build
from trocar.modeling.options import ModelOptions
from trocar.simulation.arm import Arm
from trocar.simulation.cameras import CameraRecord, Cameras
from trocar.simulation.control import OnReject
from trocar.simulation.drives import Drivetrains
from trocar.simulation.frames import Frames
from trocar.simulation.grasps import Grasp, Grasps
from trocar.simulation.health import warn_near_singular
from trocar.simulation.journal import WORLD, Journal, Listener, command
from trocar.simulation.motors import Motors
from trocar.simulation.moves import Motion
from trocar.simulation.objects import Objects, ObjectStates, SceneObject
from trocar.simulation.parts import Attached, Part
from trocar.simulation.probes import ContactTable, Sensors, carrier_names, moved_carrier
from trocar.simulation.records import (
    ArmSnapshot,
    Drawing,
    Health,
    Pose,
    Recording,
    ShapeRecord,
    Snapshot,
    TrueState,
    WorldSample,
)
from trocar.simulation.runtime import ArmState
from trocar.simulation.schedule import Act, Schedule, ScheduleEntry
from trocar.simulation.scripts import Scripts
from trocar.simulation.sensor_errors import SensorErrors
from trocar.simulation.servos import Servos
from trocar.simulation.setpoint_table import SetpointPlayer, check_playable, fastest
from trocar.simulation.shapes import band_poses, shape_records
from trocar.simulation.supervision import Supervision, Tracking
from trocar.simulation.threads import ThreadProp
from trocar.simulation.tip_load import TipLoad
from trocar.simulation.tissue.drawings import TissueDrawings
from trocar.simulation.tissue.tissues import SoftTissue
from trocar.simulation.tool_exchange import carry, engaged, keep_settings, warn_of_clipped

Array = NDArray[np.float64]
P = TypeVar("P", bound=Part)

#: No bound on a run of physics steps: more than any call of `step` makes.
MOST_STEPS = 1 << 30
#: Everything that a physics step depends on, what sleeps apart.
INTEGRATION = int(mujoco.mjtState.mjSTATE_INTEGRATION)
#: The part of it that a physics step changes.
STEPPED = int(mujoco.mjtState.mjSTATE_FULLPHYSICS | mujoco.mjtState.mjSTATE_WARMSTART)
#: `set_state` puts joints beyond their limits by this part of their range at most, as stops give
#: way. Source: our own choice; loops that are put much farther away diverge.
BEYOND = 0.1
#: Arguments with few values.
CHOICES = {
    "control": ("dvrk", "paper"),
    "friction": ("identified", "paper"),
    "setup_joints": ("braked", "locked"),
    "belts": ("rigid", "stretch"),
    "dynamics": (None, "cad", "identified"),
}
#: MuJoCo's warnings of a state that is no longer finite.
BAD_QPOS = int(mujoco.mjtWarning.mjWARN_BADQPOS)
BAD_QVEL = int(mujoco.mjtWarning.mjWARN_BADQVEL)
BAD_QACC = int(mujoco.mjtWarning.mjWARN_BADQACC)
BAD = {BAD_QPOS: "position", BAD_QVEL: "velocity", BAD_QACC: "acceleration"}


@dataclass(frozen=True, eq=False)
class State:
    """Everything that a world's motion depends on, as `World.save` returns it; never written to.

    Attributes:
        signature: the rig with its tools and options, as compiled
        row: MuJoCo's INTEGRATION state
        asleep: what sleeps, which MuJoCo's state lacks
        qacc, smooth: accelerations of the last step, with and without constraints; NaN where there
            was none; MuJoCo keeps those of what sleeps
        periods: physics steps since the reset
        seed, random: of the random numbers, and where they are
        reference_arm: as of the world
        servos, arms: what these keep beside the physics
        parts: what each part keeps, by its name
    """

    signature: str
    row: Array
    asleep: NDArray[np.int32]
    qacc: Array
    smooth: Array
    periods: int
    seed: int
    random: Mapping[str, Any]
    reference_arm: str
    servos: Mapping[str, Array]
    arms: Mapping[str, ArmState]
    parts: Mapping[str, Any] = field(default_factory=dict[str, Any])


class World:
    """A simulated rig. Time passes in `step` and `play` only.

    Args:
        rig: a description, the name of a built-in rig, or the path of a TOML file; or a model from
            `build`, which many worlds may share: it fixes all of the following down to `collisions`
        timestep_s: physics time step [s]
        control: gains that the arms start with, "dvrk" or "paper"
        friction: "identified" or "paper"
        gravity_compensation: on or off; as the gains' source has it when omitted
        setup_joints: "braked" (simulated, held by brakes) or "locked" (welded, faster)
        welded: names of other arms that stay where they start, which is faster too
        belts: "rigid", or "stretch" as the arms' stiffnesses say (the Si's)
        collisions: whether bodies touch
        seed: of the random numbers that sensors draw
        tip_load_n: force that turns about each instrument's tip [N]
        homed: whether arms begin ENABLED and homed; else DISABLED, as the hardware at power-on
        calibration: overlays of calibrated robots, as for `load_rig`; arms without one are nominal
        dynamics: of arms whose overlays have none: "identified", from recordings of real arms where
            there are any for the kind of arm (with the friction "identified" only), or "cad",
            masses and friction of the descriptions; the rig's own when omitted
        errors: of the robots' sensors and cables, "perfect", "lab" or "wide"; the rig's own when
            omitted. Everything that arms report has them; `true_state` has not
        strict_limits: whether arms reject targets beyond their joints' limits, instead of clipping
            them with a warning
        on_reject: rejected commands of arms "warn" and return False, as on the dVRK, or "raise" a
            RejectedError; no part of a recording

    Raises:
        UnknownNameError, DescriptionError: the rig, an arm to weld, a calibration or the errors
        InputError: another argument
    """

    def __init__(
        self,
        rig: RigModel | RigDescription | str | Path,
        *,
        timestep_s: float = 0.001,
        control: Literal["dvrk", "paper"] = "dvrk",
        friction: Literal["identified", "paper"] = "identified",
        gravity_compensation: bool | None = None,
        setup_joints: Literal["braked", "locked"] = "braked",
        welded: Sequence[str] = (),
        belts: Literal["rigid", "stretch"] = "rigid",
        collisions: bool = True,
        seed: int = 0,
        tip_load_n: float = 0.0,
        homed: bool = True,
        calibration: Calibration | None = None,
        dynamics: DynamicsKind | None = None,
        errors: str | None = None,
        strict_limits: bool = False,
        on_reject: OnReject = "warn",
    ) -> None:
        choices: dict[str, Any] = {
            "timestep_s": timestep_s,
            "control": control,
            "friction": friction,
            "gravity_compensation": gravity_compensation,
            "setup_joints": setup_joints,
            "welded": welded,
            "belts": belts,
            "collisions": collisions,
            "seed": seed,
            "tip_load_n": tip_load_n,
            "homed": homed,
            "dynamics": dynamics,
            "errors": errors,
            "strict_limits": strict_limits,
        }
        #: The name or path that the rig was loaded from, "" where it came as a description.
        self.rig_source = str(rig) if isinstance(rig, str | Path) else ""
        self._homed = bool(homed)
        #: Whether arms begin with strict limits.
        self.strict_limits = bool(strict_limits)
        self.on_reject = on_reject
        self._build = 0
        if isinstance(rig, RigModel):
            _check_default(choices, calibration)
            model = rig
            choices |= _choices(model)
        else:
            nominal = rig if isinstance(rig, RigDescription) else load_rig(rig)
            if dynamics is not None:
                nominal = replace(nominal, dynamics=dynamics)
            measured = friction == "identified"
            described = calibrated_rig(nominal, calibration, identified=measured)
            model = build(described, _options(described, choices))
        #: Arguments that the world was built with, the rig apart, as a recording keeps them.
        self.arguments = choices
        self.options = model.options
        #: Errors of the robots' sensors and cables, None for none.
        self.errors = model.rig.errors if errors is None else robot_errors(errors)
        #: The rig that the world was built with, whatever tools were exchanged since.
        self.first_rig = model.rig
        #: Arm on setup joints whose tip frame the poses of the others on setup joints are in.
        self.reference_arm = model.rig.reference_arm
        self.timestep = model.options.timestep
        self.journal = self._journal = Journal()
        #: Parts by name, in the order in which they act.
        self.parts: dict[str, Part] = {}
        self._added: set[str] = set()
        self._errors = None if self.errors is None else SensorErrors(self.errors)
        self._adopt(model)
        #: The commands that lead here, from which a recording that begins later is repeated.
        self.past = self._journal.past
        #: Tools that were exchanged, (arm, tool) in their order: poses keep to the limits of each.
        self._exchanged: list[tuple[str, str]] = []
        self._source, self._prefix = WORLD, ""
        self._grasps = Grasps(self.rig, self.timestep, self._journal)
        self._objects = Objects(self.rig, self._journal, self._grasps)
        self._scripts = Scripts(self.rig, self._journal, self)
        #: Soft tissue, by name.
        self.tissues: dict[str, SoftTissue] = {
            prop.name: SoftTissue(prop, len(self.rig.arms), self.timestep, self._journal)
            for prop in self.rig.props
            if prop.tissue is not None and self.options.collisions
        }
        #: Threads that jaws can grasp, by name; they are among the objects, too.
        self.threads: dict[str, ThreadProp] = {
            prop.name: ThreadProp(prop, prop.thread) for prop in self.rig.objects if prop.thread
        }
        load, drivetrains = TipLoad(tip_load_n), Drivetrains(self.options.friction)
        self._sensors, self._supervision = Sensors(load), Supervision(drivetrains)
        self.parts |= {
            "scripts": self._scripts,
            "tip load": load,
            "supervision": self._supervision,
            "tracking": Tracking(),
            "drives": drivetrains,
            **({} if self._errors is None else {"errors": self._errors}),
            "objects": self._objects,
            "grasps": self._grasps,
            **{f"thread {name}": thread for name, thread in self.threads.items()},
            **{f"tissue {name}": tissue for name, tissue in self.tissues.items()},
            "sensors": self._sensors,
        }
        #: Movable objects by name.
        self.objects: dict[str, SceneObject] = self._objects.by_name
        self.arms: dict[str, Arm] = {}
        for rig_arm in self.rig.arms:
            motors = self._motors(rig_arm.name)
            self.arms[rig_arm.name] = Arm(rig_arm, motors, self)
            self._name_poses(self.arms[rig_arm.name])
        self._seed = _checked_seed(seed)
        self._wire()
        #: Descriptions of the sensors by name; `sensor` reads them.
        self.sensors = {sensor.name: sensor for sensor in self.rig.sensors}
        #: The recorder of this world, None while it is not recorded.
        self.recorder: object | None = None
        #: Waits for a move when a loop in another thread steps this world; None: step here.
        self.waiter: Callable[[Motion, float | None], bool] | None = None
        self._rng: np.random.Generator | None = None
        self.reset()
        #: Observers and how often each is called at least; the shortest of these intervals.
        self._observers: list[tuple[Callable[[], object], int]] = []
        self._stride = MOST_STEPS
        self._drawings: dict[str, Callable[[], Drawing]] = {}
        for name, tissue in self.tissues.items():
            drawn = TissueDrawings(tissue, self._model, self._data)
            for part in (drawn.skin, drawn.wound, drawn.thread):
                self.draw(f"{name}_{part.__name__}", part)
        for name, thread in self.threads.items():
            self._drawings[name] = thread.curve
        warn_near_singular(self.rig)

    @property
    def on_reject(self) -> OnReject:
        """Whether rejected commands of arms "warn" or "raise" a RejectedError."""
        return self._on_reject

    @on_reject.setter
    def on_reject(self, value: OnReject) -> None:
        if value not in ("warn", "raise"):
            raise InputError(f"on_reject: got {value!r}; allowed: warn, raise")
        self._on_reject: OnReject = value

    def __repr__(self) -> str:
        names = ", ".join(self.arms)
        return f"<World {self.rig.name!r} at {self.time:.3f} s: {names}>"

    # ------------------------------------------------------------------ time

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self.journal.time

    @property
    def rng(self) -> np.random.Generator:
        """Random numbers of this world, made from its seed when first needed."""
        if self._rng is None:
            self._rng = np.random.default_rng(self._seed)
        return self._rng

    @property
    def signature(self) -> str:
        """Name of what a state belongs to: the rig with its tools and options, as compiled."""
        found = f"{self.rig.name} {self.model.digest}"
        if self.errors is None:
            return found
        return f"{found} errors {self.errors.name} {zlib.crc32(repr(self.errors).encode()):08x}"

    @property
    def mj_model(self) -> mujoco.MjModel:
        """The compiled model of this world, which gains and brakes are written into."""
        return self._model

    @property
    def mj_data(self) -> mujoco.MjData:
        """MuJoCo's data of this world, for reading; writing into it is at the caller's risk.

        Derived fields are those of the last step's beginning, as always in MuJoCo.
        """
        return self._data

    @property
    def periods(self) -> int:
        """Physics steps since the last reset."""
        return self.journal.period

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Hand every command and event from now on to `listener`; call the result to stop.

        A listener is called where the world is stepped and commanded; it must not command it.
        """
        return self._journal.listen(listener)

    def observe(self, observer: Callable[[], object], every: int = 1) -> Callable[[], None]:
        """Call `observer` in the stepping thread as physics goes on; call the result to stop.

        It may look, and must not command. Motion does not depend on observers.

        Args:
            observer: called after at most `every` physics steps, and at the end of each `step`
            every: physics steps; 1 observes each

        Raises:
            InputError: every is no whole number above 0
        """
        if isinstance(every, bool) or not isinstance(every, (int, np.integer)) or every < 1:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
            raise InputError(f"every: got {every!r}; allowed: a whole number above 0")
        row = (observer, int(every))

        def set_observers(rows: list[tuple[Callable[[], object], int]]) -> None:
            self._observers = rows
            self._stride = min((every for _, every in rows), default=MOST_STEPS)
            self._attended = -1

        set_observers([*self._observers, row])
        return lambda: set_observers([one for one in self._observers if one is not row])

    def draw(self, name: str, provider: Callable[[], Drawing]) -> Callable[[], None]:
        """Show a surface or curve that bends beside the rig's bodies; call the result to stop.

        Renderers and the web viewer show it. Physics does not touch it: a simulation of it steps
        with `observe`, or is a `Part`.

        Args:
            name: of this drawing
            provider: returns it as it is now; called only when a snapshot is taken

        Raises:
            InputError: a drawing, body or object of the rig has this name
        """
        if name in {*self._drawings, *self.arms, *(prop.name for prop in self.rig.props)}:
            raise InputError(f"draw: got {name!r}; allowed: a name that nothing else has")
        self._drawings[name] = provider

        def stop() -> None:
            self._drawings.pop(name, None)

        return stop

    def step(self, n: int = 1) -> None:
        """Advance n physics steps.

        Raises:
            InputError: n is no whole number above 0
            DivergedError: the state is no longer finite; time, joint and last target are named
        """
        if type(n) is not int or n < 1:
            if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
                raise InputError(f"step: got {n!r}; allowed: a whole number above 0")
            n = int(n)
        if self._scripts.inside:
            self._scripts.check_outside("step")
        model, data, journal, schedule = self._model, self._data, self.journal, self._schedule
        bad, period = self._alarms, journal.period
        end = period + n
        while period < end:
            if journal.revision - journal.streamed != self._attended:
                self._attend()
            if self._moving:
                self._follow()
            if schedule.due:
                due, schedule.due = schedule.due, ()
                for act in due:
                    act()
            if self._acts:
                for act in self._acts:
                    act()
            run = end - period
            if run > 1:
                run = min(run, schedule.next - period, self._longest)
            if run > 1:  # a single step's own warning names what left the numbers
                mujoco.mj_getState(model, data, self._before, STEPPED)
            mujoco.mj_step(model, data, run)
            journal.period = period = period + run
            journal.time = data.time
            if bad[BAD_QPOS] or bad[BAD_QVEL] or bad[BAD_QACC]:
                self._diverged(run)
            if period == schedule.next:
                looks, due, gap = schedule.phases[period % schedule.cycle]
                for look in looks:
                    look()
                schedule.due, schedule.next = due, period + gap
            for observer, _ in self._observers:
                observer()

    @command
    def play(
        self,
        positions: Mapping[str, Array],
        velocities: Mapping[str, Array] | None = None,
        efforts: Mapping[str, Array] | None = None,
        *,
        every: int = 5,
        record: bool = True,
    ) -> Recording:
        """Drive arms along tables of set-points, one row every few physics steps.

        The fastest way through a known trajectory: limits are checked once for the whole table.

        Args:
            positions: {arm: (k, n)} [rad or m]
            velocities: {arm: (k, n)}, zero when omitted
            efforts: {arm: (k, n)}, for joints in mode "effort" [N m or N]
            every: physics steps a row lasts
            record: whether to sample every row; else the recording is empty

        Returns:
            samples taken after each row's steps

        Raises:
            InputError: a wrong shape, NaN or infinity, an arm that takes no commands; nothing moves
            DivergedError: as for `step`
        """
        for name in positions:
            if name in self.arms:
                check_playable(self.arms[name])
        table = self._player.table(positions, velocities or {}, efforts or {})
        return self._player.run(table, every, record, self.step, self.arms)

    @command
    def reset(self, seed: int | None = None, pose: str = "start") -> None:
        """Return to time 0 at a named pose of the rig, as the world began: a function of both.

        Joints are in position mode with the gains of the rig, brakes locked; trajectory ratios,
        base frames and the reference arm are the rig's, objects where it has them, at rest. Tools
        stay mounted.

        Args:
            seed: of the random numbers; the last one when omitted
            pose: named pose; arms that it does not name go to "start"

        Raises:
            UnknownNameError: no such pose; nothing changes
            InputError: the seed is no whole number from 0 on; nothing changes
            DescriptionError: the script of an object cannot be run
        """
        self._scripts.check_outside("reset")
        if pose not in self.rig.poses:
            raise UnknownNameError("pose", pose, self.rig.poses, f"rig {self.rig.name}")
        self._seed = self._seed if seed is None else _checked_seed(seed)
        self._rng = None
        self.reference_arm = self.rig.reference_arm
        mujoco.mj_resetData(self._model, self._data)
        for part in self.parts.values():
            part.begin()
        self.servos.restore()
        if not self._homed:
            self.servos.powered[:] = False
            self.servos.engaged[:] = self.joints.brake > 0.0
        at = {**self.rig.poses["start"], **self.rig.poses[pose]}
        placed = self._placed.get(pose) if self.errors is None else None
        for name, arm in self.arms.items():
            q = self.options.locked.get(name, at[name])
            arm.runtime.begin(q, self._homed)
            if placed is None:
                arm.runtime.motors.put(q, np.zeros(len(q)))
        if placed is None:
            self._placed[pose] = self._data.qpos.copy()
        else:
            self._data.qpos[:] = placed
        self.servos.apply()
        for part in self.parts.values():
            part.placed("")
        mujoco.mj_forward(self._model, self._data)
        self._supervision.balance_at_rest()
        self.servos.begin_observing(np.zeros((2, len(self.joints))))
        self._data.qacc[:] = np.nan  # was without compensation; sensors look for this mark
        self.journal.period, self.journal.time = 0, 0.0
        self._go_on()
        self._restart_past("reset", {"seed": self._seed, "pose": pose})

    def save(self) -> State:
        """Return everything that the motion from here on depends on; it can be pickled.

        Handles of moves, listeners and observers are not in it, nor what a script of an object
        keeps.
        """
        model, data = self._model, self._data
        row = np.empty(mujoco.mj_stateSize(model, INTEGRATION))
        mujoco.mj_getState(model, data, row, INTEGRATION)
        row.setflags(write=False)
        return State(
            self.signature,
            row,
            data.tree_asleep.copy(),
            data.qacc.copy(),
            data.qacc_smooth.copy(),
            self.journal.period,
            self._seed,
            self.rng.bit_generator.state,
            self.reference_arm,
            self.servos.save(),
            {name: arm.runtime.save() for name, arm in self.arms.items()},
            {name: kept for name, part in self.parts.items() if (kept := part.save()) is not None},
        )

    @command
    def load(self, state: State) -> None:
        """Go on from a saved state, of this world or another of the same rig, to the last bit.

        Moves until now are over; those of the state go on.

        Raises:
            InputError: no state, or one of another rig, other tools or other options
        """
        if not isinstance(state, State):  # pyright: ignore[reportUnnecessaryIsInstance]  public input
            raise InputError(f"load: got {state!r}; allowed: a State, as `save` returns it")
        if state.signature != self.signature:
            raise InputError(
                f"load: got a state of {state.signature}; allowed: one of {self.signature}"
            )
        if unknown := sorted({*state.parts} - {*self.parts}):
            raise InputError(
                f"load: got a state with {', '.join(unknown)}; allowed: {', '.join(self.parts)}"
            )
        self._scripts.check_outside("load")
        self._put(state.row, state.asleep)
        self._data.qacc[:], self._data.qacc_smooth[:] = state.qacc, state.smooth
        self.journal.period, self._seed = state.periods, state.seed
        self._rng = None
        self.rng.bit_generator.state = state.random
        self.journal.time = self._data.time
        self.reference_arm = state.reference_arm
        self.servos.load(state.servos)
        for name, arm in self.arms.items():
            arm.runtime.load(state.arms[name])
        for name, kept in state.parts.items():
            self.parts[name].load(kept)
        self._bad[:] = 0
        self._draw_up()
        self._restart_past("load", {"state": state})
        if any(prop.script for prop in self.rig.objects):
            self.past.forget(
                "it began after a saved state was loaded, which lacks what scripts of objects keep;"
                " begin it before, or after a reset"
            )

    def wait(self, motion: Motion, timeout_s: float | None) -> bool:
        """Step until a move is over, or leave the waiting to the loop that runs this world."""
        self._scripts.check_outside("wait")
        if self.waiter is not None:
            return self.waiter(motion, timeout_s)
        end = np.inf if timeout_s is None else self.time + timeout_s
        while not motion.done and self.time < end:
            self.step()
        return motion.goal_reached

    @command
    def set_state(self, name: str, q: Array, v: Array | None = None) -> None:
        """Put one arm at joint positions and velocities, with its loops closed.

        Its moves end; its set-points are there too, inside the limits.

        Args:
            name: of the arm
            q: (n,) [rad or m], the jaw included
            v: (n,), zero when omitted

        Raises:
            UnknownNameError: no such arm
            InputError: no (n,) finite numbers, one farther beyond a limit than a tenth of the
                joint's range or faster than ten times its limit, or an arm that is welded into the
                model
        """
        arm = self.arm(name)
        if arm.runtime.motors.welded:
            raise InputError(f"{name}: is welded into the model")
        slack = BEYOND * (arm.joints.upper - arm.joints.lower)
        place = _checked_state(
            name, q, (arm.joints.lower - slack, arm.joints.upper + slack), "positions"
        )
        speed = np.zeros(len(place))
        if v is not None:
            most = fastest(arm.description)
            speed = _checked_state(name, v, (-most, most), "velocities")
        arm.runtime.start_at(np.clip(place, arm.joints.lower, arm.joints.upper))
        arm.runtime.motors.place(place, speed)
        arm.runtime.motors.command(
            np.clip(place, arm.joints.lower, arm.joints.upper), np.zeros(len(place))
        )
        for part in self.parts.values():
            part.placed(name)
        self._supervision.balance()

    @command
    def exchange_tool(self, name: str, tool: str) -> None:
        """Mount another tool on an arm, in no time; all other arms go on as they were.

        The arm's moves end. It keeps its own joints and its roll, clipped to the new tool's limits
        with a warning; its wrist is straight and its jaw shut. State, modes and gains of its own
        joints stay; the tool's joints start with the tool's gains. The Arm and its Jaw remain the
        same objects.

        Args:
            name: of the arm
            tool: a built-in tool ("PROGRASP_FORCEPS:420093"), the path of a TOML file, or "none"

        Raises:
            UnknownNameError: no such arm or tool; the known ones are listed
            InputError: the arm takes no tool, this one is made for another generation, or the rig
                has soft tissue
            DescriptionError: the tool's file is broken
        """
        self._scripts.check_outside("exchange_tool")
        if self.tissues:
            raise InputError(f"exchange_tool: the rig has tissue ({', '.join(self.tissues)})")
        arm, rig = self.arm(name), rig_with_tool(self.rig, name, str(tool))
        model = build(rig, self.options)
        arm.runtime.states.stop()
        old, new = arm.description, rig.arm(name).arm
        q = engaged(arm.joints.positions(), old, new)
        setpoints = engaged(arm.joints.setpoints(), old, new)
        warn_of_clipped(name, arm.joints.setpoints(), old, setpoints, new)
        before, motors = (self._model, self._data, self.servos), arm.runtime.motors
        self._adopt(model)
        carry(before, (self._model, self._data, self.servos), name)
        for other in self.arms.values():
            if other is not arm:
                other.runtime.reattach(self._motors(other.name))
        new_motors = self._motors(name)
        keep_settings(motors, new_motors)
        self._wire(name)
        arm.runtime.refit(rig.arm(name), new_motors, q, setpoints)
        self._name_poses(arm)
        self._supervision.balance(name)
        for part in self.parts.values():
            part.placed(name)
        self._exchanged.append((name, str(tool)))
        self.journal.event(name, "tool_type", tool=arm.description.tool)

    @command
    def set_reference_arm(self, name: str) -> None:
        """Choose the arm whose tip frame the poses of the others on setup joints are in.

        Its own poses and those of its setup joints are in the cart's frame until the next
        reset.

        Args:
            name: of the arm that setup joints are made for: "ECM", "PSM1", ...

        Raises:
            InputError: the rig has no setup joints for such an arm; nothing changes
        """
        if name not in self.rig.setup_joints:
            known = ", ".join(self.rig.setup_joints) or "none, for the rig has no setup joints"
            raise InputError(f"reference arm: got {name!r}; allowed: {known}")
        self.reference_arm = name

    # ------------------------------------------------------------------ looking

    def arm(self, name: str) -> Arm:
        """Return an arm.

        Raises:
            UnknownNameError: no such arm; the known ones are listed
        """
        if name not in self.arms:
            raise UnknownNameError("arm", name, self.arms, f"rig {self.rig.name}")
        return self.arms[name]

    def part(self, kind: type[P]) -> P:
        """Return the first part of a class.

        Raises:
            UnknownNameError: no part is of this class; the known names are listed
        """
        for part in self.parts.values():
            if isinstance(part, kind):
                return part
        raise UnknownNameError("part", kind.__name__, self.parts, f"rig {self.rig.name}")

    def add(self, name: str, part: Part) -> Callable[[], None]:
        """Add a part to this world; call the result to remove it.

        A recording that begins then cannot be repeated, since it lacks the part's code.

        Args:
            name: of the part; its state is saved under it
            part: begins at once, where the world is

        Raises:
            InputError: something else has this name, or the world is recorded
        """
        if self.recorder is not None:
            raise InputError(f"add: got {name!r} while the world is recorded; allowed: before")
        taken = {WORLD, *self.parts, *self.arms, *(prop.name for prop in self.rig.props)}
        if name in taken:
            raise InputError(f"add: got {name!r}; allowed: a name that nothing else has")
        part.name = name
        part.attach(replace(self._physics, exchanged=""))
        part.begin()
        part.placed("")
        self.parts[name] = part
        self._added.add(name)
        self._draw_up()
        self._forget_parts()

        def remove() -> None:
            if name in self._added:
                self._added.remove(name)
                del self.parts[name]
                self._draw_up()

        return remove

    def object(self, name: str) -> SceneObject:
        """Return a prop that can be moved.

        Raises:
            UnknownNameError: no such object; the known ones are listed
        """
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects, f"rig {self.rig.name}")
        return self.objects[name]

    def object_states(self) -> ObjectStates:
        """Return poses and velocities of all objects."""
        return self._objects.states()

    def grasps(self) -> dict[str, Grasp]:
        """Return the grasp of each jaw, {arm: grasp}, as of the last 10 ms.

        Arms whose tools have no jaw, and rigs without free objects, have none.
        """
        return self._grasps.read()

    def contacts(self) -> ContactsReading:
        """Return every place where two bodies touch, as a `contacts` sensor without noise does."""
        return ALL_CONTACTS.sample(self._sensors.probes, self.rng)

    def contact_table(self) -> ContactTable:
        """Return the same as arrays, in one go."""
        return self._sensors.probes.contact_table()

    def contact_forces(self) -> dict[str, Array]:
        """Return the net force of contacts, held objects and tissue on each arm, {arm: (3,)} [N].

        As of the last step.
        """
        found = self._sensors.probes.contact_forces()
        for tissue in self.tissues.values():
            for arm, force in tissue.forces_on_jaws().items():
                found[arm] += force
        return found

    def sensor(self, name: str) -> SensorReading:
        """Return the reading of a sensor of the rig now.

        Raises:
            UnknownNameError: no such sensor; the known ones are listed
        """
        return self._sensors.read(name)

    def snapshot(self, *, arms: bool = True) -> Snapshot:
        """Return a frozen copy of where everything is.

        Args:
            arms: include every arm's joints, too, which takes ten times as long as all bodies
        """
        found: dict[str, ArmSnapshot] = {}
        shown, every = self._true.bodies(), self.servos.read() if arms else None
        centres = self._true.remote_centres(shown)
        if every is not None:
            for name, arm in self.arms.items():
                motors = arm.runtime.motors
                read = None if motors.welded else every[:, motors.index.rows]
                found[name] = arm.runtime.snapshot(centres.get(name), read)
        at, turn = shown.xpos.copy(), shown.xquat.copy()
        if self.rig.bands:
            rods = band_poses(self.rig, self._model, shown)
            at, turn = np.concatenate([at, rods[0]]), np.concatenate([turn, rods[1]])
        drawings = tuple(provider() for provider in self._drawings.values())
        return Snapshot(self.time, at, turn, found, self._build, drawings)

    def sample(self) -> WorldSample:
        """Return copies of what every reading is computed from, quickly; see `Reader`."""
        servos = self.servos
        joints = np.empty((7, len(servos.commanded)))
        servos.read(joints[:3])
        joints[3], joints[4:6] = servos.holding, servos.setpoint[:, :2].T
        joints[6] = servos.commanded
        arms = {
            name: arm.runtime.sample(
                None if arm.runtime.motors.welded else joints[:, arm.runtime.motors.index.rows]
            )
            for name, arm in self.arms.items()
        }
        errors = servos.errors
        registration = None if errors is None else errors.registration
        qpos = servos.qpos().copy()
        return WorldSample(self.time, self.model, qpos, arms, self.reference_arm, registration)

    def cameras(self) -> dict[str, CameraRecord]:
        """Return every camera of the rig, by name, with where it is now; nothing is drawn."""
        return self._cameras.records(self.time, self._build)

    def camera(self, name: str) -> CameraRecord:
        """Return one camera of the rig with where it is now.

        Raises:
            UnknownNameError: no such camera; the known ones are listed
        """
        found = self.cameras()
        if name not in found:
            raise UnknownNameError("camera", name, found, f"rig {self.rig.name}")
        return found[name]

    def remote_centres(self) -> dict[str, Array]:
        """Return the remote centre of every arm that has one, in the world, (3,) [m]."""
        return self._true.remote_centres()

    def reference_pose(self, name: str) -> Array:
        """Return the pose of an arm's reference frame in the world, (4, 4)."""
        return self.frames.reference_pose(name)

    def base_pose(self, name: str) -> tuple[Array, str]:
        """Return an arm's reference frame in the frame of its public poses, and that one's name."""
        return self.frames.base_pose(name, self.reference_arm)

    def true_state(self, name: str) -> TrueState:
        """Return the true state of an arm, for scores and plots; no robot could report this.

        Without `errors` it is what the arm reports. Setup joints included: the frame of
        `measured_cp` is where the camera, or whatever carries it, truly is.

        Raises:
            UnknownNameError: no such arm
        """
        arm = self.arm(name)
        q, qd, effort = (
            arm.joints.readings()
            if arm.runtime.motors.welded
            else self.servos.true()[:, arm.runtime.motors.index.rows]
        )
        tip = (
            self._true.measured(name)
            if self._true.follows(name)
            else chain_pose(arm.description.mechanism)(q)
        )
        base, frame = arm.runtime.tip.placed or self._true.base_pose(name, self.reference_arm)
        world = self._true.reference_pose(name) @ tip
        return TrueState(q, qd, effort, Pose(base @ tip, frame, self.time), world)

    def health(self) -> Health:
        """Return the loop-closure residuals of every arm now."""
        each = {
            name: arm.joints.health()
            for name, arm in self.arms.items()
            if not arm.runtime.motors.welded
        }
        return Health.of(each)

    def engine_warnings(self) -> dict[str, int]:
        """Return {kind: how often} of MuJoCo's warnings since the last reset, those that came."""
        counts = self._data.warning.number
        kinds = (
            kind for kind in mujoco.mjtWarning.__members__.values() if kind.value < len(counts)
        )
        return {
            kind.name.removeprefix("mjWARN_").lower(): int(counts[kind.value])
            for kind in kinds
            if counts[kind.value]
        }

    def shapes(self) -> tuple[ShapeRecord, ...]:
        """Return every shape of the rig and the body that carries it, for drawing."""
        return shape_records(self.rig, self._model)

    # ------------------------------------------------------------------ inside

    def _restart_past(self, verb: str, values: Mapping[str, object]) -> None:
        """Keep one command, which leads to the present state, and the tool exchanges before it."""
        exchanges = (
            (WORLD, "exchange_tool", {"name": name, "tool": tool}) for name, tool in self._exchanged
        )
        self.past.restart((*exchanges, (WORLD, verb, values)))
        self._forget_parts()

    def _forget_parts(self) -> None:
        if self._added:
            self.past.forget(
                f"it began with parts ({', '.join(sorted(self._added))}) whose code it lacks"
            )

    def _adopt(self, model: RigModel) -> None:
        """Set the compiled rig; what looks into the physics must be attached to it next."""
        #: The rig as it is compiled now, which nothing writes to.
        self.model, self.rig = model, model.rig
        self._model = copy.copy(model.mj)  # gains, brakes and limits are written into this one
        self._data = mujoco.MjData(self._model)
        self._bad = self._data.warning.number
        self._alarms = memoryview(self._bad)  # read after every step, in half the time
        self.joints = model.joints
        physics = self.joints, self._model, self._data
        errors = None if self._errors is None else self._errors.compiled(self.rig, *physics)
        self.servos = Servos(*physics, errors)
        #: Frames as the robots report them; `_true` as they are, the same without errors.
        self.frames = Frames(self.rig, *physics, errors)
        self._true = self.frames if errors is None else Frames(self.rig, *physics)
        self._before = np.zeros(mujoco.mj_stateSize(self._model, STEPPED))
        #: Coordinates of each pose that a reset has put the arms at; closing loops takes time.
        self._placed: dict[str, Array] = {}
        self._build += 1

    def _motors(self, name: str) -> Motors:
        """Return an arm's motors in the model as it is now."""
        return Motors(self.rig.arm(name), self.servos, self._data)

    def _name_poses(self, arm: Arm) -> None:
        """Add the rig's named poses to an arm's own."""
        arm.runtime.poses |= {
            pose: by_arm[arm.name] for pose, by_arm in self.rig.poses.items() if arm.name in by_arm
        }

    def _wire(self, exchanged: str = "") -> None:
        """Attach everything to the compiled physics, after the exchange of an arm's tool."""
        self._player = SetpointPlayer(self._model, self._data, self.servos, self.arms)
        self._cameras = Cameras(self.rig, self.joints, self._true)
        self._physics = Attached(
            self.rig,
            self.joints,
            self._model,
            self._data,
            self.servos,
            self.frames,
            self._true,
            self.arms,
            self.journal,
            lambda: self._seed,
            lambda: self.rng,
            exchanged,
        )
        for part in self.parts.values():
            part.attach(self._physics)
        self._draw_up()

    def _draw_up(self) -> None:
        """Draw up when each part acts, and go on from here."""
        self._schedule = Schedule(
            ScheduleEntry(every, before, look)
            for part in self.parts.values()
            for every, before, look in (
                (part.before_every, part.before_step, None),
                (part.every, None, part.look),
            )
            if every > (before is not None)  # what acts before each step is called by `step`
        )
        self._go_on()

    def _go_on(self) -> None:
        """Step on from where the journal is, whatever moves there."""
        self._schedule.seek(self.journal.period)
        self._attended = -1

    def _attend(self) -> None:
        """Find, after commands, which arms move and what acts before the next physics steps."""
        self._attended = self.journal.revision - self.journal.streamed
        self._moving: list[Arm] = []
        for arm in self.arms.values():  # loops: a comprehension is one more call
            if arm.runtime.active:
                self._moving.append(arm)
        acts: list[Act] = []
        for part in self.parts.values():
            if part.before_every == 1:
                acts.append(part.before_step)
        if np.count_nonzero(self.servos.computed):
            acts.insert(0, self.servos.compute_torque)
        if self.servos.disturbance is not None:
            acts.insert(0, self.servos.observe_disturbance)
        #: Physics steps between two calls of what acts.
        self._longest = 1 if self._moving or acts else self._stride
        if self.servos.errors is not None:  # hands over set-points, which no step changes
            acts.insert(0, self.servos.errors.command)
        self._acts = acts

    def _follow(self) -> None:
        """Bring the set-points of arms that move to the end of the next physics step."""
        time = self.time + self.timestep
        for arm in self._moving:
            arm.runtime.follow(time)
            if not arm.runtime.active:
                self._attended = -1

    def _put(self, row: Array, asleep: NDArray[np.int32]) -> None:
        """Write a row of the physics state, with what sleeps asleep.

        MuJoCo keeps no sleepers in a row: setting one wakes them, which moves them by nanometres.
        So they are put to sleep where they lie by a step at rest before the row is set again.
        Source: measured on stacked, falling and shoved objects, bit for bit.
        """
        model, data = self._model, self._data
        sleeping = asleep >= 0
        if sleeping.any() or (data.tree_asleep >= 0).any():
            mujoco.mj_resetData(model, data)
            mujoco.mj_setState(model, data, row, INTEGRATION)
            if sleeping.any():
                data.tree_asleep[:] = -(1 + mujoco.mjMINAWAKE)
                data.tree_asleep[sleeping] = -1
                mujoco.mj_step(model, data)
        mujoco.mj_setState(model, data, row, INTEGRATION)
        data.tree_asleep[~sleeping] = asleep[~sleeping]

    def _diverged(self, steps: int) -> None:
        """Repeat the last steps, one by one, to name what left the numbers first."""
        if steps > 1:
            mujoco.mj_setState(self._model, self._data, self._before, STEPPED)
            self._bad[:] = 0
            for _ in range(steps):
                mujoco.mj_step(self._model, self._data)
                if self._bad[list(BAD)].any():
                    break
        self.journal.time = self._data.time
        kind = next((k for k in BAD if self._bad[k]), BAD_QACC)
        index = self._culprit(kind)
        name, detail = self._model.joint(index).name, f"the {BAD[kind]} of {{}} is not finite"
        owner, _, frame = name.partition("/")
        if owner in self.objects:
            raise DivergedError(self.time, owner, None, detail.format("the object"))
        if owner not in self.arms:  # belongs to no description: a flex's vertex, a body of its own
            body = int(self._model.jnt_bodyid[index])
            moving = carrier_names(self._model)[moved_carrier(self._model, body)]
            raise DivergedError(self.time, name or f"{index}", None, detail.format(moving))
        mechanism = self.arms[owner].description.mechanism
        moving = mechanism.frame(frame)
        if not moving.couplings and moving.parent:  # a pin, which slides in what moves
            moving = mechanism.frame(moving.parent)
        joint = moving.couplings[0][0]
        raise DivergedError(
            self.time,
            naming.scoped(owner, joint),
            float(self.arms[owner].runtime.motors.position[mechanism.joint_index[joint]]),
            detail.format(frame),
        )

    def _culprit(self, kind: int) -> int:
        """Return the joint that a warning of a bad state speaks of."""
        index, model = int(self._data.warning.lastinfo[kind]), self._model
        if kind == BAD_QPOS:
            return int(np.searchsorted(model.jnt_qposadr, index, side="right")) - 1
        return int(model.dof_jntid[min(index, model.nv - 1)])


def _options(rig: RigDescription, choices: Mapping[str, Any]) -> ModelOptions:
    """Return the options of a model from the arguments of a world.

    Raises:
        InputError: an argument that is not allowed
    """
    for name, allowed in CHOICES.items():
        if choices[name] not in allowed:
            known = ", ".join(filter(None, allowed))
            raise InputError(f"{name}: got {choices[name]!r}; allowed: {known}")
    if choices["belts"] == "stretch" and not any(arm.arm.belts for arm in rig.arms):
        raise InputError(
            f"belts: got 'stretch' for the rig {rig.name}, whose arms have no belts of known"
            " stiffness; allowed: 'rigid', or a rig of the Si"
        )
    names = [arm.name for arm in rig.arms]
    for name in choices["welded"]:
        if name not in names:
            raise UnknownNameError("arm", name, names, "welded")
    setups = {arm.name for arm in rig.arms if arm.arm.type == "SUJ"}
    still = {*choices["welded"], *(setups if choices["setup_joints"] == "locked" else ())}
    return ModelOptions(
        timestep=_checked_period(choices["timestep_s"]),
        control=choices["control"],
        gravity_compensation=choices["gravity_compensation"],
        friction=choices["friction"],
        belts=choices["belts"],
        collisions=choices["collisions"],
        locked={name: rig.poses["start"][name] for name in names if name in still},
    )


def _choices(model: RigModel) -> dict[str, Any]:
    """Return the arguments of a world that a model was built with, the inverse of `_options`.

    Raises:
        InputError: a model that no world can step
    """
    options = model.options
    if options.servo != "pid":
        raise InputError(f"World: got a model with servo {options.servo!r}; allowed: 'pid'")
    setups = {arm.name for arm in model.rig.arms if arm.arm.type == "SUJ"}
    return {
        "timestep_s": options.timestep,
        "control": options.control,
        "gravity_compensation": options.gravity_compensation,
        "friction": options.friction,
        "belts": options.belts,
        "collisions": options.collisions,
        "setup_joints": "locked" if setups & {*options.locked} else "braked",
        "welded": tuple(name for name in options.locked if name not in setups),
        "dynamics": "cad",  # nothing but what the model's overlays have
    }


def _check_default(choices: Mapping[str, Any], calibration: Calibration | None) -> None:
    """Reject arguments that a model determines already."""
    defaults: dict[str, Any] = World.__init__.__kwdefaults__ or {}
    names = (*CHOICES, "timestep_s", "gravity_compensation", "collisions", "welded")
    given = [name for name in names if choices[name] != defaults[name]]
    if given or calibration is not None:
        what = ", ".join([*given, *(["calibration"] if calibration is not None else [])])
        raise InputError(f"World: got a model and {what}; allowed: options of build")


def _checked_state(name: str, values: Array, ends: tuple[Array, Array], what: str) -> Array:
    low, high = ends
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != low.shape or not np.isfinite(array).all():
        raise InputError(f"{name}: got {what} {values!r}; allowed: {len(low)} finite numbers")
    if not ((low <= array) & (array <= high)).all():
        raise InputError(
            f"{name}: got {what} {array.tolist()}; allowed: {low.tolist()} to {high.tolist()}"
        )
    return array


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
        raise InputError(f"seed: got {seed!r}; allowed: a whole number from 0 on")
    return int(seed)


def _checked_period(timestep_s: object) -> float:
    if not isinstance(timestep_s, (int, float)) or not 0.0 < timestep_s <= 0.01:
        raise InputError(f"timestep_s: got {timestep_s!r}; allowed: above 0 to 0.01 s")
    return float(timestep_s)
