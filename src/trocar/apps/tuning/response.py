"""What the answer of a servo to a step says of it: rise, overshoot, settling, what is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Source: the usual definitions (Ogata, Modern Control Engineering, 5-3): from 10 to 90 %, and
#: within 2 % of the final value for good.
RISE_FROM, RISE_TO = 0.1, 0.9
SETTLING_BAND = 0.02
#: The final value is the mean over this share of the record, its end. An answer that settles only
#: there has not settled. Source: our own choice.
FINAL_SHARE = 0.1
#: A joint that moves by less than this share of the step does not answer. Source: our own choice.
LEAST_ANSWER = 0.1


@dataclass(frozen=True)
class StepResponse:
    """How a joint answered a step; what does not exist is NaN.

    Attributes:
        rise_time_s: from 10 to 90 % of the way that it went [s]
        overshoot: farthest beyond the final value, as a share of that way
        settling_time_s: from the step until it stays within 2 % of the way about the final value
        steady_error: target minus final value [rad or m]
        peak_effort_share: largest effort over the joint's limit, what holds gravity included
    """

    rise_time_s: float
    overshoot: float
    settling_time_s: float
    steady_error: float
    peak_effort_share: float


def step_response(
    time: Array, position: Array, target: float, peak_effort_share: float = float("nan")
) -> StepResponse:
    """Read off a step response.

    Times between two samples are interpolated.

    Args:
        time: since the step, evenly spaced from 0 on, (k,) [s]
        position: of the joint, the first one as the step found it, (k,) [rad or m]
        target: where the step leads [rad or m]
        peak_effort_share: is handed on
    """
    start = position[0]
    final = float(np.mean(position[-max(1, round(FINAL_SHARE * len(position))) :]))
    steady_error = float(target - final)
    if abs(final - start) < LEAST_ANSWER * abs(target - start):
        nothing = float("nan")
        return StepResponse(nothing, 0.0, nothing, steady_error, peak_effort_share)
    way = (position - start) / (final - start)
    return StepResponse(
        _first_time_at(time, way, RISE_TO) - _first_time_at(time, way, RISE_FROM),
        max(0.0, float(way.max()) - 1.0),
        _settling_time(time, way),
        steady_error,
        peak_effort_share,
    )


def _first_time_at(time: Array, way: Array, level: float) -> float:
    """Return when the answer first reaches a level."""
    after = int(np.argmax(way >= level))
    return _crossing(time, way, after, level)


def _settling_time(time: Array, way: Array) -> float:
    """Return when the answer enters the band for good, NaN when it does not in time."""
    outside = np.flatnonzero(np.abs(way - 1.0) > SETTLING_BAND)
    after = int(outside[-1]) + 1
    if after >= len(way) or time[after] > (1.0 - FINAL_SHARE) * time[-1]:
        return float("nan")
    edge = 1.0 + np.copysign(SETTLING_BAND, way[after - 1] - 1.0)
    return _crossing(time, way, after, float(edge))


def _crossing(time: Array, way: Array, after: int, level: float) -> float:
    """Return when the line from the sample before `after` to it passes a level."""
    before = max(after - 1, 0)
    rise = way[after] - way[before]
    share = (level - way[before]) / rise if rise else 0.0
    return float(time[before] + share * (time[after] - time[before]))
