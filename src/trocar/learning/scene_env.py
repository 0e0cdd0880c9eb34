"""A scene as an environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.scenes import Scene
from trocar.errors import MissingExtraError, UnknownNameError
from trocar.learning.images import VIEWS, SceneView
from trocar.learning.observations import BOUND
from trocar.learning.task_env import Observation, TaskEnv
from trocar.tasks import Task

try:
    import gymnasium
    from gymnasium import spaces
except ImportError:
    raise MissingExtraError("gymnasium", "gym", "SceneEnv") from None

#: Render modes: views of `SceneView`; "rgb_array" is another name of "endoscope".
RENDER_MODES = (*VIEWS, "rgb_array")


class SceneEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """`TaskEnv` with the spaces of Gymnasium, and pictures.

    `gymnasium.make("trocar/NeedlePick-v0", obs=..., action=..., ...)` makes one.

    Args:
        scene: a scene, its name, the path of its file, or its task
        render_mode: one of `RENDER_MODES`; None: `render` returns None
        settings: of `TaskEnv`

    Attributes:
        env: the environment without Gymnasium
        compute_reward: of its goals, only with obs "goal", see `TaskEnv.compute_reward`

    Raises:
        InputError, UnknownNameError: as `TaskEnv`, or no such render mode
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012  Gymnasium's own

    def __init__(
        self, scene: Scene | str | Path | Task, render_mode: str | None = None, **settings: Any
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise UnknownNameError("render_mode", render_mode, RENDER_MODES)
        self.env = env = TaskEnv(scene, **settings)
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": list(RENDER_MODES),
            "render_fps": round(1.0 / env.actions.action_period),
        }
        self.action_space = spaces.Box(env.actions.low, env.actions.high, dtype=np.float32)
        self.observation_space = observation_space(env)
        if env.settings["obs"] == "goal":  # its presence marks an environment with goals
            self.compute_reward = env.compute_reward
        self._view: SceneView | None = None

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode, see `TaskEnv.reset`."""
        super().reset(seed=seed)
        return self.env.reset(seed, options)

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive the arms for an action, see `TaskEnv.step`."""
        return self.env.step(action)

    def render(self) -> Any:
        """Return the picture of the render mode, (height, width, 3) uint8.

        Raises:
            InputError: the scene has no endoscope
            TrocarError, MissingExtraError: see `Endoscope`
        """
        if self.render_mode is None:
            return None
        if self._view is None:
            kind = VIEWS[0] if self.render_mode == "rgb_array" else self.render_mode
            self._view = SceneView(self.env.task, kind)
        return self._view.capture()

    def close(self) -> None:
        """Release what the environment opened."""
        if self._view is not None:
            self._view.close()
            self._view = None
        self.env.close()


def observation_space(env: TaskEnv) -> spaces.Space[Any]:
    """Return the space of an environment's observations."""
    first = env.observe()
    if isinstance(first, dict):
        each = cast(Mapping[str, NDArray[Any]], first)
        return spaces.Dict({name: _box(value) for name, value in each.items()})
    return _box(first)


def _box(value: NDArray[Any]) -> spaces.Box:
    if value.dtype == np.uint8:
        return spaces.Box(0, 255, value.shape, np.uint8)
    return spaces.Box(-BOUND, BOUND, value.shape, np.float32)
