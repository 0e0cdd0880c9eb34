"""Environments of a scene on a GPU: tensors in, tensors out, worlds that end begin anew.

The file loads PyTorch and Warp; import it where they are needed.
"""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from trocar.descriptions.scenes import Scene
from trocar.errors import InputError
from trocar.inputs import check_whole, shown
from trocar.learning.actions import ACTION_PERIODS_S
from trocar.learning.observations import BOUND, SCALE, StateEncoder, scene_centre
from trocar.learning.readings import NOTHING
from trocar.learning.rewards import check_reward
from trocar.learning.torch_controller import Tensor, torch
from trocar.learning.warp_scene import TensorReadings, WarpScene
from trocar.tasks.controller import GRIP_RAD, PERIOD_S
from trocar.tasks.task import Task

#: Rounding errors of a number of steps are smaller.
ROUNDING = 1e-9


class TensorEncoder:
    """Encodes readings as `StateEncoder` does, as tensors.

    Args:
        task: of the scene
        device: of all tensors

    Attributes:
        names: of the columns, (d,)
        size: d
    """

    def __init__(self, task: Task, device: str) -> None:
        encoder, world, hidden = StateEncoder(task), task.world, task.scene.hidden
        self.names, self.size = encoder.names, encoder.size

        def t(values: object) -> Tensor:
            return torch.as_tensor(np.array(values, np.float64), device=device)

        self._centre, self._limit = t(scene_centre(task)), task.scene.time_limit
        self._objects = [name for name in world.objects if name not in hidden]
        #: Middle, half range and largest velocity of each arm's joints.
        self._joints: dict[str, tuple[Tensor, Tensor, Tensor]] = {}
        for name in task.arms:
            arm = world.arms[name]
            low, high = t(arm.joints.lower), t(arm.joints.upper)
            fastest = t([joint.velocity_max for joint in arm.description.joints])
            self._joints[name] = (low + high) / 2.0, (high - low) / 2.0, fastest

    def encode(self, readings: TensorReadings) -> Tensor:
        """Return the rows of readings, (n, d) float32."""
        parts: list[Tensor] = []
        for name, (middle, half, fastest) in self._joints.items():
            tip = readings.tips.get(name)
            if tip is not None:
                parts += [SCALE * (tip[:, :3, 3] - self._centre), tip[:, :3, 0], tip[:, :3, 2]]
            parts += [(readings.q[name] - middle) / half, readings.v[name] / fastest]
            if tip is not None:
                holds = readings.held[name] != NOTHING
                parts.append(torch.stack([holds, readings.stalled[name]], 1))
        for name in self._objects:
            placed, row = readings.objects[name], readings.names.index(name)
            parts.append(SCALE * (placed[:, :3] - self._centre))
            parts += _two_axes(placed[:, 3:])
            for arm, tip in readings.tips.items():
                parts.append(SCALE * (placed[:, :3] - tip[:, :3, 3]))
                parts.append((readings.held[arm] == row)[:, None])
        parts.append(1.0 - readings.time[:, None] / self._limit)
        places = SCALE * (readings.goals - self._centre)
        ways = SCALE * (readings.goals - readings.achieved)
        goals = torch.cat([places, ways, readings.met[..., None]], 2)
        parts.append(goals.reshape(len(goals), -1))
        return torch.cat([part.float() for part in parts], 1).clamp(-BOUND, BOUND)


