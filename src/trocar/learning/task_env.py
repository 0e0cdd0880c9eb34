"""A task as an environment: observations and actions of a kind, rewards and endings as fields."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.randomisation import NONE, TipSource
from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.inputs import INTEGERS, check_numbers, check_whole, got
from trocar.learning.actions import make_actions
from trocar.learning.ids import settings_of
from trocar.learning.images import EDGE, SceneCamera
from trocar.learning.observations import StateEncoder, Vectors
from trocar.learning.readings import SceneReadings, read_task
from trocar.learning.rewards import GoalReward, check_reward
from trocar.tasks import Task, make_task
from trocar.tasks.referee import Ending

Array = NDArray[np.float64]
#: An array, or a dict of arrays.
Observation = Any
#: Kinds of observations. "state": `StateEncoder.encode`. "goal": `StateEncoder.encode_goal` as a
#: dict with "observation", "achieved_goal" and "desired_goal". "image": `SceneCamera.capture`.
#: "state+image": a dict with "state" and "image".
OBSERVATIONS = ("state", "goal", "image", "state+image")
#: Ids of environments.
VERSIONED = re.compile(r"[^/]+/.+-v[0-9]+")
#: Rounding errors of a number of steps are smaller.
ROUNDING = 1e-9


class TaskEnv:
    """Episodes of a task for a policy, which chooses an action every `action_period`.

    An episode ends with success, with failure (a FAULT, an object out of play), or is truncated
    when its time is over, see `ending`. Success and failure terminate it; but where each step costs
    a reward (obs "goal", or reward "sparse" or "dense") failure truncates it, as an end would
    be worth more than going on.

    Args:
        scene: a scene, its name, the path of its file, or its task
        obs: one of `OBSERVATIONS`
        action: kind of actions, see `trocar.learning.actions.KINDS`
        action_period: 0.02, 0.1 or 0.2 [s]
        reward: see `trocar.learning.rewards.REWARDS`; default: "sparse" with obs "goal", else
            "task"
        max_steps: actions of an episode; default: those of the scene's time limit
        image_size, channels, eyes: of images, see `SceneCamera`
        randomise, tips: worlds that each reset draws anew, see `Scene.randomised`; default: as the
            scene has them

    Attributes:
        task: that is driven
        encoder: of its readings
        camera: of images; None without
        actions: kind of actions
        settings: as given, as plain values for files of policies
        ending, reason: of the episode, see `Referee`

    Raises:
        UnknownNameError: no such scene, observation, action or reward; the known ones are listed
        InputError: an observation or action that the scene lacks, another period or number
    """

    def __init__(
        self,
        scene: Scene | str | Path | Task,
        *,
        obs: str = "state",
        action: str = "tip",
        action_period: float = 0.1,
        reward: str = "",
        max_steps: int | None = None,
        image_size: int | Sequence[int] = EDGE,
        channels: Sequence[str] = ("rgb",),
        eyes: int = 1,
        randomise: str | Path = "",
        tips: TipSource = "robot",
    ) -> None:
        named = str(scene) if isinstance(scene, str | Path) else ""
        drawn = bool(randomise) or tips != "robot"
        if drawn and isinstance(scene, Task):
            raise InputError(
                f"{scene.scene.name}: randomise, tips: got a task; allowed: a scene, or the task of"
                " one by `Scene.randomised`"
            )
        if drawn and not isinstance(scene, Task):
            scene = drawn_scene(scene, randomise, tips)
        self.task = task = scene if isinstance(scene, Task) else make_task(scene)
        label = task.scene.name
        if obs not in OBSERVATIONS:
            raise UnknownNameError("observation", obs, OBSERVATIONS, label)
        if obs == "goal" and len({goal.stage for goal in task.scene.goals}) > 1:
            raise InputError(
                f"{label}: obs: got 'goal', but its goals count by stages, which no two places"
                " judge; allowed: 'state' or an image"
            )
        reward = check_reward(reward or ("sparse" if obs == "goal" else "task"), label)
        self.encoder = StateEncoder(task)
        self.actions = make_actions(action, task, action_period)
        steps = ceil(task.scene.time_limit / self.actions.action_period - ROUNDING)
        if max_steps is not None:
            steps = check_whole(max_steps, f"{label}: max_steps", 1)
        self._reward = GoalReward(task, reward)
        self._obs, self._most, self._costly = obs, steps, reward != "task"
        self.settings: dict[str, Any] = {
            "scene": named or task.scene.name,
            "obs": obs,
            "action": action,
            "action_period": self.actions.action_period,
            "reward": reward,
            "max_steps": steps,
        }
        self.camera: SceneCamera | None = None
        layers = [channels] if isinstance(channels, str) else list(channels)
        if obs.endswith("image"):
            self.camera = SceneCamera(task, image_size, channels, eyes)
            height, width, _ = self.camera.shape
            self.settings |= {"image_size": [width, height], "channels": layers, "eyes": eyes}
        elif (image_size, layers, eyes) != (EDGE, ["rgb"], 1):
            raise InputError(
                f"{label}: image_size, channels, eyes: got them with obs {obs!r}; allowed: with"
                " 'image' or 'state+image'"
            )
        if drawn:
            self.settings |= {"randomise": str(randomise or NONE), "tips": tips}
        self._seeds = np.random.default_rng()
        self.begin()

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; return its first observation, and info as of `step`.

        Args:
            seed: of the episode, as of `Task.reset`, and of those that are begun without a seed
                after it; None: the next of these
            options: {"objects": {name: position and quaternion wxyz in the world (7,)}} of objects
                that shall begin elsewhere than the seed has them

        Raises:
            InputError: a seed or options that are not allowed, or no free place for an object
        """
        if seed is None:
            seed = int(self._seeds.integers(2**31))
        else:
            check_whole(seed, f"{self.task.scene.name}: seed", 0, INTEGERS[1])
            self._seeds = np.random.default_rng(seed)
        self.task.reset(seed)
        if options:
            place_objects(self.task, options)
        self.begin()
        return self.observe(), self.info()

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive the arms for an action, or until the episode ends.

        Args:
            action: numbers from -1 to 1, (m,); others are clipped

        Returns:
            observation, reward, terminated, truncated, and as info "is_success", "ending"
            ("success", "failure", "truncation" or "running"), "reason", and, where the reward is
            that of goals, their "conditions", see `GoalReward`

        Raises:
            InputError: another shape or dtype, numbers that are not finite, or the episode is over
            DivergedError: the simulation diverged
        """
        checked = self._checked(action)
        if self.done:
            raise InputError(f"{self.task.scene.name}: the episode is over; allowed: reset")
        task, reward = self.task, 0.0
        for period in range(self.actions.periods):
            reward += task.command(self._velocities(checked, period))
            if task.done:
                break
        self._steps += 1
        self._read()
        if not self.done and self._steps >= self._most:
            self.ending, self.reason = Ending.TRUNCATION, "time"
        info = self.info()
        if self._costly:
            reward = float(self._reward(*self._places(), info)[0])
        failed = self.ending is Ending.FAILURE
        terminated = self.ending is Ending.SUCCESS or (failed and not self._costly)
        truncated = self.ending is Ending.TRUNCATION or (failed and self._costly)
        return self.observe(), reward, terminated, truncated, info

    def script(self, policy: Callable[[Observation], ArrayLike]) -> Iterator[Array]:
        """Yield the actions of `Task.command`, one each 20 ms, that a policy chooses; without end.

        It stands in for `Task.policy`, the scripted policy: the caller commands the actions.

        Args:
            policy: returns an action (m,) from an observation

        Raises:
            InputError: an action that is not allowed
        """
        while True:
            self._read()
            action = self._checked(policy(self.observe()))
            for period in range(self.actions.periods):
                yield self._velocities(action, period)

    def observe(self) -> Observation:
        """Return the observation, as of the last reset or step."""
        if self._obs == "goal":
            seen, achieved, desired = self.encoder.encode_goal(self.readings)
            return {
                "observation": seen[0],
                "achieved_goal": achieved[0],
                "desired_goal": desired[0],
            }
        if self.camera is None:
            return self.encoder.encode(self.readings)[0]
        if self._obs == "image":
            return self.camera.capture()
        return {"state": self.encoder.encode(self.readings)[0], "image": self.camera.capture()}

    def info(self) -> dict[str, Any]:
        """Return the info of the last reset or step, see `step`."""
        found: dict[str, Any] = {
            "is_success": self.ending is Ending.SUCCESS,
            "ending": self.ending.value,
            "reason": self.reason,
        }
        if self._costly:
            found["conditions"] = self._reward.conditions(self.readings, *self._places())[0]
        return found

    def compute_reward(self, achieved: ArrayLike, desired: ArrayLike, info: Any) -> Any:
        """Return the reward of other goals, as environments with goals of Gymnasium-Robotics.

        Args:
            achieved, desired: as "achieved_goal" and "desired_goal" in observations, (..., 3 G)
            info: of `step`, or one for each transition; an empty one: only places count

        Raises:
            InputError: other shapes, or the reward is "task", which goals alone do not determine
        """
        if not self._costly:
            raise InputError(
                f"{self.task.scene.name}: compute_reward: got the reward 'task'; allowed: sparse,"
                " dense"
            )
        return self._reward(achieved, desired, info)

    @property
    def done(self) -> bool:
        """Whether the episode is over."""
        return self.ending is not Ending.RUNNING

    def close(self) -> None:
        """Release what the environment and the task opened."""
        if self.camera is not None:
            self.camera.close()
        self.task.close()

    def begin(self) -> None:
        """Begin an episode of the task as it is, after a reset of the task itself."""
        self._steps = 0
        self._read()

    # ------------------------------------------------------------------ inside

    def _read(self) -> None:
        """Read the task, and how its episode ended."""
        self.readings: SceneReadings = read_task(self.task)
        self.ending, self.reason = self.task.referee.ending, self.task.reason

    def _places(self) -> tuple[Vectors, Vectors]:
        return self.encoder.places(self.readings)

    def _checked(self, action: ArrayLike) -> Array:
        return self.actions.check(action)

    def _velocities(self, action: Array, period: int) -> Array:
        """Return the action of `Task.command` for a period of an action."""
        if period and self.actions.reads:
            self._read()
        return self.actions.velocities(action, self.readings, period)[0]


def make(scene: Scene | str | Path, **settings: Any) -> Any:
    """Return the task of a scene, or, of the id of an environment, its `TaskEnv`.

    Args:
        scene: a scene, its name, the path of its file, or an id: "trocar/NeedlePick-v0"
        settings: of the environment, over those of the id

    Raises:
        UnknownNameError: no such scene or id; the known ones are listed
        DescriptionError: a broken file
        InputError: settings that are not allowed, or of a task, which has none
    """
    if isinstance(scene, str) and VERSIONED.fullmatch(scene):
        return TaskEnv(**{**settings_of(scene), **settings})
    if settings:
        raise InputError(
            f"{scene if isinstance(scene, str | Path) else scene.name}: got the settings"
            f" {', '.join(settings)}; allowed: with the id of an environment (trocar/NeedlePick-v0)"
        )
    return make_task(scene)


def drawn_scene(scene: Scene | str | Path, randomise: str | Path, tips: TipSource) -> Scene:
    """Return a scene, its name or the path of its file given, with worlds that a reset draws."""
    known = scene if isinstance(scene, Scene) else load_scene(scene)
    return known.randomised(randomise or NONE, tips)


def place_objects(task: Task, options: Mapping[str, Any]) -> None:
    """Place objects elsewhere than a reset did, and begin the episode anew.

    Args:
        task: after its reset
        options: {"objects": {name: position and quaternion wxyz in the world (7,)}}

    Raises:
        InputError: other options, unknown objects, or other than poses
    """
    where = f"{task.scene.name}: options"
    if set(options) != {"objects"} or not isinstance(options["objects"], Mapping):
        raise InputError(f"{where}: {got(options, 'objects with a pose each')}")
    poses = cast(Mapping[str, Any], options["objects"])
    for name, pose in poses.items():
        if name not in task.world.objects:
            raise UnknownNameError("object", name, task.world.objects, where)
        values = check_numbers(pose, (7,), f"{where}: {name}")
        task.world.objects[name].set_cp(transform(matrix_from_quaternion(values[3:]), values[:3]))
    task.begin()
