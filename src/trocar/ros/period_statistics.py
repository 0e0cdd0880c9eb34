"""Statistics of periods, as the dVRK's software publishes them for each of its components.

Source: cisst fe84bf08, mtsIntervalStatistics.cpp; cisst-ros 73aca61, mtsROSBridge and
mts_ros_crtk_bridge_provided.cpp (200 ms between messages); IntervalStatistics.msg.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, sqrt
from typing import Any

from trocar.ros.clock import Stamp
from trocar.ros.message_builders import header

#: Length of a window, and rate of messages. Source: as above. [s, Hz]
WINDOW_S, RATE_HZ = 1.0, 5.0
CONTROL, PUBLISHING, FRAMES = "control", "publishing", "tf"


class PeriodStatistics:
    """Periods and compute times of a window, and the figures of the window before."""

    def __init__(self) -> None:
        self._figures: dict[str, float] = dict.fromkeys(FIGURES, 0.0)
        self._restart()

    def add(self, period_s: float, compute_s: float = 0.0, count: int = 1) -> None:
        """Count a number of equal periods [s]."""
        self._count += count
        mean_s = self._figures["period_avg"]
        late = self._figures["number_of_samples"] > 0 and compute_s > mean_s
        self._overruns += count if late else 0
        for sums, value in ((self._periods, period_s), (self._computed, compute_s)):
            sums[0] += count * value
            sums[1] += count * value * value
            sums[2], sums[3] = min(sums[2], value), max(sums[3], value)
        if self._periods[0] > WINDOW_S:
            self._close()

    def message(self, stamp: Stamp) -> dict[str, Any]:
        """Return a cisst_msgs/IntervalStatistics of the last whole window; zeros before it."""
        whole = {name: int(self._figures[name]) for name in COUNTS}
        return {
            "header": header(stamp),
            **self._figures,
            **whole,
            "statistics_interval": WINDOW_S,
            "user_data": 0,
        }

    def _close(self) -> None:
        found = self._figures
        for name, (total, squares, least, most) in (
            ("period", self._periods),
            ("compute_time", self._computed),
        ):
            mean = total / self._count
            found[f"{name}_avg"] = mean
            found[f"{name}_std_dev"] = sqrt(max(squares / self._count - mean * mean, 0.0))
            found[f"{name}_min"], found[f"{name}_max"] = least, most
        found["number_of_samples"], found["number_of_overruns"] = self._count, self._overruns
        self._restart()

    def _restart(self) -> None:
        self._count = self._overruns = 0
        # Sum, sum of squares, least and most.
        self._periods, self._computed = [0.0, 0.0, inf, 0.0], [0.0, 0.0, inf, 0.0]


COUNTS = ("number_of_samples", "number_of_overruns")
FIGURES = (
    *(f"{of}_{what}" for of in ("period", "compute_time") for what in ("avg", "std_dev")),
    *(f"{of}_{what}" for of in ("period", "compute_time") for what in ("min", "max")),
    *COUNTS,
)


class Stopwatches:
    """The statistics of a running core, by what they are of."""

    def __init__(self) -> None:
        self.of: Mapping[str, PeriodStatistics] = {
            name: PeriodStatistics() for name in (CONTROL, PUBLISHING, FRAMES)
        }
        self._before: dict[str, float] = {}
        self._time_s = 0.0

    def sampled(self, now_s: float, time_s: float, period_s: float, compute_s: float) -> None:
        """Count a sample.

        Args:
            now_s: wall time [s]
            time_s: simulated time of the sample [s]
            period_s: control period, in simulated time [s]
            compute_s: time that messages of the sample before took [s]
        """
        since = self._since(PUBLISHING, now_s)
        passed, self._time_s = round((time_s - self._time_s) / period_s), time_s
        if since is not None:
            self.of[PUBLISHING].add(since, compute_s)
            if passed > 0:  # neither paused nor set back
                self.of[CONTROL].add(since / passed, count=passed)

    def framed(self, now_s: float) -> None:
        """Count a period of tf; `now_s` as above."""
        since = self._since(FRAMES, now_s)
        if since is not None:
            self.of[FRAMES].add(since)

    def _since(self, name: str, now_s: float) -> float | None:
        before, self._before[name] = self._before.get(name), now_s
        return None if before is None else now_s - before
