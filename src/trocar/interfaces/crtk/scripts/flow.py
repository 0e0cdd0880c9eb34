"""What runs beneath a script: a simulation, its time, and the bus to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from trocar.interfaces.crtk.component import Component
from trocar.interfaces.crtk.core import Core
from trocar.interfaces.crtk.scripts.bus import Bus
from trocar.interfaces.loop import Loop

#: Makes what is served beside the arms, of the loop.
Parts = Callable[[Loop], Sequence[Component]]


def no_parts(loop: Loop) -> Sequence[Component]:  # noqa: ARG001  as every one
    """Return nothing."""
    return ()


class Flow(Protocol):
    """A simulation as a script's modules see it: `Stepped` or `Live`."""

    #: Whether the script's time is the simulation's alone.
    virtual: bool
    core: Core
    bus: Bus

    @property
    def steps(self) -> int:
        """Ticks so far."""
        ...

    @property
    def simulated_s(self) -> float:
        """Time that has passed [s]."""
        ...

    def start(self) -> None:
        """Start."""
        ...

    def close(self) -> None:
        """End."""
        ...

    def now_ns(self) -> int:
        """Return the time that stamps tell [ns]."""
        ...

    def look(self) -> None:
        """Note that the script looks at the clock or at a reading."""
        ...

    def wait(self, ready: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait until something holds; return whether it does; None: for ever."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for some time [s]."""
        ...

    def peek(self, name: str) -> dict[str, Any] | None:
        """Return what a topic would tell now, None where only its messages tell."""
        ...

    def fail(self, failure: BaseException) -> None:
        """End the run from another thread."""
        ...
