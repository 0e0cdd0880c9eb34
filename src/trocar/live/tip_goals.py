"""Tips that follow goals of people: set-points at 200 Hz on the way there, at a bounded speed."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import (
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)
from trocar.geometry.se3 import pose_difference, transform
from trocar.live.inbox import Command
from trocar.live.loop import Loop
from trocar.live.state import PATIENT, Elapsed

if TYPE_CHECKING:
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]

PERIOD_S = 0.005
"""Simulated time between two set-points [s]. Source: measured: goals of a mouse at 30 Hz as
set-points jerk the tip by 1.28 m/s^2 RMS, interpolated to 200 Hz by 0.30."""

SPEED_M_S, TURN_RAD_S = 0.1, 1.5
"""Largest speed of the tip on its way. Source: our own choice, a brisk hand's."""

GAP_S = 0.1
"""Longest time over which the way to a goal is spread [s]: that between it and the goal before, so
that a mouse at 30 Hz moves the tip evenly. Source: our own choice."""

LEAD_M = 0.03
"""Set-points wait where the tip is so far behind, as on a table [m]. Source: our own choice: below
the PSM's tracking tolerance in insertion, 50 mm; with the dVRK's gains, a tip at rest stands up to
10 mm off (measured)."""

MISSED_M, MISSED_RAD = 5e-4, 0.01
"""Distance between a goal and the set-point from which on the goal is out of reach. Source: our own
choice."""


class TipGoals:
    """Bring tips to goals, as a watcher of a loop.

    Args:
        loop: takes set-points; goals are those of its world

    Attributes:
        missed: {arm: reason} of goals out of reach; replaced as a whole, from any thread
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._every = max(1, round(PERIOD_S / loop.tick_s))
        self._goals: dict[str, Array] = {}
        self._way: dict[str, Array] = {}
        self._paced: dict[str, tuple[Array, float, float]] = {}
        self._lock = threading.Lock()
        self._due_s = 0.0
        self.missed: Mapping[str, str] = {}

    def set(self, arm: str, goal: Array) -> None:
        """Bring a tip to a goal, T_world_tip (4, 4), from any thread; it replaces the last one."""
        with self._lock:
            self._goals[arm] = np.array(goal, dtype=np.float64)

    def stop(self, arm: str) -> None:
        """Leave an arm where it is, from any thread."""
        with self._lock:
            self._goals.pop(arm, None)

    def ticked(self, elapsed: Elapsed) -> None:
        """Command the next set-points."""
        if elapsed.paused or elapsed.simulated_s < self._due_s - 1e-9:
            return
        with self._lock:
            goals = dict(self._goals)
        for arm in self._way.keys() - goals.keys():
            del self._way[arm]
        if not goals:
            return
        self._due_s = elapsed.simulated_s + PERIOD_S
        for arm, goal in goals.items():
            left = self._left(arm, goal, elapsed.simulated_s)
            self._advance(arm, self._loop.world.arm(arm), goal, left)

    def patience(self) -> int:
        """Return after how many ticks to be called again."""
        return self._every if self._goals else PATIENT

    def refused(self, command: Command, reason: str) -> None:
        """Ignore rejected commands: `missed` has the reason."""

    def _left(self, name: str, goal: Array, now_s: float) -> float:
        """Return the time over which the rest of the way is spread [s]."""
        last, came_s, due_s = self._paced.get(name, (None, -np.inf, 0.0))
        if last is not goal:
            due_s = now_s + min(now_s - came_s, GAP_S)
            self._paced[name] = goal, now_s, due_s
        return due_s - now_s

    def _advance(self, name: str, arm: Arm, goal: Array, left_s: float) -> None:
        """Command the next set-point of an arm; its way ends at the goal, or as near as limits let.

        A tip that something holds up waits.
        """
        held = arm.setpoint_cp("world").matrix
        way = self._way.get(name)
        if way is not None and _same(way, goal):
            missed = _apart(held, goal)
            self._say(name, (arm.rejections.last or "out of reach") if missed else "")
            with self._lock:
                if self._goals.get(name) is goal:
                    del self._goals[name]
            return
        lead = float(np.linalg.norm(held[:3, 3] - arm.measured_cp("world").matrix[:3, 3]))
        if way is None:
            way = held
        why = f"something holds the tip up, {1e3 * lead:.0f} mm behind its set-point"
        if lead < LEAD_M:
            why = arm.rejections.last if _apart(held, way) else ""
            metres, radians = SPEED_M_S * PERIOD_S, TURN_RAD_S * PERIOD_S
            if left_s > PERIOD_S:
                far, angle = pose_difference(way, goal)
                metres = min(metres, float(far) * PERIOD_S / left_s)
                radians = min(radians, float(angle) * PERIOD_S / left_s)
            way = step_towards(way, goal, metres, radians)
        self._way[name] = way
        self._say(name, why)
        self._loop.post(Command(name, "servo_cp", {"T": way, "frame": "world"}))

    def _say(self, name: str, why: str) -> None:
        if why != self.missed.get(name, ""):
            others = {arm: said for arm, said in self.missed.items() if arm != name}
            self.missed = {**others, name: why} if why else others


def step_towards(pose: Array, goal: Array, metres: float, radians: float) -> Array:
    """Return the pose a step nearer to a goal, along a line and about one axis.

    Args:
        pose, goal: (4, 4)
        metres, radians: largest translation and rotation

    Returns:
        (4, 4); the goal, when it is nearer
    """
    line = goal[:3, 3] - pose[:3, 3]
    turn = rotation_vector_from_matrix(goal[:3, :3] @ pose[:3, :3].T)
    far, angle = float(np.linalg.norm(line)), float(np.linalg.norm(turn))
    share = min(1.0, metres / far if far > 0.0 else 1.0, radians / angle if angle > 0.0 else 1.0)
    if share == 1.0:
        return goal
    turned = matrix_from_rotation_vector(share * turn) @ pose[:3, :3]
    return transform(turned, pose[:3, 3] + share * line)


def _same(a: Array, b: Array) -> bool:
    return a.tolist() == b.tolist()


def _apart(a: Array, b: Array) -> bool:
    metres, radians = pose_difference(a, b)
    return bool(metres > MISSED_M or radians > MISSED_RAD)
