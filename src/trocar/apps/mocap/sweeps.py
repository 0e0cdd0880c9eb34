"""How an arm is swept before the cameras: still, then its loops folded, then about its centre."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.mocap.linkage import folding_joints, home
from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError

Array = NDArray[np.float64]

#: The arm stands still at the start for this long, where a calibration finds its home; each
#: sweep grows in and dies out over a ramp. Source: our own choice. [s]
STILL_S, RAMP_S = 2.0, 1.0
#: Periods of a sweep a second, at most. Source: closed-loop paper 4.3, its test trajectory. [Hz]
SWEEP_HZ = 0.1
#: About the remote centre the second joint makes three swings to two of the first.
SWINGS_ABOUT_CENTRE = (1.0, 1.5)
#: A sweep stays this far from the limits, and below this share of a joint's velocity limit.
#: Source: our own choice.
MARGIN_RAD, SPEED_SHARE = 0.01, 0.8
SHORTEST_S = STILL_S + 4.0 * RAMP_S


@dataclass(frozen=True, eq=False)
class Sweep:
    """Where an arm is told to be.

    Attributes:
        q: (n, n_joints) [rad or m]
        parts: {"still" | "axes" | "rcm": (from, to)} [s]
        swings: {part: {joint: amplitude}} [rad]
    """

    q: Array
    parts: dict[str, tuple[float, float]]
    swings: dict[str, dict[str, float]]


def sweep(
    arm: ArmDescription, times: Array, duration_s: float, amplitude: float, parts: tuple[str, ...]
) -> Sweep:
    """Return set-points at given times.

    Args:
        arm: with loops; for the part "rcm" with a remote centre too
        times: (n,), from 0 on [s]
        duration_s: of each part; the still start belongs to the first [s]
        amplitude: of every joint that is swept, less where its range is narrower [rad]
        parts: of "axes" and "rcm", in this order

    Raises:
        InputError: too short, no amplitude, or an arm without a remote centre
    """
    if not SHORTEST_S <= duration_s < math.inf:
        raise InputError(
            f"duration: got {duration_s:g} s; allowed: at least {SHORTEST_S:g} s, of which the arm"
            f" stands still for {STILL_S:g} s"
        )
    if not 0.0 < amplitude <= math.pi:
        raise InputError(f"amplitude: got {amplitude:g} rad; allowed: above 0 to pi")
    folding = folding_joints(arm)
    start = home(arm, folding)
    q = np.tile(start, (len(times), 1))
    spans, swings = {"still": (0.0, STILL_S)}, {}
    begin = STILL_S
    for number, part in enumerate(parts):
        end = (number + 1) * duration_s
        spans[part], swings[part] = (begin, end), {}
        for joint, from_s, length, share in _turns(arm, part, begin, end):
            middle, swing = _range(arm, joint, amplitude)
            name = arm.joints[joint].name
            periods = _periods(arm.joints[joint].velocity_max, length, swing) * share
            phase = 2.0 * np.pi * periods / length * (times - from_s)
            away = middle - start[joint] + swing * np.sin(phase)
            q[:, joint] += _envelope(times - from_s, length) * away
            swings[part][name] = swing
        begin = end
    return Sweep(q, spans, swings)


def has_remote_centre(arm: ArmDescription) -> bool:
    """Tell whether two joints of an arm, of which the second folds its loops, swing about one."""
    folding = folding_joints(arm)
    return "rcm" in arm.mechanism.frame_index and len(folding) == 1 and folding[0] > 0


def _turns(
    arm: ArmDescription, part: str, begin: float, end: float
) -> list[tuple[int, float, float, float]]:
    """Return (joint, from, length, share of swings) of one part: one by one, or all at once."""
    folding = folding_joints(arm)
    if part == "axes":
        length = (end - begin) / len(folding)
        return [(j, begin + n * length, length, 1.0) for n, j in enumerate(folding)]
    if not has_remote_centre(arm):
        raise InputError(
            f'{arm.name}: has no remote centre to swing about; allowed: the part "axes" alone'
        )
    joints = (folding[0] - 1, folding[0])
    return [
        (j, begin, end - begin, s) for j, s in zip(joints, SWINGS_ABOUT_CENTRE, strict=True)
    ]  # fmt: skip


def _range(arm: ArmDescription, joint: int, amplitude: float) -> tuple[float, float]:
    """Return the middle and the amplitude of a swing, about 0 where the range allows it."""
    lower = arm.joints[joint].lower + MARGIN_RAD
    upper = arm.joints[joint].upper - MARGIN_RAD
    swing = min(amplitude, 0.5 * (upper - lower))
    return float(np.clip(0.0, lower + swing, upper - swing)), swing


def _periods(velocity_max: float, length: float, swing: float) -> int:
    """Return how many periods a swing has."""
    frequency = min(SWEEP_HZ, SPEED_SHARE * velocity_max / (2.0 * np.pi * swing) / 1.5)
    return max(1, math.floor(frequency * length + 1e-9))


def _envelope(since: Array, length: float) -> Array:
    """Return what grows from 0 to 1 and dies out to 0 again, smoothly, (n,)."""
    share = np.clip(np.minimum(since, length - since) / RAMP_S, 0.0, 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
