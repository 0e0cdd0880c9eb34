"""Python calls that an action makes, for tests of how short a way through the package is."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import trocar

PACKAGE = Path(trocar.__file__).parent


class Call(NamedTuple):
    """A call of a Python function: its file, in the package, and its name."""

    file: str
    function: str


def in_package(frame: FrameType) -> bool:
    """Tell whether a frame runs a function of trocar."""
    return frame.f_code.co_filename.startswith(f"{PACKAGE}")


def calls_of(
    action: Callable[[], object], counted: Callable[[FrameType], bool] = in_package
) -> list[Call]:
    """List the Python calls that an action makes, in order.

    Args:
        action: called once
        counted: which frames count; those of trocar by default
    """
    calls: list[Call] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and counted(frame):
            file = frame.f_code.co_filename.removeprefix(f"{PACKAGE}/")
            calls.append(Call(file, frame.f_code.co_name))

    before = sys.getprofile()
    gc.disable()  # a collection here would call what others hang on to it
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(before)
        gc.enable()
    return calls


def changes_of_file(calls: Sequence[Call]) -> int:
    """Count the changes from one file to another from call to call."""
    return sum(one.file != other.file for one, other in pairwise(calls))
