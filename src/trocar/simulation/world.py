"""A rig in time: the only owner of the physics state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import RigDescription, load_rig
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.records import Control, RigArm, Shape
from trocar.errors import DivergedError, InputError, UnknownNameError
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import pose
from trocar.modeling.mjcf import rig_spec
from trocar.modeling.options import ModelOptions
from trocar.simulation.arm import Arm
from trocar.simulation.drives import Drives
from trocar.simulation.gravity import PERIOD_S as GRAVITY_PERIOD_S
from trocar.simulation.gravity import GravityCompensation
from trocar.simulation.motion import Motion
from trocar.simulation.play import Player
from trocar.simulation.records import Health, Recording, ShapeRecord, Snapshot
from trocar.simulation.servos import ServoInputs
from trocar.simulation.tip_load import TipLoad

Array = NDArray[np.float64]

#: Set-points of moves are renewed this often, in physics periods. Source: our own choice.
SETPOINT_PERIODS = 1
#: MuJoCo's warnings of a state that is no longer finite.
BAD_QPOS = int(mujoco.mjtWarning.mjWARN_BADQPOS)
BAD_QVEL = int(mujoco.mjtWarning.mjWARN_BADQVEL)
BAD_QACC = int(mujoco.mjtWarning.mjWARN_BADQACC)


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

    Raises:
        UnknownNameError, DescriptionError: the rig
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
    ) -> None:
        self.rig = rig if isinstance(rig, RigDescription) else load_rig(rig)
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
        self.options = ModelOptions(timestep_s, friction, collisions, False, locked)
        self._model = rig_spec(self.rig, self.options).compile()
        self._data = mujoco.MjData(self._model)
        self._bad = self._data.warning.number
        self._servos = ServoInputs(self._data)
        self._drives: dict[str, Drives] = {}
        self.arms: dict[str, Arm] = {}
        for rig_arm in self.rig.arms:
            preset = _preset(rig_arm, control)
            drives = Drives(self._model, self._data, self._servos, rig_arm, preset)
            on = (
                preset.gravity_compensation
                if gravity_compensation is None
                else gravity_compensation
            )
            drives.compensate_gravity(on)
            self._drives[rig_arm.name] = drives
            self.arms[rig_arm.name] = Arm(rig_arm, drives, self)
            self.arms[rig_arm.name].poses |= {
                name: by_arm[rig_arm.name]
                for name, by_arm in self.rig.poses.items()
                if rig_arm.name in by_arm
            }
        self._player = Player(self._model, self._data, self._servos, self._drives)
        self._gravity = GravityCompensation(
            self._model, self._data, self._servos, self._drives.values()
        )
        self._load = TipLoad(self._model, self._data, self.rig, self._drives, tip_load_n)
        #: Waits for a move when a loop in another thread steps this world; None: step here.
        self.waiter: Callable[[Motion, float | None], bool] | None = None
        self.rng = np.random.default_rng(seed)
        self._seed = seed
        self.reset()

    # ------------------------------------------------------------------ time

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return float(self._data.time)

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
            moving = [arm for arm in self.arms.values() if arm.busy]
            count = min(left, SETPOINT_PERIODS) if moving else left
            for arm in moving:
                arm.follow(self.time + count * self.timestep)
            self._advance(count)
            left -= count

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
            InputError: a wrong shape, NaN or infinity; nothing moves
            DivergedError: as for `step`
        """
        table = self._player.table(positions, velocities or {}, efforts or {})
        return self._player.run(table, every, record, self._advance, self.arms)

    def reset(self, seed: int | None = None, pose: str = "start") -> None:
        """Return to time 0 at a named pose of the rig.

        Args:
            seed: of the random numbers; the last one when omitted
            pose: named pose; arms that it does not name go to "start"

        Raises:
            UnknownNameError: no such pose; nothing changes
        """
        if pose not in self.rig.poses:
            raise UnknownNameError("pose", pose, self.rig.poses, f"rig {self.rig.name}")
        self._seed = self._seed if seed is None else seed
        self.rng = np.random.default_rng(self._seed)
        mujoco.mj_resetData(self._model, self._data)
        self._servos.commanded[:] = 0.0
        at = {**self.rig.poses["start"], **self.rig.poses[pose]}
        for name, arm in self.arms.items():
            if self.options.locked and name in self.options.locked:
                arm.start_at(self.options.locked[name])
            else:
                arm.start_at(at[name])
        mujoco.mj_forward(self._model, self._data)
        self._gravity.renew()
        self._gravity_due = GRAVITY_PERIOD_S

    def wait(self, motion: Motion, timeout_s: float | None) -> bool:
        """Step until a move is over, or leave the waiting to the loop that runs this world."""
        if self.waiter is not None:
            return self.waiter(motion, timeout_s)
        end = np.inf if timeout_s is None else self.time + timeout_s
        while not motion.done and self.time < end:
            self.step()
        return motion.goal_reached

    def set_state(self, name: str, q: Array, v: Array | None = None) -> None:
        """Put one arm at joint positions and velocities, (n,) each, with its loops closed."""
        arm = self.arm(name)
        arm.start_at(np.clip(q, arm.lower, arm.upper))
        self._drives[name].place(
            np.asarray(q, dtype=np.float64), np.zeros(len(q)) if v is None else v
        )
        self._drives[name].apply()

    # ------------------------------------------------------------------ looking

    def arm(self, name: str) -> Arm:
        """Return an arm.

        Raises:
            UnknownNameError: no such arm; the known ones are listed
        """
        if name not in self.arms:
            raise UnknownNameError("arm", name, self.arms, f"rig {self.rig.name}")
        return self.arms[name]

    def snapshot(self) -> Snapshot:
        """Return a frozen copy of where everything is."""
        centres = self.remote_centres()
        return Snapshot(
            self.time,
            self._data.xpos.copy(),
            self._data.xquat.copy(),
            {name: arm.snapshot(centres.get(name)) for name, arm in self.arms.items()},
        )

    def remote_centres(self) -> dict[str, Array]:
        """Return the remote centre of every arm that has one, in the world, (3,) [m]."""
        return {
            a.name: self.reference_pose(a.name)[:3, 3]
            for a in self.rig.arms
            if "rcm" in a.arm.mechanism.frame_index
        }

    def reference_pose(self, name: str) -> Array:
        """Return the pose of an arm's reference frame in the world, (4, 4)."""
        mechanism = self.rig.arm(name).arm.mechanism
        rest = np.zeros(len(mechanism.joints))
        fixed = pose(mechanism, rest, mechanism.reference, self.rig.arm(name).arm.root)
        return self.root_pose(name) @ fixed

    def root_pose(self, name: str) -> Array:
        """Return the pose of an arm's root in the world, by its carrier's measured joints."""
        rig_arm = self.rig.arm(name)
        if not rig_arm.on:
            return rig_arm.pose
        carrier = self.rig.arm(rig_arm.on)
        mount = pose(
            carrier.arm.mechanism,
            self.arms[rig_arm.on].readings()[0],
            rig_arm.frame,
            carrier.arm.root,
        )
        return self.root_pose(rig_arm.on) @ mount @ rig_arm.pose

    def base_pose(self, name: str) -> tuple[Array, str]:
        """Return an arm's reference frame in the frame of its public poses, and that one's name.

        A PSM's is the ECM's tip where the rig has an ECM, an ECM's the cart where it has setup
        joints; else the arm's own. Source: decisions.md, Frames.
        """
        arm = self.rig.arm(name)
        scope = next((a for a in self.rig.arms if a.arm.type == "ECM"), None)
        if arm.arm.type == "PSM" and scope is not None:
            tip = self.reference_pose(scope.name) @ self.arms[scope.name].local_measured_cp().T
            return inverse(tip) @ self.reference_pose(name), scope.name
        if arm.on or arm.arm.type == "SUJ":
            return self.reference_pose(name), "cart"
        return np.eye(4), f"{name}_base"

    def health(self) -> Health:
        """Return how well every arm's loops hold now."""
        each = {
            name: arm.health() for name, arm in self.arms.items() if not self._drives[name].welded
        }
        rcm = [h.rcm_error_m for h in each.values() if np.isfinite(h.rcm_error_m)]
        return Health(
            max((h.loop_gap_m for h in each.values()), default=0.0),
            max(rcm, default=0.0),
            all(h.branch_ok for h in each.values()),
            min((h.flattening_margin_rad for h in each.values()), default=np.inf),
            each,
        )

    def shapes(self) -> tuple[ShapeRecord, ...]:
        """Return every shape of the rig and the body that carries it, for drawing."""
        found: list[ShapeRecord] = []
        for prop in self.rig.props:
            body = self._model.body(prop.name).id
            for number, shape in enumerate(prop.shapes):
                found.append(_shape_record(shape, body, f"{prop.name}/{number}", None, ""))
        for arm in self.rig.arms:
            where = self._drives[arm.name].binding.frame_bodies
            for part in arm.arm.bodies:
                for number, shape in enumerate(part.shapes):
                    name = f"{arm.name}/{part.frame}/{part.part}/{number}"
                    found.append(
                        _shape_record(shape, where[part.frame], name, arm.name, part.frame)
                    )
        return tuple(found)

    # ------------------------------------------------------------------ inside

    def _advance(self, count: int) -> None:
        """Step the physics, and stop when it is no longer finite."""
        if self._load.size > 0.0:
            self._load.apply()
        if self._data.time >= self._gravity_due:
            self._gravity.renew()
            self._gravity_due = self._data.time + GRAVITY_PERIOD_S
        mujoco.mj_step(self._model, self._data, nstep=count)
        bad = self._bad
        if bad[BAD_QPOS] or bad[BAD_QVEL] or bad[BAD_QACC]:
            self._diverged()

    def _diverged(self) -> None:
        kind = next(k for k in (BAD_QPOS, BAD_QVEL, BAD_QACC) if self._bad[k])
        dof = int(self._data.warning.lastinfo[kind])
        joint = int(self._model.dof_jntid[min(dof, self._model.nv - 1)])
        name = self._model.joint(joint).name
        target = None
        owner = name.split("/")[0]
        if owner in self.arms:
            hinge = name.split("/")[1]
            for index, described in enumerate(self.arms[owner].description.joints):
                if hinge in dict(described.drive):
                    target = self.arms[owner].last_target(index)
        raise DivergedError(self.time, name, target, mujoco.mjtWarning(kind).name)


def _checked_period(timestep_s: float) -> float:
    if not np.isfinite(timestep_s) or not 0.0 < timestep_s <= 0.01:
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


def _shape_record(shape: Shape, body: int, name: str, arm: str | None, frame: str) -> ShapeRecord:
    look = MATERIALS[shape.material]
    return ShapeRecord(
        body,
        name,
        shape.kind,
        shape.size,
        shape.pose,
        look.rgba,
        look.gloss,
        look.metal,
        shape.rounding,
        arm,
        frame,
        shape.collide,
    )
