"""Episodes of a task: one, or many on local processes, with the same results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Episode:
    """What came of an episode; it follows from scene, seed and policy, to the last bit.

    Attributes:
        scene, seed: which
        success: whether all goals were met, and stayed so
        reason: why it ended: "done", "time", or what went wrong
        score: points, see `fls_score`
        time_s: until it ended, simulated [s]
        goals, met: how many there are, and how many were met in the end
        drops: objects that fell after they were held, or left the table
        distance_m: {arm: length of the tip's path} [m]
        force_n: {arm: largest net force of contacts on it} [N]
        grip_n: {arm: largest force of the weaker finger on an object} [N]
        grasp: what holds objects, as the rig has it: "friction+stick"
        digest: of the physics state in the end
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
    grasp: str
    digest: str
