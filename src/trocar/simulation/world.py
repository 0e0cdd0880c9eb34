"""A rig in time: the only owner of the physics state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import RigDescription, load_rig
from trocar.descriptions.calibrated import Calibration, calibrated_rig
from trocar.descriptions.records import Control, RigArm
from trocar.errors import DescriptionError, DivergedError, InputError, UnknownNameError
from trocar.modeling import naming
from trocar.modeling.mjcf import rig_spec
from trocar.modeling.options import ModelOptions
from trocar.simulation.arm import Arm
from trocar.simulation.cameras import CameraRecord, Cameras
from trocar.simulation.drives import Drives
from trocar.simulation.exchange import exchange
from trocar.simulation.gravity import PERIOD_S as GRAVITY_PERIOD_S
from trocar.simulation.gravity import GravityCompensation
from trocar.simulation.health import warn_of_flattening
from trocar.simulation.journal import WORLD, Journal, Listener, command
from trocar.simulation.motion import Motion
from trocar.simulation.objects import Objects, ObjectStates, SceneObject
from trocar.simulation.places import Places
from trocar.simulation.play import Player
from trocar.simulation.probes import Probes
from trocar.simulation.recording.past import Past
from trocar.simulation.recording.recorder import Recorder
from trocar.simulation.records import ArmSample, Health, Recording, ShapeRecord, Snapshot
from trocar.simulation.sampling import Sampling
from trocar.simulation.sensor_readings import ContactsReading, ContactTable, Reading
from trocar.simulation.sensors import Sensors
from trocar.simulation.servos import ServoInputs
from trocar.simulation.shapes import shape_records
from trocar.simulation.state_view import StateView
from trocar.simulation.supervision import Supervision
from trocar.simulation.tip_load import PERIOD_S as LOAD_PERIOD_S
from trocar.simulation.tip_load import TipLoad

Array = NDArray[np.float64]

#: Set-points of moves are renewed this often, in physics periods. Source: our own choice.
SETPOINT_PERIODS = 1
#: Watchers look at least this often, in physics periods. Source: as what writes targets does.
WATCHED_PERIODS = 5
#: Not among the plain arguments that a recording keeps: the rig has a source and a fingerprint, and
#: overlays are kept whole.
APART = ("self", "rig", "calibration")
#: MuJoCo's warnings of a state that is no longer finite.
BAD_QPOS = int(mujoco.mjtWarning.mjWARN_BADQPOS)
BAD_QVEL = int(mujoco.mjtWarning.mjWARN_BADQVEL)
BAD_QACC = int(mujoco.mjtWarning.mjWARN_BADQACC)
BAD = {BAD_QPOS: "position", BAD_QVEL: "velocity", BAD_QACC: "acceleration"}


class World:
    """A simulated rig. Time passes in `step` and `play` only.

    Args:
        rig: a description, the name of a built-in rig, or the path of a TOML file
        timestep_s: physics period [s]
        control: gains that the arms start with, "dvrk" or "paper"
        friction: "identified" or "paper"
        gravity_compensation: on or off; as the gains' source has it when omitted
        setup_joints: "braked" (simulated, held by brakes) or "locked" (welded, faster)
        collisions: whether bodies touch
        seed: of the random numbers that sensors draw
        tip_load_n: force that turns about each instrument's tip [N]
        homed: whether arms begin ENABLED and homed; else DISABLED, as the hardware at power-on
        calibration: overlays of calibrated robots, as for `load_rig`; arms without one are nominal

    Raises:
        UnknownNameError, DescriptionError: the rig or a calibration
        InputError: another argument
    """

    def __init__(
        self,
        rig: RigDescription | str | Path,
        *,
        timestep_s: float = 0.001,
        control: Literal["dvrk", "paper"] = "dvrk",
        friction: Literal["identified", "paper"] = "identified",
        gravity_compensation: bool | None = None,
        setup_joints: Literal["braked", "locked"] = "braked",
        collisions: bool = True,
        seed: int = 0,
        tip_load_n: float = 0.0,
        homed: bool = True,
        calibration: Calibration | None = None,
    ) -> None:
        #: What the world was built with, the rig apart; a recording takes these along.
        self.arguments = {k: v for k, v in locals().items() if k not in APART}
        #: The name or path that the rig was loaded from, "" where it came as a description.
        self.rig_source = "" if isinstance(rig, RigDescription) else str(rig)
        self._homed = bool(homed)
        self._build = 0
        nominal = rig if isinstance(rig, RigDescription) else load_rig(rig)
        self.rig = calibrated_rig(nominal, calibration)
        #: The rig that the world was built with, whatever tools were exchanged since.
        self.first_rig = self.rig
        #: Arm on setup joints whose tip frame the poses of the others on setup joints are in.
        self.reference_arm = self.rig.reference_arm
        self.timestep = _checked_period(timestep_s)
        for got, name, allowed in (
            (control, "control", ("dvrk", "paper")),
            (friction, "friction", ("identified", "paper")),
            (setup_joints, "setup_joints", ("braked", "locked")),
        ):
            if got not in allowed:
                raise InputError(f"{name}: got {got!r}; allowed: {', '.join(allowed)}")
        start = self.rig.poses["start"]
        locked = {
            a.name: start[a.name]
            for a in self.rig.arms
            if a.arm.type == "SUJ" and setup_joints == "locked"
        }
        self.options = ModelOptions(
            timestep=timestep_s, friction=friction, collisions=collisions, locked=locked
        )
        self._mj_step: Callable[[mujoco.MjModel, mujoco.MjData, int], None] = mujoco.mj_step
        self._control, self._compensated = control, gravity_compensation
        self._tip_load_n = tip_load_n
        self._adopt(self.rig, self._compile(self.rig))
        self._periods = 0
        self.journal = self._journal = Journal(lambda: (self._periods, self.time))
        self._source, self._prefix = WORLD, ""
        self._objects = Objects(self.rig, self._journal)
        #: What can be moved, by name.
        self.objects: dict[str, SceneObject] = self._objects.by_name
        self._drives: dict[str, Drives] = {}
        self.arms: dict[str, Arm] = {}
        for rig_arm in self.rig.arms:
            drives = self._new_drives(rig_arm.name)
            self._drives[rig_arm.name] = drives
            self.arms[rig_arm.name] = Arm(rig_arm, drives, self)
            self._name_poses(self.arms[rig_arm.name])
        self._wire()
        #: What the rig places, by name; `sensor` reads them.
        self.sensors = {sensor.name: sensor for sensor in self.rig.sensors}
        #: Forces from outside the servos are renewed each so many periods, counted from a reset, so
        #: that motion does not depend on how many periods each call of `step` takes.
        load = max(1, round(LOAD_PERIOD_S / self.timestep))
        self._gravity_renewal = load * max(1, round(GRAVITY_PERIOD_S / LOAD_PERIOD_S))
        self._renewal = load if self._load.size > 0.0 else self._gravity_renewal
        #: Waits for a move when a loop in another thread steps this world; None: step here.
        self.waiter: Callable[[Motion, float | None], bool] | None = None
        self._seed = _checked_seed(seed)
        self.rng = np.random.default_rng(self._seed)
        self.reset()
        #: Who records this world now, and what it was told before.
        self.recorder: Recorder | None = None
        self.past = Past(self)
        self._watchers: list[Callable[[], None]] = []
        warn_of_flattening(self.rig)

    # ------------------------------------------------------------------ time

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return float(self._data.time)

    @property
    def periods(self) -> int:
        """Physics periods since the last reset."""
        return self._periods

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Hand every command and event from now on to `listener`; call the result to stop.

        A listener is called where the world is stepped and commanded; it must not command it.
        """
        return self._journal.listen(listener)

    def watch(self, watcher: Callable[[], None]) -> Callable[[], None]:
        """Call `watcher` each time that physics has gone on; call the result to stop.

        It is called where the world is stepped, may look, and must not command.
        """
        self._watchers.append(watcher)
        return lambda: self._watchers.remove(watcher) if watcher in self._watchers else None

    def record(self, file: str | Path | IO[bytes], *, overwrite: bool = False) -> Recorder:
        """Record states, commands and events into an MCAP file, from now on.

        `with world.record("run.mcap"): ...`, or keep what is returned and call its `stop`.

        Args:
            file: a path, or a binary file that is open for writing
            overwrite: replace a file that exists

        Raises:
            InputError: the file exists or cannot be written, or the world is recorded already
            MissingExtraError: the library for MCAP is not installed
        """
        return Recorder(self, file, overwrite=overwrite)

    def step(self, n: int = 1) -> None:
        """Advance n physics periods.

        Raises:
            InputError: n is no whole number above 0
            DivergedError: the state is no longer finite; time, joint and last target are named
        """
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:
            raise InputError(f"step: got {n!r}; allowed: a whole number above 0")
        left = int(n)
        while left > 0:
            moving = [arm for arm in self.arms.values() if arm.active]
            count = min(left, SETPOINT_PERIODS) if moving else left
            for arm in moving:
                arm.follow(self.time + count * self.timestep)
            self._advance(count)
            left -= count

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
        """Drive arms along tables of set-points, one row every few physics periods.

        The fastest way through a known trajectory: limits are checked once for the whole table.

        Args:
            positions: {arm: (k, n)} [rad or m]
            velocities: {arm: (k, n)}, zero when omitted
            efforts: {arm: (k, n)}, for joints in mode "effort" [N m or N]
            every: physics periods a row lasts
            record: whether to sample every row; else the recording is empty

        Returns:
            samples taken after each row's periods

        Raises:
            InputError: a wrong shape, NaN or infinity, an arm that takes no commands; nothing moves
            DivergedError: as for `step`
        """
        for name in positions:
            if name in self.arms and not self._drives[name].welded:
                self.arms[name].check_playable()
        table = self._player.table(positions, velocities or {}, efforts or {})
        return self._player.run(table, every, record, self._advance, self.arms)

    @command
    def reset(self, seed: int | None = None, pose: str = "start") -> None:
        """Return to time 0 at a named pose of the rig, in the states that the world began in.

        Joints are in position mode and brakes locked; objects are where the rig has them, at rest.

        Gains and gravity compensation stay as they are.

        Args:
            seed: of the random numbers; the last one when omitted
            pose: named pose; arms that it does not name go to "start"

        Raises:
            UnknownNameError: no such pose; nothing changes
            InputError: the seed is no whole number from 0 on; nothing changes
        """
        if pose not in self.rig.poses:
            raise UnknownNameError("pose", pose, self.rig.poses, f"rig {self.rig.name}")
        self._seed = self._seed if seed is None else _checked_seed(seed)
        self.rng = np.random.default_rng(self._seed)
        mujoco.mj_resetData(self._model, self._data)
        self._servos.commanded[:] = self._servos.holding[:] = 0.0
        at = {**self.rig.poses["start"], **self.rig.poses[pose]}
        for name, arm in self.arms.items():
            arm.begin(self.options.locked.get(name, at[name]), self._homed)
        mujoco.mj_forward(self._model, self._data)
        self._gravity.renew_here()
        self._data.qacc[:] = np.nan  # was without compensation; sensors look for this mark
        self._periods = 0

    def wait(self, motion: Motion, timeout_s: float | None) -> bool:
        """Step until a move is over, or leave the waiting to the loop that runs this world."""
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
            InputError: no (n,) finite numbers, or an arm that is welded into the model
        """
        arm, drives = self.arm(name), self._drives[name]
        if drives.welded:
            raise InputError(f"{name}: is welded into the model")
        place = _checked_state(name, q, len(arm.joint_names), "positions")
        speed = np.zeros(len(place))
        if v is not None:
            speed = _checked_state(name, v, len(place), "velocities")
        arm.start_at(np.clip(place, arm.lower, arm.upper))
        drives.place(place, speed)
        drives.command(np.clip(place, arm.lower, arm.upper), np.zeros(len(place)))
        self._gravity.renew_here()

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
            InputError: the arm takes no tool, or this one is made for another generation
            DescriptionError: the tool's file is broken
        """
        exchange(self, name, str(tool))

    @command
    def set_reference_arm(self, name: str) -> None:
        """Choose the arm whose tip frame the poses of the others on setup joints are in.

        Its own poses and those of its setup joints are in the cart's frame from now on. A reset
        keeps the choice.

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

    def object(self, name: str) -> SceneObject:
        """Return a prop that can be moved.

        Raises:
            UnknownNameError: no such object; the known ones are listed
        """
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects, f"rig {self.rig.name}")
        return self.objects[name]

    def object_states(self) -> ObjectStates:
        """Return where all objects are and how fast, in one go."""
        return self._objects.states()

    def contacts(self) -> ContactsReading:
        """Return every place where two bodies touch, as a `contacts` sensor without noise does."""
        return self._sensors.contacts()

    def contact_table(self) -> ContactTable:
        """Return the same as arrays, in one go."""
        return self._probes.contact_table()

    def sensor(self, name: str) -> Reading:
        """Return what a sensor of the rig tells now.

        Raises:
            UnknownNameError: no such sensor; the known ones are listed
        """
        return self._sensors.read(name, self.rng)

    def snapshot(self, *, arms: bool = True) -> Snapshot:
        """Return a frozen copy of where everything is.

        Args:
            arms: tell every arm's joints, too, which takes ten times as long as all bodies
        """
        centres = self.remote_centres() if arms else {}
        shown = self._shown  # a step leaves bodies where it began, and looking changes nothing
        shown.qpos[:] = self._data.qpos
        mujoco.mj_kinematics(self._model, shown)
        return Snapshot(
            self.time,
            shown.xpos.copy(),
            shown.xquat.copy(),
            {name: arm.snapshot(centres.get(name)) for name, arm in self.arms.items() if arms},
            self._build,
        )

    def samples(self) -> dict[str, ArmSample]:
        """Return {arm: copies of what its readings are computed from}, quickly."""
        return self._sampling.take(self.arms)

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
        return self._places.remote_centres()

    def reference_pose(self, name: str) -> Array:
        """Return the pose of an arm's reference frame in the world, (4, 4)."""
        return self._places.reference_pose(name)

    def base_pose(self, name: str) -> tuple[Array, str]:
        """Return an arm's reference frame in the frame of its public poses, and that one's name."""
        return self._places.base_pose(name, self.reference_arm)

    def health(self) -> Health:
        """Return how well every arm's loops hold now."""
        each = {
            name: arm.health() for name, arm in self.arms.items() if not self._drives[name].welded
        }
        return Health.of(each)

    def shapes(self) -> tuple[ShapeRecord, ...]:
        """Return every shape of the rig and the body that carries it, for drawing."""
        return shape_records(self.rig, self._model)

    # ------------------------------------------------------------------ inside

    def _compile(self, rig: RigDescription) -> mujoco.MjModel:
        return _compiled(rig, self.options)

    def _adopt(self, rig: RigDescription, model: mujoco.MjModel) -> None:
        """Take a compiled rig; what looks into the physics must be attached to it next."""
        self.rig, self._model = rig, model
        self._data = mujoco.MjData(model)
        self._shown = mujoco.MjData(model)
        self._bad = self._data.warning.number
        self._servos = ServoInputs(self._data)
        self._state = StateView(self._data)
        self._before, self._time_before = self._state.values.copy(), 0.0
        self._build += 1

    def _new_drives(self, name: str) -> Drives:
        """Return an arm's motors with the gains that the world started with."""
        rig_arm = self.rig.arm(name)
        preset = _preset(rig_arm, self._control)
        drives = Drives(self._model, self._data, self._servos, rig_arm, preset)
        own = preset.gravity_compensation
        drives.compensate_gravity(own if self._compensated is None else self._compensated)
        return drives

    def _name_poses(self, arm: Arm) -> None:
        """Add the rig's named poses to an arm's own."""
        arm.poses |= {
            pose: by_arm[arm.name] for pose, by_arm in self.rig.poses.items() if arm.name in by_arm
        }

    def _wire(self) -> None:
        """Make what looks into the physics and keeps nothing of its own."""
        self._places = Places(self.rig, lambda name: self.arms[name].positions())
        self._player = Player(self._model, self._data, self._state, self._servos, self._drives)
        self._gravity = GravityCompensation(
            self._model, self._data, self._servos, self._drives.values()
        )
        self._supervision = Supervision(self._data.qpos, self._servos, self._drives, self.arms)
        self._load = TipLoad(self._model, self._data, self.rig, self._drives, self._tip_load_n)
        self._probes = Probes(self._model, self._data, self._shown, self._load)
        self._sampling = Sampling(self._data, self._servos, self._drives)
        self._sensors = Sensors(self.rig, self._model, self._data, self._drives, self._probes)
        self._cameras = Cameras(self.rig, self._model, self._data, self._shown, self._drives)
        self._objects.attach(self._model, self._data)

    def _advance(self, count: int) -> None:
        """Step the physics, and stop when it is no longer finite."""
        left = count
        while left > 0:
            since = self._periods % self._renewal
            if since == 0 and self._load.size > 0.0:
                self._load.apply()
            if self._periods % self._gravity_renewal == 0:
                self._gravity.renew()
                self._supervision.check()
            run = min(left, self._renewal - since)
            run = min(run, WATCHED_PERIODS) if self._watchers else run
            self._before[:], self._time_before = self._state.values, self._data.time
            self._mj_step(self._model, self._data, run)
            self._periods += run
            left -= run
            bad = self._bad
            if bad[BAD_QPOS] or bad[BAD_QVEL] or bad[BAD_QACC]:
                self._diverged()
            for watcher in self._watchers:
                watcher()

    def _diverged(self) -> None:
        """Go through the last periods again, one by one, to name what left the numbers first."""
        self._state.values[:], self._data.time = self._before, self._time_before
        self._bad[:] = 0
        for _ in range(self._renewal):
            mujoco.mj_step(self._model, self._data)
            if self._bad[list(BAD)].any():
                break
        kind = next((k for k in BAD if self._bad[k]), BAD_QACC)
        hinge = self._model.joint(self._culprit(kind)).name
        owner, _, frame = hinge.partition("/")
        if owner in self.objects:
            raise DivergedError(
                self.time, owner, None, f"the {BAD[kind]} of the object is not finite"
            )
        mechanism = self.arms[owner].description.mechanism
        moving = mechanism.frame(frame)
        if not moving.couplings and moving.parent:  # a pin, which slides in what moves
            moving = mechanism.frame(moving.parent)
        joint = moving.couplings[0][0]
        raise DivergedError(
            self.time,
            naming.scoped(owner, joint),
            self._drives[owner].target(mechanism.joint_index[joint]),
            f"the {BAD[kind]} of {frame} is not finite",
        )

    def _culprit(self, kind: int) -> int:
        """Return the joint that a warning of a bad state speaks of."""
        index, model = int(self._data.warning.lastinfo[kind]), self._model
        if kind == BAD_QPOS:
            return int(np.searchsorted(model.jnt_qposadr, index, side="right")) - 1
        return int(model.dof_jntid[min(index, model.nv - 1)])


