"""The test trajectory of the closed-loop paper, for every arm of a rig but its setup joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.errors import InputError

Array = NDArray[np.float64]

#: Source: closed-loop paper 4.3 (0.1 Hz, 1 rad, 0.1 m); our own choice (middle of the range,
#: insertion 0.12 m, ramp of 1 s, 0.95 of half the range).
FREQUENCY_HZ = 0.1
AMPLITUDE_RAD = 1.0
AMPLITUDE_M = 0.1
SHARE_OF_RANGE = 0.95
INSERTION_MIDDLE_M = 0.12
RAMP_S = 1.0
MOVED = ("PSM", "ECM", "MTM")


@dataclass(frozen=True, eq=False)
class TestTrajectory:
    """Set-points of every moved arm.

    Attributes:
        period: time between rows [s]
        start: {arm: q (n,)}: where the arms stand at time 0
        positions, velocities: {arm: (k, n)}: what is written, valid for one period each
        expected: {arm: (k, n)}: where the arm should be when its period is over
    """

    __test__ = False  # not a pytest class

    period: float
    start: dict[str, Array]
    positions: dict[str, Array]
    velocities: dict[str, Array]
    expected: dict[str, Array]


def paper_sine(
    rig: RigDescription, duration_s: float, period_s: float, begin_s: float = 0.0
) -> TestTrajectory:
    """Return the paper's sine for every arm of a rig but its setup joints.

    A row is held for one period, so it is the set-point of the period's middle: held set-points
    then lag by nothing on average.

    Args:
        rig: the rig; where its arms would meet, its `test_share` scales the amplitude
        duration_s: length [s]
        period_s: time between rows [s]
        begin_s: where on the sine the first row is, for one that is played in pieces [s]

    Raises:
        InputError: the rig has no arm that moves, or the duration is no positive number
    """
    if not np.isfinite(duration_s) or duration_s <= 0.0:
        raise InputError(f"duration: got {duration_s!r}; allowed: above 0 s")
    arms = {a.name: a.arm for a in rig.arms if a.arm.type in MOVED}
    if not arms:
        raise InputError(
            f"rig {rig.name}: has no PSM, ECM or MTM to drive along the test trajectory"
        )
    count = max(1, round(duration_s / period_s))
    begin = begin_s + period_s * np.arange(count, dtype=np.float64)
    middles = {
        name: rig.poses["test"][name] if rig.test_share < 1.0 else middle_of_range(arm)
        for name, arm in arms.items()
    }
    swings = {name: rig.test_share * amplitudes(arm) for name, arm in arms.items()}
    wave, slope = _ramped_sine(np.asarray(begin + 0.5 * period_s))
    after, _ = _ramped_sine(np.asarray(begin + period_s))
    return TestTrajectory(
        period_s,
        middles,
        {name: middles[name] + np.outer(wave, swings[name]) for name in arms},
        {name: np.outer(slope, swings[name]) for name in arms},
        {name: middles[name] + np.outer(after, swings[name]) for name in arms},
    )


def middle_of_range(arm: ArmDescription) -> Array:
    """Return the middle of each joint's range, the insertion at 0.12 m, the jaw shut, (n,).

    A gripper is where its spring has it.
    """
    middle = np.array([0.5 * (j.lower + j.upper) for j in arm.joints])
    for index, joint in enumerate(arm.joints):
        if joint.name == "insertion" and arm.type == "PSM":
            middle[index] = INSERTION_MIDDLE_M
        if joint.name == "jaw":
            middle[index] = 0.0
        if joint.spring is not None:
            middle[index] = np.clip(joint.spring.rest, joint.lower, joint.upper)
    return middle


def amplitudes(arm: ArmDescription) -> Array:
    """Return the amplitude of each joint, none for a jaw or a gripper, (n,) [rad or m]."""
    found: list[float] = []
    for index, joint in enumerate(arm.joints):
        most = AMPLITUDE_RAD if joint.kind == "revolute" else AMPLITUDE_M
        half = 0.5 * (joint.upper - joint.lower)
        found.append(min(most, SHARE_OF_RANGE * half) if index < arm.own_joints else 0.0)
    return np.array(found)


def _ramped_sine(time: Array) -> tuple[Array, Array]:
    """Return a sine that grows in over the ramp, and its derivative, (k,) each."""
    share = np.clip(time / RAMP_S, 0.0, 1.0)
    ramp = share**2 * (3.0 - 2.0 * share)
    growth = np.where(time < RAMP_S, 6.0 * share * (1.0 - share) / RAMP_S, 0.0)
    omega = 2.0 * np.pi * FREQUENCY_HZ
    wave = np.sin(omega * time)
    return ramp * wave, growth * wave + ramp * omega * np.cos(omega * time)
