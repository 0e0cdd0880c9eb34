"""The last seconds of every arm's motion, for the plots."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from trocar.simulation.records import Snapshot

Floats = NDArray[np.float64]

SPAN_S = 10.0
"""How far back the plots look [s of simulated time]. Source: our own choice."""

LENGTH = 400
"""Most samples kept: the span at 30 looks a second, and some."""


@dataclass(frozen=True)
class Trace:
    """One joint's recent motion: times before now [s], commanded and measured [rad or m]."""

    ago: Floats
    commanded: Floats
    measured: Floats


class History:
    """Remember snapshots for a while."""

    def __init__(self) -> None:
        self._kept: deque[Snapshot] = deque(maxlen=LENGTH)

    def add(self, snapshot: Snapshot) -> None:
        """Remember a snapshot; forget what is too old.

        Everything is forgotten when time was set back or an arm got another tool.
        """
        last = self._kept[-1] if self._kept else snapshot
        if snapshot.time < last.time or snapshot.build != last.build:
            self._kept.clear()
        if not self._kept or snapshot.time > self._kept[-1].time:
            self._kept.append(snapshot)
        while snapshot.time - self._kept[0].time > SPAN_S:
            self._kept.popleft()

    def trace(self, arm: str, joint: int) -> Trace:
        """Take out one joint's motion."""
        kept = list(self._kept)
        times = np.array([snapshot.time for snapshot in kept])
        return Trace(
            ago=times - times[-1] if kept else times,
            commanded=np.array([snapshot.arms[arm].setpoint[joint] for snapshot in kept]),
            measured=np.array([snapshot.arms[arm].q[joint] for snapshot in kept]),
        )
