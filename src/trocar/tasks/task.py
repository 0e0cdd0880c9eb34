"""A scene as a task: observation, policy, reward, and the result of an episode."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.randomisation import Randomisation
from trocar.descriptions.scenes import Goal, Scene
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_quaternion, quaternion_numbers
from trocar.geometry.se3 import transform
from trocar.simulation import World
from trocar.simulation.objects import ObjectStates
from trocar.tasks.controller import EVERY, TipController
from trocar.tasks.randomisation import RandomisedWorld
from trocar.tasks.referee import Ending, Referee

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Episode:
    """Result of an episode; it follows from scene, seed and policy, to the last bit.

    Attributes:
        scene, seed: of the episode
        success: whether all goals were met, and stayed so
        reason: of its end: "done", what went wrong, or "time" with what held an arm back then
        score: points, see `fls_score`
        time_s: until it ended, simulated [s]
        goals, met: numbers of goals, and of those that were met in the end
        drops: objects that fell after they were held, or left the table
        distance_m: {arm: length of the tip's path} [m]
        force_n: {arm: largest net force of contacts on it} [N]
        grip_n: {arm: largest force of the weaker finger on an object} [N]
        stalled_s: {arm: time for which it stayed where it was though an action moves it} [s]
        grasp: model of grasping of the rig: "friction+stick"
        dynamics: of the rig's arms: "cad"
        digest: of the physics state in the end
        figures: further measurements of the scene, by name with its unit
        ending: whether it ended with success or failure, was truncated, or runs on
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
    ending: Ending = Ending.RUNNING


class Task:
    """A scene with its world: what a policy observes and does, and how it is rewarded.

    A class of tasks extends it, in a module of `trocar.tasks.scenes` or a file of its own, and has
    the name that scenes' key `task` gives in its attribute `task`.

    Args:
        scene: with rig, objects and goals

    Attributes:
        scene, world: as given, and the simulation
        arms: that an action drives, in its order
        controller: turns actions into set-points of these
        referee: counts goals, drops and forces, and ends the episode
    """

    #: Name of the class in scenes' files, "" of one that they do not name.
    task = "task"
    #: Further topics that are served, {name: help}; their messages are JSON.
    topics: Mapping[str, str] = {}
    #: Whether the task looks at images, by the settings of `Scene.look`.
    sees = False
    #: Draws into an eye's image of a frame (0 left, 1 right), from any thread.
    overlay: Callable[[Any, int], NDArray[np.uint8]] | None = None

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.world = World(scene.rig, welded=scene.welded)
        self.world.rig_source = scene.file  # by which a recording of it is replayed
        self.arms = scene.arms
        self.controller = TipController(self.world, scene.arms, scene.name)
        self.referee = Referee(scene, self.controller)
        #: Judges goals: without a class's own rule straight the referee, which saves a call each.
        self._met = self.referee.met if type(self).met is Task.met else self.met
        #: Draws the world at each reset, None for one that is always the same.
        self.randomised: RandomisedWorld | None = None
        if scene.randomisation != Randomisation() or scene.tips != "robot":
            drawn = RandomisedWorld(scene.randomisation, scene.tips, self.world, self.controller)
            self.world.add("randomisation", drawn)
            self.randomised = drawn
        #: Objects as cameras see them, as of the last look; as they are in a world without draws.
        self.observed: ObjectStates = self.referee.states
        self.reset(0)

    # ------------------------------------------------------------------ an episode

    def reset(self, seed: int) -> dict[str, Array]:
        """Begin an episode, a function of the seed; return its first observation.

        Raises:
            InputError: no free place for an object, or one that no arm reaches
        """
        self.world.reset(seed)
        self.controller.register()
        rng = np.random.default_rng(seed)
        for name, T in self.scene.placed(rng).items():
            self._check_reach(name, T[:3, 3])
            self.world.objects[name].set_cp(T)
        self.referee.place_goals(rng)
        for goal, at in self.goals:
            if goal.held or not (goal.arm and goal.object):
                self._check_reach(goal.arm or goal.object, self.referee.place(goal, at))
        self.begin()
        return self.observation()

    def step(self, action: ArrayLike) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Drive the arms for one period of 20 ms, as `step` of Gymnasium.

        Args:
            action: see `TipController`

        Returns:
            observation, reward, terminated (success or failure), truncated (the time is over), and
            `state` as info

        Raises:
            InputError, DivergedError: as `command`
        """
        reward, ending = self.command(action), self.referee.ending
        terminated = ending in (Ending.SUCCESS, Ending.FAILURE)
        truncated = ending is Ending.TRUNCATION
        return self.observation(), reward, terminated, truncated, self.state()

    def command(self, action: ArrayLike) -> float:
        """Drive the arms for one period of 20 ms and return the reward.

        Args:
            action: see `TipController`

        Raises:
            InputError: another shape or numbers that are not finite, or the episode is over;
                nothing moves
            DivergedError: the simulation diverged
        """
        if self.referee.ending is not Ending.RUNNING:
            raise InputError(f"{self.scene.name}: the episode is over; allowed: reset")
        for row in self.controller.setpoints(action):
            self.controller.drive(row)
            self.world.step(EVERY)
        self.look()
        return self.reward()

    def look(self) -> None:
        """Read, measure and judge; call it every period, also when others command the arms."""
        referee = self.referee
        if self.world.journal.time < referee.time:  # somebody else reset it
            self.begin()
        if referee.ending is Ending.RUNNING:
            referee.read()
            self.observed = (
                referee.states if self.randomised is None else self._see(self.randomised)
            )
            self.measure()
            referee.judge(self._met, self.accomplished)

    def observation(self) -> dict[str, Array]:
        """Return the observation of a policy, in the world and in SI.

        Returns:
            {arm: tip position and quaternion wxyz, and opening of the jaw (8,); joints of an ECM
            (4,)}, {object: position and quaternion (7,)}, "goals": (n, 3), "time": (1,); without
            the scene's hidden objects and goals on them
        """
        found: dict[str, Array] = {}
        readings, hidden = self.controller.readings, self.scene.hidden
        readings.renew()
        states, tips, joints = readings.objects, readings.tips, readings.joints
        for name in self.arms:
            q = joints[name]
            if self.world.arms[name].description.type == "PSM":
                tip = tips[name]
                if self.controller.registration:
                    tip = self.controller.registered(name, tip)
                x, y, z = tip[:3, 3].tolist()
                found[name] = np.array([x, y, z, *quaternion_numbers(tip[:3, :3]), q.item(-1)])
            else:
                found[name] = q.copy()
        states = states if self.randomised is None else self.observed
        placed = np.concatenate([states.positions, states.quaternions], axis=1)
        for row, name in enumerate(states.names):
            if name not in hidden:
                found[name] = placed[row]
        seen: list[Array] = []
        for goal, at in self.referee.goals:
            if goal.on not in hidden:
                seen.append(self.place_seen(goal, at) if goal.on else at)
        found["goals"] = np.array(seen).reshape(-1, 3)
        found["time"] = np.array([self.world.journal.time])
        return found

    def state(self) -> dict[str, Any]:
        """Return the count so far, as plain values."""
        referee = self.referee
        return {
            "scene": self.scene.name,
            "time_s": round(referee.time, 3),
            "score": round(self.score(), 1),
            "goals": len(referee.goals),
            "met": referee.met_count,
            "drops": referee.drops,
            "done": self.done,
            "reason": referee.reason,
            "stalled": {name: why for name, why in self.controller.stalls().items() if why},
        }

    def result(self, seed: int) -> Episode:
        """Return the result of the episode."""
        referee, rig = self.referee, self.world.rig
        return Episode(
            scene=self.scene.name,
            seed=seed,
            success=referee.ending is Ending.SUCCESS,
            reason=referee.reason or "running",
            score=self.score(),
            time_s=referee.time,
            goals=len(referee.goals),
            met=referee.met_count,
            drops=referee.drops,
            distance_m=dict(referee.distance),
            force_n=dict(referee.force),
            grip_n=dict(referee.grip),
            grasp=rig.grasp,
            dynamics=rig.dynamics,
            stalled_s=dict(self.controller.stalled),
            digest=hashlib.sha256(self.world.save().row.tobytes()).hexdigest()[:16],
            figures=self.figures(),
            ending=referee.ending,
        )

    @property
    def limits(self) -> tuple[Array, Array]:
        """The least and largest values of an action, (n,) each."""
        return self.controller.limits

    @property
    def goals(self) -> tuple[tuple[Goal, Array], ...]:
        """Goals of this episode with their places, see `Referee`."""
        return self.referee.goals

    @property
    def done(self) -> bool:
        """Whether the episode is over."""
        return self.referee.ending is not Ending.RUNNING

    @property
    def reason(self) -> str:
        """Reason of the end: "done", "time" or the fault; "" while the episode runs."""
        return self.referee.reason

    @property
    def time(self) -> float:
        """Simulated time of the episode, as of the last look [s]."""
        return self.referee.time

    def object_pose(self, name: str) -> Array:
        """Return an object's pose in the world now, (4, 4)."""
        return self.world.object(name).measured_cp().matrix

    def place_seen(self, goal: Goal, at: Array) -> Array:
        """Return the place of a goal, (3,) [m], by the object that it stands on as it is seen.

        Args:
            goal, at: a row of `goals`
        """
        if self.randomised is None or not goal.on:
            return self.referee.place(goal, at)
        row = self.observed.names.index(goal.on)
        turn = matrix_from_quaternion(self.observed.quaternions[row])
        return turn @ at + self.observed.positions[row]

    def stay(self) -> Array:
        """Return the action that holds all arms."""
        return np.concatenate([*self.controller.idle().values()])

    def close(self) -> None:
        """Release what the task opened."""

    # ------------------------------------------------------------------ a class replaces these

    @classmethod
    def derived_settings(cls, scene: Scene, nominal: Scene) -> dict[str, Any]:  # noqa: ARG003
        """Return settings of a scene that follow from its other settings; none here.

        Args:
            scene, nominal: with and without settings
        """
        return {}

    def begin(self) -> None:
        """Count from now on, from where everything is; a reset of the world by others begins, too.

        A class that counts more sets it back first, then calls this one.
        """
        self.controller.begin()
        if self.randomised is not None:
            self.randomised.start()
        self.referee.begin()
        self.look()
        self.referee.gained = 0.0

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy from the state of the task.

        Raises:
            InputError: the task has none
        """
        raise InputError(f"{self.scene.name}: has no scripted policy; allowed: none")

    def measure(self) -> None:
        """Measure what the referee does not, in every period before goals are judged."""

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether a goal is met, as of the last look.

        Args:
            goal, at: a row of `goals`
        """
        return self.referee.met(goal, at)

    def accomplished(self, settled: bool, late: bool) -> bool:  # noqa: ARG002
        """Return whether the episode ends with success now.

        Args:
            settled: whether the goals of the last stage were all met for 0.2 s
            late: whether the time is over
        """
        return settled

    def reward(self) -> float:
        """Return the reward of the last command: the change of the ratio of goals that are met."""
        return self.referee.gained

    def score(self) -> float:
        """Return the points of the episode as `fls_score` computes them."""
        return self.referee.score()

    def figures(self) -> dict[str, Any]:
        """Return further measurements of the scene, by name with its unit; none here."""
        return {}

    def messages(self) -> dict[str, Any]:
        """Return the messages on further topics since the last call, {name: content}."""
        return {}

    def picture(self, capture: Callable[[], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return an image for a video: the endoscope's, unless the task draws its own."""
        return capture()

    # ------------------------------------------------------------------ inside

    def _see(self, drawn: RandomisedWorld) -> ObjectStates:
        """Return objects as cameras see them."""
        states = self.referee.states
        true = np.concatenate([states.positions, states.quaternions], axis=1)
        seen = drawn.sight.see(true[None])[0]
        return states._replace(positions=seen[:, :3], quaternions=seen[:, 3:])

    def _check_reach(self, name: str, at: Array) -> None:
        """Reject a place that no driven instrument reaches, pointing straight down."""
        world = self.world
        names = (name,) if name in self.arms else self.arms
        instruments = [arm for arm in names if world.arms[arm].description.type == "PSM"]
        down = transform(np.diag([1.0, -1.0, -1.0]), at)
        if instruments and not any(self.controller.reaches(arm, down) for arm in instruments):
            raise InputError(
                f"{self.scene.name}: {name} at {np.round(at, 4).tolist()} m is out of reach of"
                f" {', '.join(instruments)}; allowed: a place that one of them reaches"
            )
