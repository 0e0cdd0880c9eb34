"""The messages of one arm as they arrive, and what they mean as numbers."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.conformance.expectations import ArmExpectation
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import pose_difference, transform
from trocar.messages import message_names
from trocar.ros.client import Graph, RosClient

Array = NDArray[np.float64]
Message = Mapping[str, Any]


#: Messages of a topic that are kept: several seconds at 1 kHz. Source: our own choice.
KEPT = 5000
#: Period in which pauses of this program are noticed [s]. Source: our own choice.
LOOK_S = 0.01


@dataclass(frozen=True)
class Arrival:
    """A message and when it arrived [s]."""

    time: float
    message: Message


class ArmObserver:
    """Subscribes to the topics of an arm and keeps what arrives.

    Args:
        client: connected
        arm: name, the prefix of its topics
        expected: the interface that is expected of it
        graph: topics and services that are offered

    Attributes:
        subscribed: {topic without the arm: when it was subscribed to [s]}
    """

    def __init__(self, client: RosClient, arm: str, expected: ArmExpectation, graph: Graph) -> None:
        self.client, self.arm, self.expected, self.graph = client, arm, expected, graph
        self.subscribed: dict[str, float] = {}
        self._lock = threading.Lock()
        self._arrived: dict[str, deque[Arrival]] = {}
        self._ends: dict[str, Callable[[], None]] = {}

    def start(self) -> None:
        """Subscribe to every expected topic that is published with a known type."""
        for key in (*self.expected.events, *self.expected.streams):
            kind = self.graph.published.get(f"{self.arm}/{key}", "")
            if kind in message_names():
                self.subscribed[key] = self.client.now()
                take = partial(self._take, key)
                self._ends[key] = self.client.subscribe(f"{self.arm}/{key}", kind, take)

    def close(self, *keys: str) -> None:
        """Unsubscribe from these topics, by default from all."""
        for key in keys or tuple(self._ends):
            if key in self._ends:
                self._ends.pop(key)()

    def watch(self, seconds: float) -> float:
        """Let time pass; return the longest pause of this program beside it [s]."""
        end, longest = self.client.now() + seconds, 0.0
        while (before := self.client.now()) < end:
            self.client.sleep(LOOK_S)
            longest = max(longest, self.client.now() - before - LOOK_S)
        return longest

    def _take(self, key: str, message: Message) -> None:
        arrival = Arrival(self.client.now(), message)
        with self._lock:
            self._arrived.setdefault(key, deque(maxlen=KEPT)).append(arrival)

    def since(self, time: float, key: str) -> list[Arrival]:
        """Return the messages of a topic that arrived after a time [s]."""
        with self._lock:
            found: list[Arrival] = []
            for row in reversed(self._arrived.get(key, ())):
                if row.time < time:
                    break
                found.append(row)
        return found[::-1]

    def last(self, key: str) -> Arrival | None:
        """Return the newest message of a topic, None before the first."""
        with self._lock:
            rows = self._arrived.get(key)
            return rows[-1] if rows else None

    def positions(self, key: str) -> Array | None:
        """Return the newest positions of a topic of joints, (n,); None before the first."""
        newest = self.last(key)
        return None if newest is None else numbers(newest.message, "position")

    @property
    def state(self) -> str:
        """The newest operating state, "" before the first."""
        newest = self.last("operating_state")
        return "" if newest is None else str(newest.message["state"])

    def flag(self, name: str) -> bool:
        """Return is_homed or is_busy of the newest operating state."""
        newest = self.last("operating_state")
        return newest is not None and bool(newest.message[name])

    def has_command(self, key: str) -> bool:
        """Test whether the arm subscribes to a command of the expected type."""
        return self.graph.subscribed.get(f"{self.arm}/{key}") == self.expected.commands.get(key)

    def call(self, key: str, fields: Message) -> Message:
        """Call a service of the arm.

        Raises:
            TrocarError: it is not there or does not answer
        """
        return self.client.call(f"{self.arm}/{key}", self.expected.services[key], fields)

    def publish(self, key: str, fields: Message) -> None:
        """Send a command to the arm."""
        self.client.publish(f"{self.arm}/{key}", self.expected.commands[key], fields)


def numbers(message: Message, name: str) -> Array:
    """Return a list of numbers, (n,)."""
    return np.asarray(message[name], np.float64)


def stamp(message: Message) -> float:
    """Return the stamp of a header [s]."""
    seconds, nanoseconds = message["header"]["stamp"]
    return float(seconds) + 1e-9 * float(nanoseconds)


def stamps(rows: Sequence[Arrival]) -> Array:
    """Return the stamps of messages, (k,) [s]."""
    return np.array([stamp(row.message) for row in rows])


def xyz(message: Message) -> Array:
    """Return x, y, z, (3,)."""
    return np.array([float(message[axis]) for axis in "xyz"])


def quaternion(message: Message) -> Array:
    """Return w, x, y, z, (4,)."""
    return np.array([float(message[axis]) for axis in "wxyz"])


def pose(message: Message) -> Array:
    """Return the pose of a geometry_msgs/Pose, its quaternion normalised, (4, 4) [m].

    Without a length of the quaternion, or with infinite numbers, it is NaN.
    """
    turn, place = quaternion(message["orientation"]), xyz(message["position"])
    if not (np.isfinite(turn).all() and np.isfinite(place).all() and turn.any()):
        return np.full((4, 4), np.nan)
    return transform(matrix_from_quaternion(turn), place)


def twist(message: Message) -> Array:
    """Return (linear; angular) of a geometry_msgs/Twist, (6,) [m/s, rad/s]."""
    return np.concatenate([xyz(message["linear"]), xyz(message["angular"])])


def pose_error(Ta: Array, Tb: Array) -> tuple[float, float]:
    """Measure the distance of two poses (4, 4) [m, rad]; infinity for NaN."""
    if not (np.isfinite(Ta).all() and np.isfinite(Tb).all()):
        return float("inf"), float("inf")
    distance, angle = pose_difference(Ta, Tb)
    return float(distance), float(angle)
