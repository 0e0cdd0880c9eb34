"""Many worlds of a scene as one vector environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.randomisation import TipSource
from trocar.descriptions.records import GraspKind
from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, MissingExtraError, UnknownNameError
from trocar.inputs import check_whole, shown
from trocar.learning.images import VIEWS, SceneView
from trocar.learning.rewards import GoalReward, check_reward
from trocar.learning.scene_batch import SceneBatch
from trocar.learning.scene_env import RENDER_MODES, observation_space
from trocar.learning.task_env import Observation, TaskEnv, drawn_scene
from trocar.tasks.referee import Ending

try:
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space, iterate
except ImportError:
    raise MissingExtraError("gymnasium", "gym", "SceneVectorEnv") from None

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class SceneVectorEnv(VectorEnv[Any, Any, Any]):
    """`SceneBatch` with observations, actions and rewards of `TaskEnv`.

    `gymnasium.make_vec("trocar/NeedlePick-v0", num_envs=64, obs=..., ...)` makes one. Each of its
    environments has the episodes of a `SceneEnv` with the same seed.

    Args:
        scene: a scene, its name, or the path of its file
        num_envs: number of worlds
        threads, grasp: as of `SceneBatch`
        autoreset_mode: when episodes that ended begin anew: in the next step, in the same, or in
            `reset` with the option "reset_mask"
        render_mode: as of `SceneEnv`; None: `render` returns None
        randomise, tips: as of `TaskEnv`, without robot errors
        settings: of `TaskEnv`

    Attributes:
        env: environment of one world, with the kinds of observations, actions and rewards
        batch: the worlds
        compute_reward: of goals, only with obs "goal", see `TaskEnv.compute_reward`

    Raises:
        InputError, UnknownNameError: as `SceneBatch` and `SceneEnv`
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        num_envs: int = 1,
        *,
        threads: int | None = None,
        grasp: GraspKind | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        randomise: str | Path = "",
        tips: TipSource = "robot",
        **settings: Any,
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise UnknownNameError("render_mode", render_mode, RENDER_MODES)
        modes = {mode.value: mode for mode in AutoresetMode}
        chosen = (
            autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        )
        if chosen not in modes:
            raise UnknownNameError("autoreset_mode", chosen, modes)
        if randomise or tips != "robot":
            scene = drawn_scene(scene, randomise, tips)
        self.batch = SceneBatch(scene, num_envs, threads=threads, grasp=grasp)
        self.env = env = TaskEnv(self.batch.task, **settings)
        self.num_envs, self.render_mode = self.batch.n, render_mode
        self._autoreset = modes[chosen]
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": round(1.0 / env.actions.action_period),
            "autoreset_mode": self._autoreset,
        }
        self.single_action_space = spaces.Box(env.actions.low, env.actions.high, dtype=np.float32)
        single: Any = observation_space(env)
        self.single_observation_space = single
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(single, self.num_envs)
        self._most = int(env.settings["max_steps"])
        kind = check_reward(env.settings["reward"], self.batch.scene.name)
        self._reward = GoalReward(self.batch.task, kind) if kind != "task" else None
        if env.settings["obs"] == "goal":  # its presence marks an environment with goals
            self.compute_reward = env.compute_reward
        self._steps = np.zeros(self.num_envs, np.intp)
        self._seeds: list[np.random.Generator] = [
            np.random.default_rng() for _ in range(self.num_envs)
        ]
        self._view: SceneView | None = None

    # ------------------------------------------------------------------ episodes

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: of the first world's episode, and one more for each next world; or of each; those
                after it follow from it. None: goes on
            options: {"reset_mask": (n,) bool} of the worlds whose episodes begin; all when omitted

        Raises:
            InputError: a seed or options that are not allowed, or as `SceneBatch.reset`
        """
        label, which = self.batch.scene.name, np.ones(self.num_envs, np.bool_)
        if options:
            which = np.asarray(options.get("reset_mask"))
            if set(options) != {"reset_mask"} or which.shape != (self.num_envs,):
                raise InputError(
                    f"{label}: options: got {shown(dict(options))}; allowed: reset_mask, a mask of"
                    f" {self.num_envs} worlds"
                )
            which = which.astype(np.bool_)
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else seed + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InputError(f"{label}: got {len(seed)} seeds; allowed: {self.num_envs}")
        seeds = [None if one is None else check_whole(one, f"{label}: seed") for one in seed]
        self._begin(which, seeds)
        return self._observe(), self._info()

    def step(self, actions: ArrayLike) -> tuple[Observation, Array, Bools, Bools, dict[str, Any]]:
        """Drive all arms for an action, see `TaskEnv.step`; begin episodes by `autoreset_mode`.

        Info has arrays: "is_success", "ending", and the masks of worlds that have them.

        Args:
            actions: numbers from -1 to 1, (n, m); others are clipped

        Raises:
            InputError: another shape or dtype, numbers that are not finite, with the world's
                number; or, with autoreset disabled, an episode is over
            DivergedError: the simulation of a world diverged
        """
        batch, kinds = self.batch, self.env.actions
        checked, begins = kinds.check(actions, self.num_envs), batch.over
        if begins.any() and self._autoreset is AutoresetMode.DISABLED:
            raise InputError(
                f"{batch.scene.name}: the episode of world {int(np.argmax(begins))} is over;"
                " allowed: reset with the option reset_mask"
            )
        rewards, readings = np.zeros(self.num_envs), batch.readings
        for period in range(kinds.periods):
            if period and kinds.reads:
                readings = batch.readings
            rewards += batch.command(kinds.velocities(checked, readings, period))
            if batch.over.all():
                break
        self._steps += 1
        if begins.any():
            self._begin(begins, [None] * self.num_envs)
        batch.truncate(self._steps >= self._most)
        readings = batch.readings
        if self._reward is not None:
            places = self.env.encoder.places(readings)
            conditions = self._reward.conditions(readings, *places)
            each = [{"conditions": row} for row in conditions]
            rewards = np.where(begins, 0.0, self._reward(*places, each))
        terminated, truncated = self._ended()
        info = self._info()
        if self._autoreset is AutoresetMode.SAME_STEP and batch.over.any():
            info |= self._final(info)
            self._begin(batch.over, [None] * self.num_envs)
        return self._observe(), rewards, terminated, truncated, info

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return the picture of the render mode of each world, (height, width, 3) uint8.

        Raises:
            InputError: the scene has no endoscope
            TrocarError, MissingExtraError: see `Endoscope`
        """
        if self.render_mode is None:
            return None
        if self._view is None:
            kind = VIEWS[0] if self.render_mode == "rgb_array" else self.render_mode
            self._view = SceneView(self.batch.task, kind)
        return tuple(self.batch.images(range(self.num_envs), self._view))

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002  Gymnasium's
        """Release what the environment opened."""
        if self._view is not None:
            self._view.close()
            self._view = None
        self.env.close()

    # ------------------------------------------------------------------ inside

    def _begin(self, which: Bools, seeds: Sequence[int | None]) -> None:
        """Begin episodes; of worlds without a seed, with the next of theirs."""
        drawn: list[int] = []
        begins: list[bool] = which.tolist()
        for world, seed in enumerate(seeds):
            if begins[world] and seed is not None:
                self._seeds[world] = np.random.default_rng(seed)
                drawn.append(seed)
            elif begins[world]:
                drawn += self._seeds[world].integers(2**31, size=1).tolist()
        self.batch.reset(which, np.array(drawn, np.int64))
        self._steps[which] = 0

    def _ended(self) -> tuple[Bools, Bools]:
        """Return terminated and truncated, (n,) each, as `TaskEnv.step`."""
        batch, costly = self.batch, self._reward is not None
        terminated = batch.success | (batch.failed & (not costly))
        return terminated, batch.late | (batch.failed & costly)

    def _observe(self) -> Observation:
        """Return the observations of all worlds, as `TaskEnv.observe`."""
        env, readings, kind = self.env, self.batch.readings, str(self.env.settings["obs"])
        if kind == "goal":
            seen, achieved, desired = env.encoder.encode_goal(readings)
            return {"observation": seen, "achieved_goal": achieved, "desired_goal": desired}
        if env.camera is None:
            return env.encoder.encode(readings)
        pictures = self.batch.images(range(self.num_envs), env.camera)
        if kind == "image":
            return pictures
        return {"state": env.encoder.encode(readings), "image": pictures}

    def _info(self) -> dict[str, Any]:
        """Return the info of all worlds."""
        batch = self.batch
        masks = batch.success, batch.failed, batch.late
        values = [str(one) for one in (Ending.SUCCESS, Ending.FAILURE, Ending.TRUNCATION)]
        every = np.ones(self.num_envs, np.bool_)
        found: dict[str, Any] = {
            "is_success": batch.success.copy(),
            "ending": np.select(masks, values, str(Ending.RUNNING)),
        }
        return found | {f"_{key}": every for key in found}

    def _final(self, info: Mapping[str, Any]) -> dict[str, Any]:
        """Return the last observations and infos of episodes that ended in this step."""
        over, seen = self.batch.over, self._observe()
        last = np.full(self.num_envs, None, object)
        rows: Any = iterate(batch_space(observation_space(self.env), self.num_envs), seen)
        for world, one in enumerate(rows):
            last[world] = one if over[world] else None
        kept = {key: rows.copy() for key, rows in info.items() if not key.startswith("_")}
        final = {**kept, **{f"_{key}": over for key in kept}}
        return {"final_obs": last, "_final_obs": over, "final_info": final, "_final_info": over}