class WarpVectorEnv:
    """n environments of a scene on MuJoCo Warp for learners on the same device.

    Observations are those of `TaskEnv` with obs "state", actions those of its kind "tip", from -1
    to 1. A world whose episode ends begins anew in the same step: its observation is then the first
    one of the next episode, and `final_obs` of the info has the last one of the episode that ended.

    Args:
        scene: a scene, its name, or the path of its TOML file
        n: number of worlds
        device: as of `WarpScene`
        seed: as of `WarpScene`
        action_period: 0.02, 0.1 or 0.2 [s]
        reward: "task", "sparse" or "dense", see `trocar.learning.rewards.REWARDS`
        max_steps: actions of an episode; default: those of the scene's time limit

    Attributes:
        scene: the worlds
        n: number of worlds
        encoder: of their readings
        observation_size, action_size: d and m
        settings: as given, as `TaskEnv.settings` has them

    Raises:
        UnknownNameError, InputError, MissingExtraError: as `WarpScene`; another period or reward
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        n: int,
        *,
        device: str = "cuda",
        seed: int = 0,
        action_period: float = 0.1,
        reward: str = "task",
        max_steps: int | None = None,
    ) -> None:
        label = scene.name if isinstance(scene, Scene) else str(scene)
        self._reward = check_reward(reward, label)
        if action_period not in ACTION_PERIODS_S:
            allowed = ", ".join(f"{one:g}" for one in ACTION_PERIODS_S)
            raise InputError(
                f"{label}: action_period: got {shown(action_period)}; allowed: {allowed}"
            )
        self._periods = round(action_period / PERIOD_S)
        self.scene = WarpScene(scene, n, device=device, seed=seed)
        self.n, task = self.scene.n, self.scene.task
        self.encoder = TensorEncoder(task, device)
        self.observation_size = self.encoder.size
        self.action_size = len(self.scene.limits[0])
        steps = ceil(task.scene.time_limit / action_period - ROUNDING)
        if max_steps is not None:
            steps = check_whole(max_steps, f"{label}: max_steps", 1)
        self._most = steps
        self._steps = torch.zeros(self.n, dtype=torch.int64, device=device)
        self.settings: dict[str, Any] = {
            "scene": task.scene.name,
            "obs": "state",
            "action": "tip",
            "action_period": float(action_period),
            "reward": self._reward,
            "max_steps": steps,
        }

    def reset(self) -> Tensor:
        """Begin all episodes anew; return the first observations, (n, d) float32."""
        self.scene.reset()
        self._steps.zero_()
        return self.encoder.encode(self.scene.readings)

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """Drive all worlds for an action.

        Args:
            actions: (n, m), clipped to [-1, 1]

        Returns:
            observations (n, d), rewards (n,), terminated and truncated (n,) bool, and as info
            "final_obs" (n, d), "is_success" and "broken" (n,); a broken world's episode is
            truncated, and its last observation is that of a beginning

        Raises:
            InputError: another shape, or numbers that are not finite
        """
        scene = self.scene
        twists = self._tip_actions(actions)
        reward = torch.zeros(self.n, dtype=torch.float64, device=scene.device)
        broken = torch.zeros(self.n, dtype=torch.bool, device=scene.device)
        for _ in range(self._periods):
            scene.command(twists)
            reward = reward + scene.reward
            broken = broken | scene.broken
        self._steps = self._steps + 1
        readings = scene.readings
        costly = self._reward != "task"
        if self._reward == "sparse":
            reward = readings.met.all(1).double() - 1.0
        elif self._reward == "dense":
            ways = readings.goals - readings.achieved
            reward = -SCALE * (ways * ways).sum(-1).sqrt().mean(1)
        success, failed = scene.success & ~broken, scene.failed & ~broken
        terminated = success if costly else success | failed
        truncated = (scene.late | broken | failed | (self._steps >= self._most)) & ~terminated
        obs = final = self.encoder.encode(readings)
        ended = terminated | truncated
        if bool(ended.any()):
            scene.reset(ended)
            self._steps = torch.where(ended, 0, self._steps)
            obs = self.encoder.encode(scene.readings)
        info = {"final_obs": final, "is_success": success, "broken": broken}
        return obs, reward.float(), terminated, truncated, info

    def close(self) -> None:
        """Release what the worlds' task opened."""
        self.scene.task.close()

    def _tip_actions(self, actions: Tensor) -> Tensor:
        """Return the actions of `TipController` for those of kind "tip"."""
        least, largest = self.scene.limits
        values = torch.as_tensor(actions, dtype=torch.float64, device=self.scene.device)
        values = values.clamp(-1.0, 1.0)
        if tuple(values.shape) != (self.n, self.action_size):
            raise InputError(
                f"{self.scene.task.scene.name}: got actions of shape {tuple(values.shape)};"
                f" allowed: {(self.n, self.action_size)}"
            )
        found = values * largest
        for jaw in self.scene.jaws:
            share = (values[:, jaw] + 1.0) / 2.0
            found[:, jaw] = -GRIP_RAD + share * (largest[jaw] - least[jaw])
        return found


def _two_axes(w: Tensor) -> list[Tensor]:
    """Return the x and y axes of quaternions wxyz (n, 4), (n, 3) each."""
    a, b, c, d = w.unbind(1)
    x = torch.stack([1 - 2 * (c * c + d * d), 2 * (b * c + a * d), 2 * (b * d - a * c)], 1)
    y = torch.stack([2 * (b * c - a * d), 1 - 2 * (b * b + d * d), 2 * (c * d + a * b)], 1)
    return [x, y]
