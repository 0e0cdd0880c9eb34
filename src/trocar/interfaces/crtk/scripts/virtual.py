"""Stand-ins of `time` and `threading` whose time is the simulation's.

A script imports these while its simulation is stepped. Whatever is not named here is the real
module's own.
"""

from __future__ import annotations

import builtins
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from trocar.interfaces.crtk.clock import SECOND
from trocar.interfaces.crtk.scripts.stepped import Stepped
from trocar.interfaces.crtk.scripts.virtual_threads import thread_classes

#: How long a person takes to answer `input`, in simulated time; our own choice. [s]
ANSWER_S = 1.0


class Standing(ModuleType):
    """A module that has some names of its own; the others are a real module's.

    Args:
        real: that module
        own: {name: value}
    """

    def __init__(self, real: ModuleType, own: Mapping[str, Any]) -> None:
        super().__init__(real.__name__, real.__doc__)
        self.__dict__.update(own)
        self.__dict__["_real"] = real
        self.__dict__["__spec__"] = real.__spec__

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_real"], name)

    def __dir__(self) -> list[str]:
        return sorted({*dir(self.__dict__["_real"]), *self.__dict__})


def virtual_modules(flow: Stepped) -> dict[str, ModuleType]:
    """Return {name: module} of what tells time or waits."""
    clock = time_names(flow)
    return {
        "time": Standing(time, clock),
        "threading": Standing(threading, thread_classes(flow, clock["monotonic"])),
    }


def time_names(flow: Stepped) -> dict[str, Callable[..., Any]]:
    """Return what stands in for the functions of `time`; they all tell the stamps' time."""

    def now_ns() -> int:
        flow.look()
        return flow.clock_ns()

    def now() -> float:
        return now_ns() / SECOND

    def sleep(seconds: float) -> None:
        if seconds < 0:
            raise ValueError("sleep length must be non-negative")
        flow.sleep(seconds)

    names = ("time", "monotonic", "perf_counter")
    own: dict[str, Callable[..., Any]] = {"sleep": sleep, **dict.fromkeys(names, now)}
    return own | dict.fromkeys((f"{name}_ns" for name in names), now_ns)


@contextmanager
def answering(flow: Stepped) -> Iterator[None]:
    """Let time pass whenever the script waits for a line, until the block ends."""
    read = builtins.input

    def answer(prompt: object = "", /) -> str:
        line = read(prompt)
        flow.sleep(ANSWER_S)
        return line

    builtins.input = answer
    try:
        yield
    finally:
        builtins.input = read
