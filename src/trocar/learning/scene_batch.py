"""Many worlds of one scene side by side on CPU threads, by the rules of its task."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.records import GraspKind
from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import (
    matrices_from_rotation_vectors,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from trocar.geometry.se3 import inverse
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import nearest_solutions
from trocar.learning.batch_rules import SeenWorlds, batch_rules, obstacle
from trocar.learning.images import SceneCamera, SceneView
from trocar.learning.readings import NOTHING, SceneReadings
from trocar.simulation.arm import Arm
from trocar.simulation.batch import Batch
from trocar.tasks import Task
from trocar.tasks.controller import EVERY, GRIP_RAD, JAW_RAD_S, LAG, PERIOD_S, SLOWED
from trocar.tasks.randomisation import FIELDS, Sight
from trocar.tasks.referee import LOST_M, ROUNDING_S, SETTLED_S
from trocar.tasks.registry import make_task

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

#: Memory of a world beside MuJoCo's buffer: what its solver touches, and what is read from it.
#: Source: measured on needle-pick, bi-peg-transfer and peg-board: 0.26 to 0.42 MB. [bytes]
TOUCHED_BYTES = 500_000
#: Models of grasps.
GRASPS: tuple[GraspKind, ...] = get_args(GraspKind)
#: The orientation of a tip that points straight down.
DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class _BatchArm:
    """An arm that actions drive: its part of an action, its rows of joints, and its kinematics.

    Attributes:
        arm: of the nominal world
        part: of an action
        rows: of all joints
        base, T_arm_world: pose of its reference frame in the world, and its inverse, (4, 4)
        start: pose of its tip's set-point at a reset, (4, 4)
        fastest, tolerances: of its joints without the jaw, (k,)
    """

    arm: Arm
    part: slice
    rows: slice
    base: Array
    T_arm_world: Array
    start: Array
    fastest: Array
    tolerances: Array

    @property
    def has_jaw(self) -> bool:
        """Whether it is a PSM."""
        return self.arm.description.type == "PSM"

    def tips(self, q: Array) -> Array:
        """Return the tip in the world at joint positions, (n, 4, 4)."""
        return self.base @ chain_pose(self.arm.description.mechanism)(q)


class SceneBatch:
    """n worlds of one scene: actions in, readings out; each moves as the scene's task does.

    A world of the batch with a seed and actions is a `Task` with them whose rig has that model of
    grasps: the same motion to the last bit, the same grasps, rewards and endings. Two
    differences remain: in the period in which an arm goes into FAULT, its servos go on; and a batch
    counts no forces and paths, which only scores have.

    A world whose episode is over stays as it is until its next reset.

    Args:
        scene: a scene, its name, or the path of its TOML file
        n: number of worlds
        threads: CPU threads; None: one for each CPU
        seed: of the seeds that resets draw
        grasp: model of grasps; None: the rig's. "friction" takes the least time, as it looks at
            all worlds at once

    Attributes:
        task: one world of the scene, which the others follow; its own world stays where it began
        n: number of worlds
        physics: the worlds, whose fields may be given values of their own (`Batch.expand`)
        seeds: of the episodes, (n,)
        reward: of the last command, (n,)
        success, failed, late: how episodes ended: with success, failure, or the time over, (n,)
        drops: objects dropped so far, (n,)
        met_count: goals that are met, those of earlier stages included, (n,)

    Raises:
        InputError: n or threads is no whole number above 0, memory cannot hold so many worlds, or
            such scenes cannot run in a batch (`obstacle` says why)
        UnknownNameError, DescriptionError: as `make_task`
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        n: int,
        *,
        threads: int | None = None,
        seed: int = 0,
        grasp: GraspKind | None = None,
    ) -> None:
        found = scene if isinstance(scene, Scene) else load_scene(scene)
        if grasp is not None and grasp not in GRASPS:
            raise UnknownNameError("grasp", str(grasp), GRASPS, "SceneBatch")
        if why := obstacle(found):
            raise InputError(f"SceneBatch: {found.name}: {why}")
        found = replace(found, rig=replace(found.rig, grasp=grasp or found.rig.grasp))
        self.task: Task = make_task(found)
        self.scene, self.arms, world = found, self.task.arms, self.task.world
        _check_memory(n, self.task)
        self.physics = Batch(world, n, threads=threads, watch=True)
        self.n, self._count = self.physics.n, round(PERIOD_S / (EVERY * world.timestep))
        self._seeding = np.random.default_rng(seed)
        self._driven: dict[str, _BatchArm] = {}
        for name in self.arms:
            begin = max((one.part.stop for one in self._driven.values()), default=0)
            self._driven[name] = self._drive(name, begin)
        table = world.joints
        self._start = self.physics.setpoints[0].copy()
        self._fastest = np.full(len(table), np.inf)
        for name, driven in self._driven.items():
            joints = world.arms[name].description.joints
            self._fastest[driven.rows] = [joint.velocity_max for joint in joints]
        self.names = tuple(world.objects)
        self._hidden = found.hidden
        self._psms = [name for name, driven in self._driven.items() if driven.has_jaw]
        self._find_goals()
        grasps, rows = self.physics.grasps, {name: k for k, name in enumerate(self.names)}
        #: Rows of objects by those of what jaws can hold, and NOTHING; columns of the driven jaws.
        held = () if grasps is None else grasps.objects
        self._held_rows = np.array([*(rows[name] for name in held), NOTHING])
        jaws = () if grasps is None else grasps.arms
        self._jaws = {name: jaws.index(name) for name in self._psms if name in jaws}
        self._all = np.arange(self.n)
        self._sight: Sight | None = None
        if self.task.randomised is not None:
            self._sight = Sight(found.randomisation, len(self.names), self.n)
            self._fields = {name: self.physics.expand(name) for name in FIELDS}
            self._gains = np.tile(table.gains, (self.n, 1, 1))
        self._clear()
        rules = batch_rules(type(self.task))
        if rules is None:  # `obstacle` has said so
            raise InputError(f"SceneBatch: {found.name}: no rules of {type(self.task).__name__}")
        self._rules = rules(self._seen)
        self.reset()

    # ------------------------------------------------------------------ time

    @property
    def over(self) -> Bools:
        """Whether each episode is over, (n,)."""
        return self.success | self.failed | self.late

    def reset(
        self, mask: ArrayLike | None = None, seeds: Sequence[int] | ArrayLike | None = None
    ) -> None:
        """Begin episodes, each a function of its seed.

        Args:
            mask: worlds whose episodes begin, (n,) bool; all when omitted
            seeds: whole numbers from 0 on, one for each of these worlds; drawn when omitted

        Raises:
            InputError: a mask or seeds of another length or kind, or a seed with which no object
                has a free place or one is out of reach
        """
        which = self._all
        if mask is not None:
            chosen = np.asarray(mask)
            if chosen.shape != (self.n,) or chosen.dtype != np.bool_:
                raise InputError(f"reset: got a mask {mask!r}; allowed: {self.n} of True and False")
            which = which[chosen]
        if seeds is None:
            seeds = self._seeding.integers(2**31, size=len(which))
        drawn = np.asarray(seeds)
        if drawn.shape != (len(which),) or drawn.dtype.kind not in "iu" or (drawn < 0).any():
            raise InputError(
                f"reset: got seeds {seeds!r}; allowed: {len(which)} whole numbers from 0 on"
            )
        if len(which):
            self._place(which, drawn)
            self._begin(which)

    def command(self, actions: ArrayLike) -> Array:
        """Drive all arms for one period of 20 ms and return the rewards, (n,).

        Args:
            actions: of `TipController` for each world, (n, k); those of worlds whose episodes are
                over are left out

        Raises:
            InputError: another shape, or numbers that are not finite, with the world's number;
                nothing moves
            DivergedError: the simulation of a world diverged
        """
        values, running = self._checked(actions), ~self.over
        self.reward = np.zeros(self.n)
        which = np.flatnonzero(running)
        if len(which):
            before = self._joints[which]
            after = before.copy()
            measured = self._q[which]
            for name, driven in self._driven.items():
                own, action = driven.rows, values[which, driven.part]
                after[:, own] = (
                    self._next(name, which, before[:, own], measured[:, own], action)
                    if driven.has_jaw
                    else np.clip(
                        before[:, own] + action * PERIOD_S,
                        driven.arm.joints.lower,
                        driven.arm.joints.upper,
                    )
                )
            change = after - before
            self._velocities[which] = np.clip(change / PERIOD_S, -self._fastest, self._fastest)
            for k in range(1, self._count + 1):
                self._joints[which] = before + (k / self._count) * change
                self.physics.drive(self._joints, self._velocities)
                self.physics.advance(EVERY, None if len(which) == self.n else which)
            self._joints[which] = after
            self._look(which)
        return self.reward.copy()

    def truncate(self, mask: Bools) -> None:
        """End episodes that run on, as their time is over by other rules, (n,)."""
        self.late |= mask & ~self.over

    # ------------------------------------------------------------------ looking

    @property
    def limits(self) -> tuple[Array, Array]:
        """The least and largest values of an action, (k,) each."""
        return self.task.limits

    @property
    def readings(self) -> SceneReadings:
        """Readings of all worlds, as of the last command or reset."""
        if self._readings is None:
            shown, setpoints = self._shown, self.physics.setpoints
            places, achieved = self._seen.places, self._achieved
            if self._sight is not None:
                places, achieved = self._sighted()
            self._readings = SceneReadings(
                time=self._seen.time.copy(),
                tips={name: self._seen.tips[name].copy() for name in self._psms},
                targets={name: self._targets[name].copy() for name in self._psms},
                q={name: self._q[:, d.rows].copy() for name, d in self._driven.items()},
                v={name: self._qd[:, d.rows].copy() for name, d in self._driven.items()},
                setpoints={name: setpoints[:, d.rows] for name, d in self._driven.items()},
                objects={
                    name: self._observed[:, row].copy()
                    for row, name in enumerate(self.names)
                    if name not in self._hidden
                },
                held={name: self._held_by(name, self._all) for name in self._psms},
                names=self.names,
                stalled={name: self._stalled[name].copy() for name in self._psms},
                goals=places[:, shown],
                achieved=achieved[:, shown],
                met=self._met[:, shown],
            )
        return self._readings

    def images(self, worlds: Sequence[int], camera: SceneCamera | SceneView) -> NDArray[np.uint8]:
        """Return images of some worlds, (k, height, width, channels); one renderer draws all.

        Args:
            worlds: their numbers
            camera: of `task`
        """
        shown = self.task.world.mj_data.qpos
        kept, found = shown.copy(), list[NDArray[np.uint8]]()
        for world in worlds:
            self.physics.show(world, shown)
            if self.task.randomised is not None:
                self.task.randomised.aim(int(self.seeds[world]))
            found.append(camera.capture())
        shown[:] = kept
        return np.stack(found)

    def idle(self) -> Array:
        """Return the actions that hold all arms, (n, k)."""
        found = np.zeros((self.n, len(self.limits[0])))
        for driven in self._driven.values():
            if driven.has_jaw:
                found[:, driven.part.stop - 1] = self._joints[:, driven.rows.stop - 1]
        return found

    # ------------------------------------------------------------------ construction

    def _drive(self, name: str, begin: int) -> _BatchArm:
        """Return an arm, whose part of an action begins there."""
        world, controller = self.task.world, self.task.controller
        arm, index = world.arms[name], world.joints.arms[name]
        joints, psm = arm.description.joints, arm.description.type == "PSM"
        base = world.reference_pose(name)
        start = controller.target(name) if psm else arm.measured_cp("world").matrix
        own = joints[:-1] if psm else joints
        part = slice(begin, begin + (7 if psm else len(joints)))
        return _BatchArm(
            arm,
            part,
            index.rows,
            base,
            inverse(base),
            start,
            np.array([joint.velocity_max for joint in own]),
            np.array([joint.tracking_tolerance for joint in own]),
        )

    def _find_goals(self) -> None:
        """Resolve the goals' names."""
        goals, rows = self.scene.goals, {name: k for k, name in enumerate(self.names)}
        self._goal_at = np.array([goal.at for goal in goals])
        self._spread = np.array([goal.spread for goal in goals])
        self._radius = np.array([goal.radius for goal in goals])
        self._height = np.array([goal.height for goal in goals])
        self._stages = np.array([goal.stage for goal in goals])
        self._last_stage = int(self._stages.max())
        self._goal_object = np.array([rows.get(goal.object, NOTHING) for goal in goals])
        self._on = np.array([rows.get(goal.on, NOTHING) for goal in goals])
        #: Goals of tips, by arm; of those, whether they are beside an object.
        self._of_tip = [bool(goal.arm) and not goal.held for goal in goals]
        self._holding = np.array([goal.held for goal in goals])
        self._shown = np.array([goal.on not in self._hidden for goal in goals])
        #: Objects that a reset puts somewhere and goals, which must be in reach; and which PSMs may
        #: reach them, (PSMs, of both).
        self._put = [rows[place.object] for place in self.scene.placements]
        self._reached = [k for k, g in enumerate(goals) if g.held or not (g.arm and g.object)]
        at_arm = [*([""] * len(self._put)), *(goals[k].arm for k in self._reached)]
        may = [[arm in ("", name) for arm in at_arm] for name in self._psms]
        self._reachers = np.array(may, np.bool_).reshape(len(self._psms), len(at_arm))

    def _clear(self) -> None:
        """Make the arrays that resets fill."""
        n, count, goals = self.n, len(self.names), len(self.scene.goals)
        self.seeds = np.zeros(n, np.int64)
        self.reward, self.drops = np.zeros(n), np.zeros(n, np.intp)
        self.success, self.failed, self.late = (np.zeros(n, np.bool_) for _ in range(3))
        self.met_count, self._stage = np.zeros(n, np.intp), np.zeros(n, np.intp)
        self._settling, self._floor = np.full(n, np.nan), np.zeros(n)
        self._joints = np.tile(self._start, (n, 1))
        self._velocities = np.zeros_like(self._joints)
        self._q, self._qd = np.zeros_like(self._joints), np.zeros_like(self._joints)
        self._targets = {name: np.tile(np.eye(4), (n, 1, 1)) for name in self._psms}
        self._stalled = {name: np.zeros(n, np.bool_) for name in self._psms}
        self._fell_from = np.full((n, count), np.nan)
        self._held = np.zeros((n, count), np.bool_)
        self._achieved, self._met = np.zeros((n, goals, 3)), np.zeros((n, goals), np.bool_)
        self._seen = SeenWorlds(
            task=self.task,
            physics=self.physics,
            time=np.zeros(n),
            tips={name: np.tile(np.eye(4), (n, 1, 1)) for name in self.arms},
            objects=np.zeros((n, count, 7)),
            drawn=np.zeros((n, goals, 3)),
            places=np.zeros((n, goals, 3)),
        )
        self._observed = np.zeros((n, count, 7)) if self._sight else self._seen.objects
        self._readings: SceneReadings | None = None

    # ------------------------------------------------------------------ a reset

    def _place(self, which: Index, seeds: Array) -> None:
        """Put worlds back, with objects and goals where their seeds have them."""
        physics, scene = self.physics, self.scene
        physics.put_back(which)
        if self._sight is not None:
            self._draw(self._sight, which, seeds)
        for world, seed in zip(which.tolist(), seeds.tolist(), strict=True):
            rng = np.random.default_rng(seed)
            placed = scene.placed(rng)
            if placed:
                T = np.stack(list(placed.values()))
                at = np.concatenate([T[:, :3, 3], quaternion_from_matrix(T[:, :3, :3])], axis=1)
                physics.place(world, tuple(placed), at)
            draws = rng.uniform(-1.0, 1.0, self._spread.shape)
            self._seen.drawn[world] = self._goal_at + self._spread * draws
        self._seen.objects[which] = physics.object_poses(which)
        places = self._goal_places(which)
        self._floor[which] = places[:, :, 2].min(axis=1) - LOST_M
        self.seeds[which] = seeds
        self._check_reach(which, places)

    def _draw(self, sight: Sight, which: Index, seeds: Array) -> None:
        """Draw worlds anew, as the task's own world draws itself at a reset."""
        own, numbers = self.task.world, which.tolist()
        sight.begin(seeds.tolist(), numbers)
        for world, seed in zip(numbers, seeds.tolist(), strict=True):
            own.reset(seed)
            for name, field in self._fields.items():
                field[world] = getattr(own.mj_model, name)
            self._gains[world] = own.servos.gains
            self.physics.put_back(np.array([world]), own.save().row)
        self.physics.set_gains(*np.moveaxis(self._gains, -1, 0))

    def _check_reach(self, which: Index, places: Array) -> None:
        """Reject the first seed with a place out of reach, as the task does."""
        at = np.concatenate(
            [self._seen.objects[which][:, self._put, :3], places[:, self._reached]], axis=1
        )
        fine = np.zeros(at.shape[:2], np.bool_)
        fine[:] = ~self._reachers.any(axis=0)
        for may, name in zip(self._reachers, self._psms, strict=True):
            todo = may & ~fine
            if not todo.any():
                continue
            driven, T = self._driven[name], np.zeros((int(todo.sum()), 4, 4))
            T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = DOWN, at[todo], 1.0
            near = np.broadcast_to(self._start[driven.rows][:-1], (len(T), 6))
            fine[todo] = ~np.isnan(self._inverse(driven, T, near)[:, 0])
        if not (reached := fine.all(axis=1)).all():
            try:
                self.task.reset(int(self.seeds[which[np.argmin(reached)]]))
            finally:
                self.task.reset(0)

    def _begin(self, which: Index) -> None:
        """Begin to count in some worlds."""
        self._joints[which], self._velocities[which] = self._start, 0.0
        for name in self._psms:
            self._targets[name][which] = self._driven[name].start
            self._stalled[name][which] = False
        self.drops[which] = self.met_count[which] = self._stage[which] = 0
        self._settling[which], self._fell_from[which] = np.nan, np.nan
        self._held[which] = False
        for ending in (self.success, self.failed, self.late):
            ending[which] = False
        self._rules.begin(which)
        self._look(which)
        self.reward[which] = 0.0

    # ------------------------------------------------------------------ set-points

    def _checked(self, actions: ArrayLike) -> Array:
        """Return actions inside the limits, (n, k)."""
        low, high = self.limits
        label, allowed = self.scene.name, f"{self.n} actions of {len(high)} finite numbers"
        try:
            values = np.asarray(actions, np.float64)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{label}: got actions {actions!r}; allowed: {allowed}") from None
        if values.shape != (self.n, len(high)):
            raise InputError(f"{label}: got actions of shape {values.shape}; allowed: {allowed}")
        if not (fine := np.isfinite(values).all(axis=1)).all():
            world = int(np.argmin(fine))
            raise InputError(
                f"{label}: world {world}: got the action {values[world].tolist()}; allowed:"
                f" {len(high)} finite numbers"
            )
        return np.minimum(np.maximum(values, low), high)

    def _next(
        self, name: str, which: Index, before: Array, measured: Array, values: Array
    ) -> Array:
        """Return a PSM's set-points after an action, as `TipController` has them, (k, j)."""
        after, stalled = before.copy(), np.zeros(len(which), np.bool_)
        moving = np.flatnonzero(values[:, :6].any(axis=1))
        if len(moving):
            after[moving], stalled[moving] = self._onward(
                name, which[moving], before[moving], measured[moving], values[moving, :6]
            )
        self._stalled[name][which] = stalled
        opening = values[:, 6]
        opening = np.where(opening < 0.0, np.maximum(opening, measured[:, -1] - GRIP_RAD), opening)
        fastest = JAW_RAD_S * PERIOD_S
        after[:, -1] = before[:, -1] + np.clip(opening - before[:, -1], -fastest, fastest)
        return after

    def _onward(
        self, name: str, which: Index, before: Array, measured: Array, twist: Array
    ) -> tuple[Array, Bools]:
        """Return set-points of PSMs a period on, as fast as their joints may, and which stay."""
        driven, targets = self._driven[name], self._targets[name][which]
        q, todo = before[:, :-1], np.arange(len(which))
        found, stalled = before.copy(), np.ones(len(which), np.bool_)
        for _ in range(2):
            goal = targets[todo]
            goal[:, :3, 3] += twist[:, :3] * PERIOD_S
            turning = twist[:, 3:].any(axis=1)
            if turning.any():
                turns = matrices_from_rotation_vectors(twist[turning, 3:] * PERIOD_S)
                goal[turning, :3, :3] = turns @ goal[turning, :3, :3]
            after = self._inverse(driven, goal, q[todo])
            haste = (np.abs(after - q[todo]) / (driven.fastest * PERIOD_S)).max(axis=1)
            slow = haste <= 1.0  # NaN out of reach is not
            if slow.any():
                ahead, was = np.abs(after - measured[todo, :-1]), np.abs(q - measured[:, :-1])[todo]
                pushed = ((ahead > LAG * driven.tolerances) & (ahead > was)).any(axis=1)
                goes = slow & ~pushed
                there = todo[goes]
                self._targets[name][which[there]] = goal[goes]
                found[there, :-1], stalled[there] = after[goes], False
            again = haste > 1.0
            if not again.any():
                break
            todo, twist = todo[again], twist[again] * (SLOWED / haste[again])[:, None]
        return found, stalled

    def _inverse(self, driven: _BatchArm, T: Array, near: Array) -> Array:
        """Return joint positions nearest to others with tips at poses in the world, (k, j)."""
        arm = driven.arm.description
        structure = arm.inverse_kinematics
        return nearest_solutions(arm.mechanism, structure, driven.T_arm_world @ T, near)

    # ------------------------------------------------------------------ judging

    def _goal_places(self, which: Index) -> Array:
        """Return the places of goals in the world now, without what they are beside, (k, G, 3)."""
        return self._goals_on(which, self._seen.objects)

    def _goals_on(self, which: Index, objects: Array) -> Array:
        """Return the places of goals that stand on objects at poses (n, O, 7), (k, G, 3)."""
        places = self._seen.drawn[which]
        if (riding := self._on >= 0).any():
            at = objects[which][:, self._on[riding]]
            turned = matrix_from_quaternion(at[..., 3:]) @ places[:, riding, :, None]
            places[:, riding] = turned[..., 0] + at[..., :3]
        return places

    def _sighted(self) -> tuple[Array, Array]:
        """Return places of goals, and of what shall be there, by objects as cameras see them."""
        places, achieved = self._goals_on(self._all, self._observed), self._achieved.copy()
        for k, (row, of_tip) in enumerate(zip(self._goal_object, self._of_tip, strict=True)):
            if of_tip and row >= 0:
                places[:, k] += self._observed[:, row, :3]
            elif not of_tip:
                achieved[:, k] = self._observed[:, row, :3]
        return places, achieved

    def _held_by(self, name: str, which: Index) -> Index:
        """Return the row of the object that an arm holds in some worlds, or NOTHING, (k,)."""
        grasps = self.physics.grasps
        if grasps is None or name not in self._jaws:
            return np.full(len(which), NOTHING)
        return self._held_rows[grasps.held[which, self._jaws[name]]]

    def _look(self, which: Index) -> None:
        """Read and judge some worlds, as `Referee` does."""
        self._readings = None
        self._seen.time[which] = self.physics.times()[which]
        self._q[which], self._qd[which] = self.physics.motion(which)
        for name, driven in self._driven.items():
            self._seen.tips[name][which] = driven.tips(self._q[which][:, driven.rows])
        objects = self._seen.objects[which] = self.physics.object_poses(which)
        if self._sight is not None:
            self._observed[which] = self._sight.see(objects, which)
        holds = {name: self._held_by(name, which) for name in self._psms}
        self._count_drops(which, objects, holds)
        self._rules.measure(which, holds)
        met = self._met[which] = self._judged_goals(which, objects, holds)
        self._judge(which, met)

    def _count_drops(self, which: Index, objects: Array, holds: dict[str, Index]) -> None:
        """Count objects that fell since a jaw released them."""
        before, now = self._held[which], np.zeros((len(which), len(self.names)), np.bool_)
        for rows in holds.values():
            some = np.flatnonzero(rows >= 0)
            now[some, rows[some]] = True
        self._held[which] = now
        heights, fell_from = objects[:, :, 2], self._fell_from[which]
        fell_from = np.where(before & ~now, heights, np.where(now, np.nan, fell_from))
        fell = fell_from - heights > self.scene.drop_height  # never of NaN
        self.drops[which] += fell.sum(axis=1)
        self._fell_from[which] = np.where(fell, np.nan, fell_from)

    def _judged_goals(self, which: Index, objects: Array, holds: dict[str, Index]) -> Bools:
        """Judge goals in some worlds and return those that are met, (k, G)."""
        places = self._goal_places(which)
        achieved = np.empty_like(places)
        allowed = np.ones(places.shape[:2], np.bool_)
        held = self._held[which]
        for k, goal in enumerate(self.scene.goals):
            row = int(self._goal_object[k])
            if self._of_tip[k]:
                achieved[:, k] = self._seen.tips[goal.arm][which][:, :3, 3]
                if goal.object:
                    places[:, k] += objects[:, row, :3]
            else:
                achieved[:, k] = objects[:, row, :3]
                holding = holds[goal.arm] == row if goal.arm else held[:, row]
                allowed[:, k] = holding == goal.held
        self._seen.places[which], self._achieved[which] = places, achieved
        off = achieved - places
        near = np.hypot(off[:, :, 0], off[:, :, 1]) <= self._radius
        near &= np.abs(off[:, :, 2]) <= self._height
        return self._rules.met(which, near & allowed)

    def _judge(self, which: Index, met: Bools) -> None:
        """Count goals and end episodes."""
        stage, time = self._stage[which][:, None], self._seen.time[which]
        earlier, now = self._stages < stage, self._stages == stage
        count = (earlier | (now & met)).sum(axis=1)
        self.reward[which] = (count - self.met_count[which]) / len(self._stages)
        self.met_count[which] = count
        every = count == (earlier | now).sum(axis=1)
        settling = self._settling[which]
        settling = np.where(every, np.where(np.isnan(settling), time, settling), np.nan)
        settled = time - settling >= SETTLED_S
        goes_on = settled & (stage[:, 0] < self._last_stage)
        if goes_on.any():
            later = np.where(self._stages > stage, self._stages, self._last_stage).min(axis=1)
            self._stage[which] = np.where(goes_on, later, stage[:, 0])
            settling = np.where(goes_on, np.nan, settling)
            settled &= ~goes_on
        self._settling[which] = settling
        late = time >= self.scene.time_limit - ROUNDING_S
        success = self._rules.accomplished(which, settled, late)
        fault = np.zeros(len(which), np.bool_)
        for driven in self._driven.values():
            fault |= self.physics.tripped[which][:, driven.rows].any(axis=1)
        lost = (self._seen.objects[which][:, :, 2] < self._floor[which][:, None]).sum(axis=1)
        lost[success | fault] = 0
        self.drops[which] += lost
        failed = ~success & (fault | (lost > 0))
        self.success[which], self.failed[which] = success, failed
        self.late[which] = late & ~success & ~failed


def free_memory() -> int:
    """Return the memory that new worlds may take [bytes]."""
    table = Path("/proc/meminfo")
    for line in table.read_text("ascii").splitlines() if table.exists() else ():
        if line.startswith("MemAvailable:"):
            return 1024 * int(line.split()[1])
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2


def _check_memory(n: int, task: Task) -> None:
    """Reject a number of worlds that memory cannot hold."""
    if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or n < 1:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
        raise InputError(f"SceneBatch: got n={n!r}; allowed: a whole number above 0")
    each = int(task.world.mj_data.nbuffer) + TOUCHED_BYTES
    free = free_memory()
    if n * each > free:
        raise InputError(
            f"SceneBatch: {task.scene.name}: got n={n}, which takes {n * each / 1e9:.1f} GB;"
            f" allowed: up to {free // each}, which fit into the {free / 1e9:.1f} GB that are free"
        )
