"""Tips that follow goals of people: set-points at 200 Hz on the way there, at a bounded speed."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
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

EVEN_S, GAP_S = 0.02, 0.1
"""Bounds of the time between two goals of a motion [s]: goals that come closer, as a network
delivers them, are no faster, and one that comes later begins a new motion. Source: our own choice;
a mouse has 0.033."""

COAST = 1.25
"""Time for which a goal goes on at its velocity, over that between it and the goal before. Source:
our own choice: a quarter more than regular goals need."""

AHEAD_S = 0.01
"""Time by which set-points run ahead of a goal that moves [s]. Source: measured, with `RATE`."""

RATE, STOP_RATE = 10.5, 40.0
"""Natural frequencies of the follower while the goal moves, and when it stands [1/s]. Source:
measured: faster ones jerk the tip more, slower ones lag."""

NEAR = 1e-4
"""Distance from which a goal that stands is taken as the set-point [m or rad]. Source: our own
choice: below a pixel."""

LEAD_M = 0.03
"""Set-points wait where the tip is so far behind, as on a table [m]. Source: our own choice: below
the PSM's tracking tolerance in insertion, 50 mm; with the dVRK's gains, a tip at rest stands up to
10 mm off (measured)."""

MISSED_M, MISSED_RAD = 5e-4, 0.01
"""Distance between a goal and the set-point from which on the goal is out of reach. Source: our own
choice."""


@dataclass
class _Way:
    """The way of a tip to its goal; velocities are (linear; angular) in the world's axes, (6,).

    Attributes:
        pose, velocity: last set-point, T_world_tip [m/s, rad/s]
        goal, goal_velocity: T_world_tip [m/s, rad/s]
        came_s, stands_s: when the goal came, and from when on it stands
    """

    pose: Array
    goal: Array
    velocity: Array = field(default_factory=lambda: np.zeros(6))
    goal_velocity: Array = field(default_factory=lambda: np.zeros(6))
    came_s: float = -np.inf
    stands_s: float = -np.inf


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
        self._ways: dict[str, _Way] = {}
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
        for arm in self._ways.keys() - goals.keys():
            del self._ways[arm]
        if not goals:
            return
        self._due_s = elapsed.simulated_s + PERIOD_S
        for arm, goal in goals.items():
            self._advance(arm, self._loop.world.arm(arm), goal, elapsed.simulated_s)

    def patience(self) -> int:
        """Return after how many ticks to be called again."""
        return self._every if self._goals else PATIENT

    def refused(self, command: Command, reason: str) -> None:
        """Ignore rejected commands: `missed` has the reason."""

    def _advance(self, name: str, arm: Arm, goal: Array, now_s: float) -> None:
        """Command the next set-point of an arm; its way ends at the goal, or as near as limits let.

        A tip that something holds up waits.
        """
        held = arm.setpoint_cp("world").matrix
        way = self._ways.get(name)
        if way is None:
            way = self._ways[name] = _Way(held, held)
        if way.goal is not goal:
            _aim(way, goal, now_s)
        elif _same(way.pose, goal):
            missed = _apart(held, goal)
            self._say(name, (_reason(arm) or "out of reach") if missed else "")
            del self._ways[name]
            with self._lock:
                if self._goals.get(name) is goal:
                    del self._goals[name]
            return
        lead = float(np.linalg.norm(held[:3, 3] - arm.measured_cp("world").matrix[:3, 3]))
        why = f"something holds the tip up, {1e3 * lead:.0f} mm behind its set-point"
        if lead < LEAD_M:
            why = _reason(arm) if _apart(held, way.pose) else ""
            _go_on(way, now_s + PERIOD_S)
        else:
            way.velocity = np.zeros(6)
        self._say(name, why)
        self._loop.post(Command(name, "servo_cp", {"T": way.pose, "frame": "world"}))

    def _say(self, name: str, why: str) -> None:
        if why != self.missed.get(name, ""):
            others = {arm: said for arm, said in self.missed.items() if arm != name}
            self.missed = {**others, name: why} if why else others


def _reason(arm: Arm) -> str:
    """The reason of the last miss, without the verb: a person dragged a handle."""
    return arm.rejections.last.removeprefix("servo_cp: ")


def _aim(way: _Way, goal: Array, now_s: float) -> None:
    """Follow another goal, which moves if it soon follows the one before."""
    since_s = max(now_s - way.came_s, EVEN_S)
    way.goal_velocity = _change(way.goal, goal) / since_s if since_s < GAP_S else np.zeros(6)
    way.goal, way.came_s, way.stands_s = goal, now_s, now_s + COAST * since_s


def _go_on(way: _Way, now_s: float) -> None:
    """Move on by a period: a critically damped follower of the goal, extrapolated to now."""
    moves = now_s < way.stands_s and bool(way.goal_velocity.any())
    rate, speed = (RATE, way.goal_velocity) if moves else (STOP_RATE, np.zeros(6))
    error = _change(way.pose, way.goal)
    if moves:
        error += (now_s + AHEAD_S - way.came_s) * speed
    velocity = way.velocity + PERIOD_S * rate * (rate * error + 2 * (speed - way.velocity))
    planned = _moved(way.pose, PERIOD_S * velocity)
    if not moves and max(np.abs(error).max(), np.abs(velocity).max() / rate) < NEAR:
        planned = way.goal
    pose = step_towards(way.pose, planned, SPEED_M_S * PERIOD_S, TURN_RAD_S * PERIOD_S)
    way.velocity = velocity if pose is planned else _change(way.pose, pose) / PERIOD_S
    way.pose = pose


def _change(before: Array, after: Array) -> Array:
    """Return a displacement as translation and rotation vector in the world's axes, (6,)."""
    turn = rotation_vector_from_matrix(after[:3, :3] @ before[:3, :3].T)
    return np.concatenate([after[:3, 3] - before[:3, 3], turn])


def _moved(pose: Array, change: Array) -> Array:
    """Return a pose after a displacement, as `_change`."""
    turned = matrix_from_rotation_vector(change[3:]) @ pose[:3, :3]
    return transform(turned, pose[:3, 3] + change[:3])


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
