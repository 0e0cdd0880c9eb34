"""Search P and D of one joint for the soonest settled step within bounds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from trocar.apps.tuning.response import StepResponse
from trocar.descriptions.records import Gains
from trocar.errors import DivergedError

#: Bounds of a tuned response. Source: our own choice: a little overshoot, a fifth of the motor's
#: effort kept for loads, and no more left of the step than dry friction leaves of it anyway.
MOST_OVERSHOOT = 0.05
MOST_EFFORT_SHARE = 0.8
MOST_STEADY_SHARE = 0.02
#: P and D stay within this factor of where they were: no simulated servo tells when a real one
#: would begin to sing. Source: our own choice.
MOST_FACTOR = 4.0
#: Factors by which P and D are changed, coarse to fine. Source: our own choice.
FACTORS = (2.0, 2.0**0.5, 2.0**0.25, 2.0**0.125)
#: A joint without D begins its search at P times this. Source: our own choice. [s]
FIRST_LEAD_S = 0.01
#: Settling times count as equal within this. Source: the physics period is ten times longer. [s]
SETTLING_STEP_S = 1e-4


@dataclass(frozen=True)
class Bounds:
    """What a response has to keep; it may be as bad as the present one in what that one breaks.

    Attributes:
        overshoot: share of the way
        effort_share: share of the joint's effort limit
        steady_error: either way [rad or m]
    """

    overshoot: float
    effort_share: float
    steady_error: float


def bounds(step: float, present: StepResponse) -> Bounds:
    """Return the bounds of the answer to a step [rad or m].

    Friction and weight leave a P servo an error: no more is asked than what the present gains keep.
    """
    left = max(MOST_STEADY_SHARE * abs(step), abs(present.steady_error))
    return Bounds(MOST_OVERSHOOT, MOST_EFFORT_SHARE, left)


def cost(response: StepResponse, allowed: Bounds) -> tuple[float, float]:
    """Return the criterion, smaller is better: first what breaks the bounds, then settling time."""
    pairs = (
        (response.overshoot, allowed.overshoot),
        (response.peak_effort_share, allowed.effort_share),
        (abs(response.steady_error), allowed.steady_error),
    )
    broken = sum(max(0.0, got / most - 1.0) for got, most in pairs if math.isfinite(got))
    if not math.isfinite(response.settling_time_s):
        return broken + 1.0, math.inf
    return broken, round(response.settling_time_s / SETTLING_STEP_S) * SETTLING_STEP_S


def search(
    answer: Callable[[Gains], StepResponse], present: Gains, step: float
) -> tuple[Gains, int]:
    """Return better gains than the present ones, or these, and how many were tried.

    A pattern search: the eight neighbours in (P, D), a factor away, are tried; the best one is the
    next centre while it is better, else the factor is made finer. I stays. Nothing is random.

    Args:
        answer: steps the joint with some gains
        present: where to begin
        step: its size [rad or m]
    """
    first = answer(present)
    allowed = bounds(step, first)
    tried = {present: cost(first, allowed)}

    def rate(gains: Gains) -> tuple[float, float]:
        if gains not in tried:
            try:
                tried[gains] = cost(answer(gains), allowed)
            except DivergedError:
                tried[gains] = (math.inf, math.inf)
        return tried[gains]

    best, centre = present, (present.p, present.d or FIRST_LEAD_S * present.p)
    for factor in FACTORS:
        while True:
            found = min(_neighbours((best.p, best.d or centre[1]), centre, present.i, factor),
                        key=rate)  # fmt: skip
            if rate(found) >= tried[best]:
                break
            best = found
    return best, len(tried)


def _neighbours(
    at: tuple[float, float], centre: tuple[float, float], i: float, factor: float
) -> list[Gains]:
    """Return the gains around a point, within reach of the centre, with three digits."""
    found: list[Gains] = []
    for up in (0, -1, 1):
        for damped in (0, 1, -1):
            pair = [
                float(f"{min(max(x * factor**k, c / MOST_FACTOR), c * MOST_FACTOR):.3g}")
                for x, c, k in zip(at, centre, (up, damped), strict=True)
            ]
            found.append(Gains(pair[0], i, pair[1]))
    return found
