"""The way to rclpy, which comes with ROS 2 and not from PyPI."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.util import find_spec
from types import ModuleType

from trocar.errors import InputError


@dataclass(frozen=True)
class Library:
    """The modules of rclpy that are used here."""

    rclpy: ModuleType
    context: ModuleType
    exceptions: ModuleType
    executors: ModuleType
    qos: ModuleType
    serialization: ModuleType


class MissingRclpyError(InputError):
    """This Python cannot import rclpy.

    Attributes:
        python: which one
        reason: why not
        there: whether there is an rclpy, though of another Python
    """

    def __init__(self, python: str, reason: str, *, there: bool) -> None:
        self.python, self.reason, self.there = python, reason, there
        super().__init__(
            f"--ros2 rclpy: {python} cannot import rclpy ({reason}). It comes with ROS 2:"
            " source /opt/ros/DISTRO/setup.bash, and run trocar with the Python that this ROS 2 is"
            " made for (Jazzy: 3.12); or use --ros2 dds, which needs no ROS (docs/ros.md, ROS 2)"
        )


def load() -> Library:
    """Import rclpy.

    Raises:
        MissingRclpyError: there is none for this Python
    """
    try:
        import rclpy  # pyright: ignore[reportMissingImports]
        import rclpy.context  # pyright: ignore[reportMissingImports]
        import rclpy.exceptions  # pyright: ignore[reportMissingImports]
        import rclpy.executors  # pyright: ignore[reportMissingImports]
        import rclpy.node  # pyright: ignore[reportMissingImports]
        import rclpy.qos  # pyright: ignore[reportMissingImports]
        import rclpy.serialization  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingRclpyError(sys.executable, str(error), there=_is_there()) from error
    return Library(
        rclpy,
        rclpy.context,
        rclpy.exceptions,
        rclpy.executors,
        rclpy.qos,
        rclpy.serialization,
    )


def _is_there() -> bool:
    try:
        return find_spec("rclpy") is not None
    except ValueError:  # somebody has hidden it
        return False
