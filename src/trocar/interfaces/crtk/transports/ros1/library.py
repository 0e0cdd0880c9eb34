"""The way to rospy, which comes with ROS 1 and not from PyPI."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from trocar.errors import TrocarError

#: What Debian 12 (and Ubuntu, from 22.04 on) call what `--ros1` needs.
PACKAGES = (
    "python3-rospy",
    "python3-rosmaster",
    "python3-std-msgs",
    "python3-rosgraph-msgs",
)


@dataclass(frozen=True)
class Library:
    """The modules of ROS 1 that are used here."""

    rospy: ModuleType
    genpy: ModuleType
    rosgraph: ModuleType


class MissingRospyError(TrocarError):
    """This Python cannot import rospy; `python` is which one, `reason` why not."""

    def __init__(self, python: str, reason: str) -> None:
        self.python, self.reason = python, reason
        super().__init__(
            f"--ros1: {python} has no rospy ({reason}). It is not on PyPI; Debian and Ubuntu have"
            f" it for /usr/bin/python3 only: sudo apt install {' '.join(PACKAGES)}, then"
            " make ros1-venv and .venv-ros1/bin/trocar sim --ros1 (docs/ros.md, ROS 1)"
        )


def load() -> Library:
    """Import rospy.

    Raises:
        MissingRospyError: there is none for this Python
    """
    try:
        import genpy  # pyright: ignore[reportMissingImports]
        import rosgraph  # pyright: ignore[reportMissingImports]
        import rospy  # pyright: ignore[reportMissingImports]
        import rospy.impl.paramserver  # pyright: ignore[reportMissingImports]
        import rospy.impl.registration  # pyright: ignore[reportMissingImports]
        import rospy.impl.tcpros_base  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingRospyError(sys.executable, str(error)) from error
    return Library(rospy, genpy, rosgraph)


def inner(library: Library, name: str) -> Any:
    """Return one of rospy's inner modules, such as "impl.registration"."""
    return sys.modules[f"{library.rospy.__name__}.{name}"]
