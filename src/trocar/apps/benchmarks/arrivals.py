"""What a subscriber saw: which messages of a stream never came, and which came late."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]

#: A message that comes this much behind its schedule is late. Source: the project's own goal. [s]
LATE_S = 0.002


@dataclass(frozen=True)
class Arrivals:
    """One or several streams.

    Attributes:
        received, lost, late: how many messages came, never came, and came late
        worst_s: the longest that one was behind its schedule [s]
        factor: stamped time over the time in which it came, of the slowest stream
    """

    received: int
    lost: int
    late: int
    worst_s: float
    factor: float

    @property
    def late_percent(self) -> float:
        """Share of those that came [%]."""
        return 100.0 * self.late / max(self.received, 1)


def arrivals(stamped: Stamps, received: Stamps, rate_hz: float, late_s: float = LATE_S) -> Arrivals:
    """Judge one stream against its absolute schedule: message k is due k periods after the first.

    The schedule begins where the promptest message puts it, so a constant delay is none; one that
    grows is. Which k a message is, its stamp says.

    Args:
        stamped: header stamps in order of arrival, (n,) [ns]
        received: when each came, by a clock of the subscriber's, (n,) [ns]
        rate_hz: of the stream
        late_s: a message that comes this much behind its schedule is late [s]
    """
    if len(stamped) < 2:
        return Arrivals(len(stamped), 0, 0, 0.0, 0.0)
    period = 1e9 / rate_hz
    index = np.rint((stamped - stamped[0]) / period).astype(np.int64)
    behind = received - received[0] - index * period
    behind -= behind.min()
    lost = int(index.max() - index.min()) + 1 - len(np.unique(index))
    factor = float((stamped[-1] - stamped[0]) / max(received[-1] - received[0], 1))
    late = int((behind > 1e9 * late_s).sum())
    return Arrivals(len(stamped), lost, late, float(behind.max()) * 1e-9, factor)


def together(streams: list[Arrivals]) -> Arrivals:
    """Add streams up; one that never came has a factor of 0."""
    return Arrivals(
        sum(s.received for s in streams),
        sum(s.lost for s in streams),
        sum(s.late for s in streams),
        max((s.worst_s for s in streams), default=0.0),
        min((s.factor for s in streams), default=0.0),
    )