def _compiled(rig: RigDescription, options: ModelOptions) -> mujoco.MjModel:
    """Compile a rig; what MuJoCo refuses is the description's fault.

    Raises:
        DescriptionError: with MuJoCo's reason
    """
    try:
        return rig_spec(rig, options).compile()
    except ValueError as problem:
        raise DescriptionError(rig.file, "", f"MuJoCo refuses it: {problem}") from problem


def _checked_state(name: str, values: Array, count: int, what: str) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise InputError(f"{name}: got {what} {values!r}; allowed: {count} finite numbers")
    return array


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed: got {seed!r}; allowed: a whole number from 0 on")
    return int(seed)


def _checked_period(timestep_s: float) -> float:
    if not isinstance(timestep_s, (int, float)) or not 0.0 < timestep_s <= 0.01:
        raise InputError(f"timestep_s: got {timestep_s!r}; allowed: above 0 to 0.01 s")
    return float(timestep_s)


def _preset(rig_arm: RigArm, name: str) -> Control:
    """Return an arm's gains; an arm that the paper has no gains for keeps the dVRK's."""
    presets = rig_arm.arm.control
    if name in presets:
        return presets[name]
    if not presets:
        raise InputError(f"{rig_arm.arm.name}: has no control gains; cannot be simulated")
    return next(iter(presets.values()))
