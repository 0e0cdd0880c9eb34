"""A scene as a task: reset, observation, command, reward, done and score of an episode.

`tasks/registry.py` lists the classes of tasks.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.scenes import Goal, Scene
from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry.rotations import (
    matrix_from_rotation_vector,
    quaternion_from_matrix,
)
from trocar.geometry.se3 import inverse, transform
from trocar.simulation import World
from trocar.simulation.jaw import Jaw
from trocar.tasks.scoring import fls_score

Array = NDArray[np.float64]
#: Set-points and their velocities of arms, {arm: (q, v)}.
Row = dict[str, tuple[Array, Array]]

#: Time that a command lasts. Source: our own choice, 50 Hz. [s]
PERIOD_S = 0.02
#: Physics steps between the set-points of a command: straight lines between its ends.
#: Source: our own choice.
EVERY = 10
#: Largest speeds of a tip, of its rotation and of the jaw. Source: our own choice; instruments move
#: at up to 0.1 m/s in peg transfers (`trocar score`). [m/s, rad/s, rad/s]
SPEED_M_S, SPIN_RAD_S, JAW_RAD_S = 0.2, 4.0, 5.0
#: A grip closes so far beyond what the jaw measures. Source: the servo (6 N m/rad) then exerts its
#: 0.16 N m ten times over, and the tracking tolerance of 0.6 rad is not reached. [rad]
GRIP_RAD = 0.3
#: Set-points go no further from the measured joints than this share of the tolerance beyond which
#: an arm goes into FAULT, as when it presses on the table. Source: our own choice.
LAG = 0.5
#: A joint that would be too fast gets this share of its greatest velocity. Source: our own choice;
#: joints do not move in proportion to the tip.
SLOWED = 0.95
#: Velocities of an endoscope stay this far below its limits. Source: our own choice, rounding.
ROUNDING = 1e-9
#: What limits the set-points of a joint.
BOUNDS = "velocity_max", "tracking_tolerance"
#: Goals must be met for so long. Source: our own choice. [s]
SETTLED_S = 0.2
#: An object this far below the lowest goal is out of play. Source: our own choice. [m]
LOST_M = 0.05


@dataclass(frozen=True)
class Episode:
    """What came of an episode; it follows from scene, seed and policy, to the last bit.

    Attributes:
        scene, seed: which
        success: whether all goals were met, and stayed so
        reason: why it ended: "done", what went wrong, or "time" with what held an arm back then
        score: points, see `fls_score`
        time_s: until it ended, simulated [s]
        goals, met: how many there are, and how many were met in the end
        drops: objects that fell after they were held, or left the table
        distance_m: {arm: length of the tip's path} [m]
        force_n: {arm: largest net force of contacts on it} [N]
        grip_n: {arm: largest force of the weaker finger on an object} [N]
        stalled_s: {arm: how long it stayed where it was though an action moves it} [s]
        grasp: what holds objects, as the rig has it: "friction+stick"
        dynamics: of the arms, as the rig has them: "cad"
        digest: of the physics state in the end
        figures: what else the scene measures, by name with its unit
    """

    scene: str
    seed: int
    success: bool
    reason: str
    score: float
    time_s: float
    goals: int
    met: int
    drops: int
    distance_m: Mapping[str, float]
    force_n: Mapping[str, float]
    grip_n: Mapping[str, float]
    stalled_s: Mapping[str, float]
    grasp: str
    dynamics: str
    digest: str
    figures: Mapping[str, Any] = field(default_factory=dict[str, Any])


class Task:
    """A scene with its world, and the bookkeeping of an episode; a class of tasks extends it.

    An action has seven numbers for each PSM of `scene.arms`: velocity of the tip and its angular
    velocity in axes of the world [m/s, rad/s], opening of the jaw, grip below 0 [rad]; and four
    for an ECM, the velocities of its joints [rad/s, m/s]. Values beyond `limits` are clipped.

    Args:
        scene: what to do

    Attributes:
        scene, world: as given, and the simulation
        arms: that an action drives, in its order
        goals: of this episode, with places drawn
        stage: of the goals that count now
        drops: objects dropped so far
        done: whether the episode is over
        reason: why: "done", "time", or what went wrong; "" before
        remarks: of the policy, about what it could not do; they stand in the reason
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.world = World(scene.rig, welded=scene.welded)
        self.world.rig_source = scene.file  # by which a recording of it is replayed
        self.arms = scene.arms
        self._slices: dict[str, slice] = {}
        self._bounds: dict[str, tuple[Array, Array]] = {}
        low: list[float] = []
        high: list[float] = []
        for name in self.arms:
            begin, arm = len(high), self.world.arms[name]
            if arm.description.type == "PSM":
                joints = arm.description.joints[:-1]
                most, tolerances = ([getattr(joint, key) for joint in joints] for key in BOUNDS)
                self._bounds[name] = np.array(most), np.array(tolerances)
                high += [SPEED_M_S] * 3 + [SPIN_RAD_S] * 3 + [float(arm.joints.upper[-1])]
                low += [-SPEED_M_S] * 3 + [-SPIN_RAD_S] * 3 + [-GRIP_RAD]
            else:
                most = [(1.0 - ROUNDING) * joint.velocity_max for joint in arm.description.joints]
                high += most
                low += [-value for value in most]
            self._slices[name] = slice(begin, len(high))
        #: The least and largest values of an action.
        self.limits: tuple[Array, Array] = np.array(low), np.array(high)
        self._names = tuple(self.world.objects)
        #: World in the frames of arms that stand in it, which never move.
        self._own = {
            place.name: inverse(self.world.reference_pose(place.name))
            for place in self.world.rig.arms
            if not place.on
        }
        self.reset(0)

    # ------------------------------------------------------------------ episode

    def reset(self, seed: int) -> dict[str, Array]:
        """Begin an episode, a function of the seed; return its first observation.

        Raises:
            InputError: no free place for an object, or one that no arm reaches
        """
        world, scene = self.world, self.scene
        world.reset(seed)
        rng = np.random.default_rng(seed)
        self._joints = {name: world.arms[name].joints.setpoints() for name in self.arms}
        for name, T in scene.placed(rng).items():
            self._check_reach(name, T[:3, 3])
            world.objects[name].set_cp(T)
        self.goals = tuple(
            (goal, goal.at + goal.spread * rng.uniform(-1.0, 1.0, 3)) for goal in scene.goals
        )
        for goal, at in self.goals:
            if goal.held or not (goal.arm and goal.object):
                self._check_reach(goal.arm or goal.object, self.place(goal, at))
        self._floor = min(self.place(goal, at)[2] for goal, at in self.goals) - LOST_M
        self._begin()
        return self.observation()

    def _begin(self) -> None:
        """Begin to count, from where everything is."""
        world = self.world
        self._targets: dict[str, Array] = {}
        self._joints = {name: world.arms[name].joints.setpoints() for name in self.arms}
        for name in self.arms:
            if world.arms[name].description.type == "PSM":
                self._targets[name] = world.arms[name].measured_cp("world").T
        self.drops, self.done, self.reason = 0, False, ""
        self.success, self.time = False, 0.0
        self._since: float | None = None
        self.stage, self._reward, self._met = 0, 0.0, 0
        self._held: dict[str, str] = {}
        self._fell_from: dict[str, float] = {}
        self.distance = dict.fromkeys(self.arms, 0.0)
        self.force = dict.fromkeys(self.arms, 0.0)
        self.grip = dict.fromkeys(self.arms, 0.0)
        self.stalled = dict.fromkeys(self.arms, 0.0)
        self._reasons: dict[str, str] = {}
        self.remarks: list[str] = []
        self._tips = {name: world.arms[name].measured_cp("world").T[:3, 3] for name in self.arms}
        self.look()
        self._reward = 0.0

    def observation(self) -> dict[str, Array]:
        """Return what a policy may see, in the world and in SI.

        Returns:
            {arm: tip position and quaternion wxyz, and opening of the jaw (8,); joints of an ECM
            (4,)}, {object: position and quaternion (7,)}, "goals": (n, 3), "time": (1,); without
            the scene's hidden objects and goals on them
        """
        found: dict[str, Array] = {}
        for name in self.arms:
            arm = self.world.arms[name]
            q = arm.joints.positions()
            if arm.description.type == "PSM":
                T = arm.measured_cp("world").T
                found[name] = np.concatenate([T[:3, 3], quaternion_from_matrix(T[:3, :3]), q[-1:]])
            else:
                found[name] = q
        states = self.world.object_states()
        hidden = self.scene.hidden
        for row, name in enumerate(states.names):
            if name not in hidden:
                found[name] = np.concatenate([states.positions[row], states.quaternions[row]])
        seen = [self.place(goal, at) for goal, at in self.goals if goal.on not in hidden]
        found["goals"] = np.array(seen).reshape(-1, 3)
        found["time"] = np.array([self.world.time])
        return found

    def command(self, action: ArrayLike) -> float:
        """Drive the arms for one period of 20 ms and return the reward.

        Args:
            action: see the class

        Raises:
            InputError: another shape or numbers that are not finite; nothing moves
            DivergedError: the simulation diverged
        """
        for row in self.setpoints(action):
            self.drive(row)
            self.world.step(EVERY)
        self.look()
        return self._reward

    def setpoints(self, action: ArrayLike) -> list[Row]:
        """Return the set-points of a period, one row for every `EVERY` physics steps.

        After the first row, rows lack arms that rest, and jaws that do.

        Raises:
            InputError: as for `command`
        """
        low, high = self.limits
        try:
            values = np.asarray(action, np.float64)
        except (TypeError, ValueError, OverflowError):
            values = np.full(1, np.nan)
        if values.shape != high.shape or not np.isfinite(values).all():
            raise InputError(
                f"{self.scene.name}: got the action {action!r}; allowed: {len(high)} finite numbers"
            )
        if self.done:
            raise InputError(f"{self.scene.name}: the episode is over; allowed: reset")
        values = np.minimum(np.maximum(values, low), high)
        count = round(PERIOD_S / (EVERY * self.world.timestep))
        rows: list[Row] = [{} for _ in range(count)]
        for name in self.arms:
            before = self._joints[name]
            after = self._next(name, before, values[self._slices[name]])
            change = after - before
            own = self.world.arms[name].description.own_joints
            part = slice(None) if change[own:].any() else slice(own)
            for k, row in enumerate(rows if change.any() else rows[:1], 1):
                q, v = before + (k / count) * change, change / PERIOD_S
                row[name] = (q, v) if k == 1 else (q[part], v[part])
            self._joints[name] = after
        return rows

    def drive(self, row: Row) -> None:
        """Command the arms' servos, as `setpoints` has it."""
        for name, (q, v) in row.items():
            arm = self.world.arms[name]
            own = arm.description.own_joints
            arm.servo_jp(q[:own], v[:own])
            if len(q) > own:
                cast(Jaw, arm.jaw).servo_jp(q[own:], v[own:])

    def reward(self) -> float:
        """Return the change of the share of goals that are met, of the last command."""
        return self._reward

    def score(self) -> float:
        """Return the points of the episode as `fls_score` has them."""
        wrong = len(self.goals) - self._met
        limit = self.scene.time_limit
        return fls_score(min(self.time, limit), len(self.goals), self.drops, wrong, limit)

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy from the state of the task.

        Raises:
            InputError: the task has none
        """
        raise InputError(f"{self.scene.name}: has no scripted policy; allowed: none")

    def state(self) -> dict[str, Any]:
        """Return what counts so far, as plain values."""
        return {
            "scene": self.scene.name,
            "time_s": round(self.time, 3),
            "score": round(self.score(), 1),
            "goals": len(self.goals),
            "met": self._met,
            "drops": self.drops,
            "done": self.done,
            "reason": self.reason,
            "stalled": {name: why for name, why in self._reasons.items() if why},
        }

    def result(self, seed: int) -> Episode:
        """Return what came of the episode."""
        return Episode(
            scene=self.scene.name,
            seed=seed,
            success=self.success,
            reason=self.reason or "running",
            score=self.score(),
            time_s=self.time,
            goals=len(self.goals),
            met=self._met,
            drops=self.drops,
            distance_m=dict(self.distance),
            force_n=dict(self.force),
            grip_n=dict(self.grip),
            grasp=self.world.rig.grasp,
            dynamics=self.world.rig.dynamics,
            stalled_s=dict(self.stalled),
            digest=hashlib.sha256(self.world.save().row.tobytes()).hexdigest()[:16],
            figures=self.figures(),
        )

    #: Further topics that are served, {name: help}; their messages are JSON.
    topics: Mapping[str, str] = {}
    #: Whether the task looks at images, by the settings of `Scene.look`.
    sees = False
    #: Draws into an eye's image of a frame (0 left, 1 right), from any thread.
    overlay: Callable[[Any, int], NDArray[np.uint8]] | None = None

    def messages(self) -> dict[str, Any]:
        """Return what is to be sent on further topics since the last call, {name: content}."""
        return {}

    def figures(self) -> dict[str, Any]:
        """Return what else the scene measures, by name with its unit; none here."""
        return {}

    def picture(self, capture: Callable[[], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return an image for a video: what the endoscope sees, unless the task draws its own."""
        return capture()

    def close(self) -> None:
        """Release what the task opened."""

    # ------------------------------------------------------------------ looking

    def target(self, arm: str) -> Array:
        """Return the set-point of a tip in the world, (4, 4)."""
        return self._targets[arm].copy()

    def farthest(self, arm: str, T: Array) -> float:
        """Return the largest change of a joint from its set-point to a pose of the tip.

        Args:
            arm: a PSM
            T: in the world, (4, 4)

        Returns:
            [rad or m]; infinite out of reach
        """
        near = self._joints[arm]
        try:
            return float(np.abs(self._inverse(arm, T, near) - near[:-1]).max())
        except (UnreachableError, SingularError):
            return np.inf

    def idle(self) -> dict[str, Array]:
        """Return each arm's part of the action that holds it, {arm: (7,) or (4,)}."""
        found = {name: np.zeros(part.stop - part.start) for name, part in self._slices.items()}
        for name in self._targets:
            found[name][-1] = self._joints[name][-1]
        return found

    def stay(self) -> Array:
        """Return the action that holds all arms."""
        parts = self.idle()
        return np.concatenate([parts[arm] for arm in self.arms])

    def object_pose(self, name: str) -> Array:
        """Return where an object is in the world, (4, 4)."""
        return self.world.object(name).measured_cp().T

    def position(self, name: str) -> Array:
        """Return where an object was when `look` was called last, (3,) [m]."""
        return self._states.positions[self._names.index(name)]

    def held(self, arm: str) -> str:
        """Return the object that both fingers of an arm press, "" for none."""
        return self._held.get(arm, "")

    def place(self, goal: Goal, at: Array) -> Array:
        """Return where a goal is in the world, (3,) [m]."""
        if not goal.on:
            return at
        T = self.object_pose(goal.on)
        return T[:3, :3] @ at + T[:3, 3]

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether a goal is met, as of the last `look`."""
        at = self.place(goal, at)
        if goal.arm and not goal.held:
            off = self.world.arms[goal.arm].measured_cp("world").T[:3, 3] - at
            if goal.object:
                off -= self.position(goal.object)
        else:
            holders = [arm for arm, name in self._held.items() if name == goal.object]
            if goal.held != (goal.arm in holders if goal.arm else bool(holders)):
                return False
            off = self.position(goal.object) - at
        x, y, z = off.tolist()
        return math.hypot(x, y) <= goal.radius and abs(z) <= goal.height

    def look(self) -> None:
        """Note grasps, drops, forces, paths and goals; call it every period, whoever drives."""
        world = self.world
        if world.time < self.time:  # somebody else reset it
            self._begin()
        if self.done:
            return
        self.time, self._states = world.time, world.object_states()
        self._touch()
        for name in self.arms:
            tip = world.arms[name].measured_cp("world").T[:3, 3]
            self.distance[name] += math.dist(tip.tolist(), self._tips[name].tolist())
            self._tips[name] = tip
        earlier = sum(goal.stage < self.stage for goal, _ in self.goals)
        now = [(goal, at) for goal, at in self.goals if goal.stage == self.stage]
        count = earlier + sum(self.met(goal, at) for goal, at in now)
        self._reward, self._met = (count - self._met) / len(self.goals), count
        if count < earlier + len(now):
            self._since = None
        elif self._since is None:
            self._since = self.time
        if self._since is not None and self.time - self._since >= SETTLED_S:
            later = [goal.stage for goal, _ in self.goals if goal.stage > self.stage]
            if not later:
                self.done, self.success, self.reason = True, True, "done"
                return
            self.stage, self._since = min(later), None
        heights = self._states.positions[:, 2].tolist()
        lost = [n for n, z in zip(self._names, heights, strict=True) if z < self._floor]
        faults = [n for n in self.arms if world.arms[n].operating_state().state == "FAULT"]
        if faults:
            self.done, self.reason = True, f"{', '.join(faults)}: FAULT"
        elif lost:
            self.drops += len(lost)
            self.done, self.reason = True, f"{', '.join(lost)}: out of play"
        elif self.time >= self.scene.time_limit - 1e-9:
            stalls = [f"{name} stands still, {why}" for name, why in self._reasons.items() if why]
            self.done, self.reason = True, "; ".join(["time", *self.remarks, *stalls])

    # ------------------------------------------------------------------ inside

    def _touch(self) -> None:
        """Note forces, who holds what, and what was dropped."""
        before, self._held = self._held, {}
        for arm, grasp in self.world.grasps().items():
            if grasp.object and arm in self.grip:
                self._held[arm] = grasp.object
                self.grip[arm] = max(self.grip[arm], grasp.force)
        for arm, force in self.world.contact_forces().items():
            if arm in self.force:
                self.force[arm] = max(self.force[arm], math.hypot(*force.tolist()))
        now = set(self._held.values())
        for name in set(before.values()) - now:
            self._fell_from[name] = float(self.position(name)[2])
        for name in now:
            self._fell_from.pop(name, None)
        for name, height in list(self._fell_from.items()):
            if height - float(self.position(name)[2]) > self.scene.drop_height:
                self.drops += 1
                del self._fell_from[name]

    def _next(self, name: str, before: Array, values: Array) -> Array:
        """Return an arm's set-points after a period, those before where it cannot go on."""
        arm = self.world.arms[name]
        if arm.description.type != "PSM":
            return np.clip(before + values * PERIOD_S, arm.joints.lower, arm.joints.upper)
        after, measured, reason = before.copy(), arm.joints.positions(), ""
        if values[:6].any():
            reason = self._onward(name, after, measured, values[:6])
            self.stalled[name] += PERIOD_S if reason else 0.0
        self._reasons[name] = reason
        opening = float(values[6])
        if opening < 0.0:
            opening = max(opening, float(measured[-1]) - GRIP_RAD)
        fastest = JAW_RAD_S * PERIOD_S
        after[-1] = before[-1] + min(max(opening - before[-1], -fastest), fastest)
        return after

    def _onward(self, name: str, q: Array, measured: Array, twist: Array) -> str:
        """Move an arm's set-points on by a period, as fast as its joints may; return why they stay.

        Args:
            name: of a PSM
            q: its set-points, which are written, (n,)
            measured: its joints, (n,)
            twist: of the tip, (6,)
        """
        joints, reason = self.world.arms[name].description.joints, ""
        most, tolerances = self._bounds[name]
        for _ in range(2):
            goal = self._targets[name].copy()
            goal[:3, 3] += twist[:3] * PERIOD_S
            if twist[3:].any():
                turn = matrix_from_rotation_vector(twist[3:] * PERIOD_S)
                goal[:3, :3] = turn @ goal[:3, :3]
            try:
                after = self._inverse(name, goal, q)
            except (UnreachableError, SingularError) as problem:
                return str(problem)
            haste = np.abs(after - q[:-1]) / (most * PERIOD_S)
            if (worst := float(haste.max())) <= 1.0:
                break
            twist = twist * (SLOWED / worst)
            reason = f"{joints[int(haste.argmax())].name} would move too fast"
        else:
            return reason
        ahead = np.abs(after - measured[:-1])
        if (beyond := ahead > LAG * tolerances).any():
            pushed = beyond & (ahead > np.abs(q[:-1] - measured[:-1]))
            if pushed.any():
                return f"{joints[int(pushed.argmax())].name} is held back"
        self._targets[name], q[:-1] = goal, after
        return ""

    def _inverse(self, name: str, T: Array, near: Array) -> Array:
        """Return the joint positions nearest to others, with the tip at a pose in the world."""
        own = self._own.get(name)
        own = inverse(self.world.reference_pose(name)) if own is None else own
        return self.world.arms[name].local.inverse_kinematics(own @ T, near[:-1])

    def _check_reach(self, name: str, at: Array) -> None:
        """Reject a place that no driven instrument reaches, pointing straight down."""
        instruments = [
            arm
            for arm in ((name,) if name in self.arms else self.arms)
            if self.world.arms[arm].description.type == "PSM"
        ]
        down = np.diag([1.0, -1.0, -1.0])
        for arm in instruments:
            try:
                self._inverse(arm, transform(down, at), self._joints[arm])
            except (UnreachableError, SingularError):
                continue
            return
        if instruments:
            raise InputError(
                f"{self.scene.name}: {name} at {np.round(at, 4).tolist()} m is out of reach of"
                f" {', '.join(instruments)}; allowed: a place that one of them reaches"
            )
