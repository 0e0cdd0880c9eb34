"""Rewards of places of goals, which can be computed again for other goals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, UnknownNameError
from trocar.learning.observations import SCALE
from trocar.learning.readings import SceneReadings
from trocar.tasks import Task

#: Kinds of rewards. "task": the change of the ratio of goals met, as `Task.reward`. "sparse": 0
#: where all goals are met, else -1. "dense": less the mean distance from the goals, in 50 mm.
RewardKind = Literal["task", "sparse", "dense"]
REWARDS: tuple[RewardKind, ...] = ("task", "sparse", "dense")


class GoalReward:
    """Computes "sparse" and "dense" rewards from places, of many transitions at once.

    A goal counts as met where the place lies within its radius and height, and where its other
    conditions hold: the object is held, or released, as the goal has it, and what the scene's class
    demands besides. Those follow from `conditions` of readings; a transition whose goals were
    replaced keeps them.

    Args:
        task: of the scene
        kind: "sparse" or "dense"
    """

    def __init__(self, task: Task, kind: RewardKind) -> None:
        goals = [goal for goal, _ in task.goals if goal.on not in task.scene.hidden]
        self.kind: RewardKind = kind
        self._radius = np.array([goal.radius for goal in goals])
        self._height = np.array([goal.height for goal in goals])
        rows = {name: row for row, name in enumerate(task.world.objects)}
        #: Arm, row of the object, and whether it shall be held, of each goal of an object.
        self._grasps = [
            (k, goal.arm, rows[goal.object], goal.held)
            for k, goal in enumerate(goals)
            if goal.held or not goal.arm
        ]

    def __call__(
        self, achieved: ArrayLike, desired: ArrayLike, info: Any = ()
    ) -> NDArray[np.float32]:
        """Return the rewards of transitions, (...).

        Args:
            achieved, desired: as `StateEncoder.encode_goal` returns them, (..., 3 G)
            info: of the transition, or one for each; without "conditions" these count as holding

        Raises:
            InputError: other shapes
        """
        ways = self._ways(achieved, desired)
        if self.kind == "dense":
            return -SCALE * np.linalg.norm(ways, axis=-1).mean(axis=-1).astype(np.float32)
        met = self._near(ways) & _conditions(info)
        return met.all(axis=-1).astype(np.float32) - np.float32(1.0)

    def conditions(
        self, readings: SceneReadings, achieved: ArrayLike, desired: ArrayLike
    ) -> NDArray[np.bool_]:
        """Return whether each goal's conditions hold beside its place, (n, G).

        Args:
            readings: of n worlds
            achieved, desired: of these, (n, 3 G)
        """
        near = self._near(self._ways(achieved, desired))
        found = readings.met | ~near
        for k, arm, row, held in self._grasps:
            by = [readings.held[arm]] if arm in readings.held else [*readings.held.values()]
            holds = np.any([one == row for one in by], axis=0) if by else np.zeros(len(found), bool)
            found[:, k] &= holds == held
        return found

    def _ways(self, achieved: ArrayLike, desired: ArrayLike) -> NDArray[np.float64]:
        """Return the ways to goals, (..., G, 3) [m]."""
        a, d = np.asarray(achieved, np.float64), np.asarray(desired, np.float64)
        size = 3 * len(self._radius)
        if a.shape != d.shape or not a.shape or a.shape[-1] != size:
            raise InputError(
                f"compute_reward: got goals of the shapes {a.shape} and {d.shape}; allowed: equal"
                f" shapes (..., {size})"
            )
        return ((d - a) / SCALE).reshape(*a.shape[:-1], -1, 3)

    def _near(self, ways: NDArray[np.float64]) -> NDArray[np.bool_]:
        across = np.hypot(ways[..., 0], ways[..., 1])
        return (across <= self._radius) & (np.abs(ways[..., 2]) <= self._height)


def check_reward(kind: str, where: str) -> RewardKind:
    """Return a kind of reward.

    Raises:
        UnknownNameError: no such kind
    """
    if kind not in REWARDS:
        raise UnknownNameError("reward", kind, REWARDS, where)
    return kind


def _conditions(info: Any) -> Any:
    """Return the conditions in an info, (G,), or in one for each transition, (n, G); else True."""
    if isinstance(info, Mapping):
        return np.asarray(cast(Any, info).get("conditions", True))
    each = [one.get("conditions") for one in info]
    if not each or any(one is None for one in each):
        return True
    return np.array(each)
