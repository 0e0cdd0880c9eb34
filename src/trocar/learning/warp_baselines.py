"""Environments of Stable-Baselines3 on a GPU: `WarpVectorEnv` as a `VecEnv`.

The file loads Stable-Baselines3, PyTorch and Warp; import it where they are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, MissingExtraError
from trocar.learning.observations import BOUND
from trocar.learning.torch_controller import torch
from trocar.learning.warp_env import WarpVectorEnv

try:
    from gymnasium import spaces
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise MissingExtraError("Stable-Baselines3", "gpu", "training on a GPU") from error


class WarpVecEnv(VecEnv):
    """Worlds on a GPU for learners of Stable-Baselines3, whose arrays are in the host's memory.

    Args:
        env: the worlds
    """

    def __init__(self, env: WarpVectorEnv) -> None:
        self._env = env
        self.render_mode = None
        seen = np.full(env.observation_size, BOUND, np.float32)
        acts = np.ones(env.action_size, np.float32)
        super().__init__(env.n, spaces.Box(-seen, seen), spaces.Box(-acts, acts))  # pyright: ignore[reportUnknownMemberType]  of spaces
        self._actions = np.zeros((env.n, env.action_size), np.float32)

    def reset(self) -> NDArray[np.float32]:
        """Begin all episodes anew; return the first observations, (n, d)."""
        first: NDArray[np.float32] = self._env.reset().cpu().numpy()
        return first

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions of the next step, (n, m)."""
        self._actions = np.asarray(actions, np.float32)

    def step_wait(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Drive all worlds for an action.

        Returns:
            observations (n, d), rewards (n,), ended (n,), and a dict for each world, empty while
            its episode runs, else with "terminal_observation", "TimeLimit.truncated", "is_success"
        """
        actions = torch.as_tensor(self._actions, device=self._env.scene.device)
        seen, reward, terminated, truncated, info = self._env.step(actions)
        cut = truncated.cpu().numpy()
        ended: NDArray[np.bool_] = np.logical_or(terminated.cpu().numpy(), cut)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.any():
            last, success = info["final_obs"].cpu().numpy(), info["is_success"].cpu().numpy()
            for world in np.flatnonzero(ended).tolist():
                infos[world] = {
                    "terminal_observation": last[world],
                    "TimeLimit.truncated": bool(cut[world]),
                    "is_success": bool(success[world]),
                }
        return seen.cpu().numpy(), reward.cpu().numpy(), ended, infos

    def close(self) -> None:
        """Release what the worlds' task opened."""
        self._env.scene.task.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of this object, once for each world."""
        return [getattr(self, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ARG002
        """Reject an attribute: worlds have none of their own.

        Raises:
            InputError: always
        """
        raise InputError(f"WarpVecEnv: got the attribute {attr_name!r}; allowed: none")

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
        raise InputError(f"WarpVecEnv: got the method {method_name!r}; allowed: none")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:  # noqa: ARG002
        """Return False for each world: it has no wrappers."""
        return [False] * len(self._rows(indices))

    def _rows(self, indices: Any) -> Sequence[int]:
        return [*self._get_indices(indices)]
