"""Many worlds as environments of Stable-Baselines3: `SceneVectorEnv` or `WarpVectorEnv`.

The file loads Stable-Baselines3 with PyTorch; import it where they are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, MissingExtraError
from trocar.learning.observations import BOUND
from trocar.learning.vector_env import SceneVectorEnv

try:
    from gymnasium import spaces
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise MissingExtraError("Stable-Baselines3", "learn", "training an actor") from error


#: Settings of `WarpVectorEnv`, whose observations are "state" and whose actions are "tip".
WARP_SETTINGS = ("action_period", "reward", "max_steps")


class WorldsVecEnv(VecEnv):
    """Worlds for learners of Stable-Baselines3, whose arrays are in the host's memory.

    Args:
        env: the worlds, a `WarpVectorEnv` or a `SceneVectorEnv` that begins ended episodes in the
            same step, with flat observations
    """

    def __init__(self, env: Any) -> None:
        self._env = env
        self.render_mode = None
        if isinstance(env, SceneVectorEnv):
            own: Any = env
            count, seen, acts = env.num_envs, own.single_observation_space, own.single_action_space
        else:
            most, share = (
                np.full(k, v, np.float32)
                for k, v in ((env.observation_size, BOUND), (env.action_size, 1.0))
            )
            count, seen, acts = env.n, spaces.Box(-most, most), spaces.Box(-share, share)
        super().__init__(count, seen, acts)  # pyright: ignore[reportUnknownMemberType]  of spaces
        self._actions = np.zeros((count, *(acts.shape or ())), np.float32)

    def reset(self) -> NDArray[np.float32]:
        """Begin all episodes anew; return the first observations, (n, d)."""
        first = self._env.reset()
        return _array(first[0] if isinstance(first, tuple) else first)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions of the next step, (n, m)."""
        self._actions = np.asarray(actions, np.float32)

    def step_wait(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Drive all worlds for an action.

        Returns:
            observations (n, d), rewards (n,), ended (n,), and a dict for each world, empty while
            its episode runs, else with "terminal_observation", "TimeLimit.truncated", "is_success"
        """
        seen, reward, terminated, truncated, info = self._env.step(self._actions)
        cut = _array(truncated)
        ended: NDArray[np.bool_] = np.logical_or(_array(terminated), cut)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.any():
            last, success = _array(info["final_obs"]), _array(info["is_success"])
            for world in np.flatnonzero(ended).tolist():
                infos[world] = {
                    "terminal_observation": last[world],
                    "TimeLimit.truncated": bool(cut[world]),
                    "is_success": bool(success[world]),
                }
        return _array(seen), _array(reward).astype(np.float32), ended, infos

    def close(self) -> None:
        """Release what the worlds opened."""
        self._env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of this object, once for each world."""
        return [getattr(self, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ARG002
        """Reject an attribute: worlds have none of their own.

        Raises:
            InputError: always
        """
        raise InputError(f"WorldsVecEnv: got the attribute {attr_name!r}; allowed: none")

    def env_method(
        self,
        method_name: str,
        *method_args: Any,  # noqa: ARG002
        indices: Any = None,  # noqa: ARG002
        **method_kwargs: Any,  # noqa: ARG002
    ) -> list[Any]:
        """Reject a call: worlds have no methods of their own.

        Raises:
            InputError: always
        """
        raise InputError(f"WorldsVecEnv: got the method {method_name!r}; allowed: none")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:  # noqa: ARG002
        """Return False for each world: it has no wrappers."""
        return [False] * len(self._rows(indices))

    def _rows(self, indices: Any) -> Sequence[int]:
        return [*self._get_indices(indices)]


def make_worlds(
    scene: Scene | str, count: int, *, device: str, seed: int, **settings: Any
) -> WorldsVecEnv:
    """Return worlds of a scene, on CPU threads or by MuJoCo Warp on a device.

    Args:
        scene: a scene, its name, or the path of its file
        count: number of worlds
        device: "cpu": `SceneVectorEnv`; else `WarpVectorEnv`
        seed: of the episodes
        settings: of `TaskEnv`

    Raises:
        UnknownNameError, InputError, MissingExtraError: as these
    """
    if device == "cpu":
        env = SceneVectorEnv(scene, count, autoreset_mode="SameStep", **settings)
        env.reset(seed=seed)
        return WorldsVecEnv(env)
    warp = import_module("trocar.learning.warp_env")
    own = {key: settings[key] for key in WARP_SETTINGS if key in settings}
    return WorldsVecEnv(warp.WarpVectorEnv(scene, count, device=device, seed=seed, **own))


def _array(values: Any) -> NDArray[Any]:
    """Return an array, or a tensor's values in the host's memory."""
    return values.cpu().numpy() if hasattr(values, "cpu") else values
