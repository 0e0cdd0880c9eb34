"""Steps of a plan, and the small geometry that plans need; no ROS and no trocar."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

#: Posture of a PSM after `home` in simulation. Source: recorded, `A9 home`. [rad, m]
HOME = (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)


class Driven(Protocol):
    """An arm as a plan sees it; `drive.Arm` is one over ROS 1."""

    name: str

    def advertise(self, topic: str, kind_name: str) -> None:
        """Connect to a topic's subscribers, so that a later command is not late."""

    def send(self, topic: str, kind_name: str, **fields: Any) -> None:
        """Publish a message of a type; a topic that begins with / is not the arm's."""

    def call(self, service: str, kind_name: str, **fields: Any) -> Any:
        """Call a service; return its response as a dictionary, or the error's text."""

    def joints(self, topic: str, positions: Any, **fields: Any) -> None:
        """Publish a JointState."""

    def inverse(self, jp: Sequence[float], p: Any, R: Any) -> Any:
        """Call inverse_kinematics."""

    def state(self, command: str) -> None:
        """Publish a state_command."""

    def pose(self, topic: str, p: Any, R: Any, frame: str = "") -> None:
        """Publish a PoseStamped; R is a rotation matrix, or a quaternion x, y, z, w."""

    def get(self, topic: str) -> dict[str, Any] | None:
        """Return the newest message of a topic as a dictionary."""

    def q(self, topic: str = "setpoint_js") -> NDArray[np.float64]:
        """Return the newest joint positions of a topic."""
        ...

    def tip(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return position and rotation matrix of setpoint_cp."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass."""

    def wait_busy(self, timeout: float = 15.0, settle: float = 0.3) -> None:
        """Wait until the arm is not busy."""

    def fact(self, name: str, value: Any) -> None:
        """Record a single answer."""


Act = Callable[[], object]


@dataclass(frozen=True)
class Step:
    """One step of a plan.

    Attributes:
        name: unique in its plan but for repeated `back` and `fix`
        act: commands, None: listen only
        wait: time until the step ends [s]; None: when the arm is not busy any more
        timeout: longest time of that wait [s]
    """

    name: str
    act: Act | None = None
    wait: float | None = 0.4
    timeout: float = 15.0


#: Parts of a plan by name; each yields its steps, and runs on once a step has ended.
Parts = Mapping[str, Callable[[Driven], Iterator[Step]]]


def recover(arm: Driven) -> None:
    """Bring an arm to ENABLED and homed from any state."""
    seen = arm.get("operating_state")
    if seen is not None and seen["state"] == "ENABLED" and seen["is_homed"]:
        return
    for command, wait in (("disable", 0.5), ("enable", 1.5), ("home", 0.5)):
        arm.state(command)
        arm.sleep(wait)
    for _ in range(240):
        seen = arm.get("operating_state")
        if seen and seen["state"] == "ENABLED" and seen["is_homed"] and not seen["is_busy"]:
            break
        arm.sleep(0.05)
    arm.sleep(0.5)


def rotation(axis: Sequence[float], angle: float) -> NDArray[np.float64]:
    """Return the rotation matrix of an angle [rad] about an axis, (3, 3)."""
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)


def quaternion(R: NDArray[np.float64]) -> list[float]:
    """Return the quaternion x, y, z, w of a rotation matrix."""
    # The eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric matrix.
    (a, b, c), (d, e, f), (g, h, i) = R
    K = np.array([
        [a - e - i, b + d, c + g, h - f],
        [b + d, e - a - i, f + h, c - g],
        [c + g, f + h, i - a - e, d - b],
        [h - f, c - g, d - b, a + e + i],
    ])  # fmt: skip
    return [float(x) for x in np.linalg.eigh(K)[1][:, -1]]


def matrix(quaternion: Sequence[float]) -> NDArray[np.float64]:
    """Return the rotation matrix of a unit quaternion x, y, z, w."""
    x, y, z, w = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
