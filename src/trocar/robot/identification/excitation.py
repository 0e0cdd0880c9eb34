"""Trajectories that excite an arm's dynamics: Fourier series within the joints' limits."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError
from trocar.robot.identification.drivetrains import structure, weights
from trocar.robot.identification.fit import Compressed, base_condition
from trocar.robot.identification.regression import EffortModel, moving_bodies
from trocar.robot.identification.rigid_body import UPRIGHT, JointMotion
from trocar.robot.recordings import recorded_joints

Array = NDArray[np.float64]

#: Harmonics of the base frequency. Source: Swevers et al. 1997, Optimal robot excitation and
#: identification: five.
HARMONICS = 5
#: Amplitudes of the harmonics k fall as 1 / k^DECAY. Source: our own choice; accelerations of all
#: harmonics are alike then. With 1 / k the fifth takes up the limit of acceleration: an ECM's slide
#: would move by 9 % of its range, less than its stop elements slip, and condition numbers would be
#: 1.1 to 3.5 times as large (60 candidates; PSM and ECM, Classic and Si, and MTMR).
DECAY = 2
#: Ratio of each joint's range and velocity limit that is used. Source: our own choice.
USED = 0.8
#: Shortest fade to rest at either end, and the step by which it grows until velocities keep their
#: limits [s]. Source: our own choice.
FADE_S, LONGER_S = 1.0, 0.5
#: Samples of a period at which a candidate is judged. Source: our own choice.
JUDGED = 100
#: Ratio of pivots below which a parameter has no effect whatever the motion. Source: our own
#: choice; rounding leaves 1e-15, the weakest effects are 1e-5.
STRUCTURAL = 1e-8


@dataclass(frozen=True, eq=False)
class Excitation:
    """A periodic trajectory that begins and ends at rest.

    Attributes:
        joints: their names
        rate_hz: samples a second [Hz]
        q, qd: (k, n) [rad or m, per s]
        condition: condition number of the base parameters' regressor, columns scaled to length 1
        first_condition: that of the first candidate
        base_parameters: how many the arm has
    """

    joints: tuple[str, ...]
    rate_hz: float
    q: Array
    qd: Array
    condition: float
    first_condition: float
    base_parameters: int


def excite(
    arm: ArmDescription,
    period_s: float = 10.0,
    repeats: int = 3,
    rate_hz: float = 200.0,
    candidates: int = 100,
    seed: int = 0,
    watch: Callable[[int, int], None] = lambda _done, _all: None,
    up: Array = UPRIGHT,
) -> Excitation:
    """Search a trajectory whose motions determine the base parameters well.

    Fourier series per joint (Source: Swevers et al. 1997); random series, the best of which is then
    varied by ever smaller steps. One that slips the stop elements of more drivetrains both ways is
    better, then one of a smaller condition number. Positions and velocities stay within 80 % of the
    limits, masters' grippers, jaws and actuators that several joints move included. The first and
    last second of the whole are faded to rest, or up to half of it each, as velocities may not pass
    the limits.

    Args:
        arm: the arm with its tool
        period_s: of the series [s]
        repeats: periods
        rate_hz: of the samples [Hz]
        candidates: trajectories that are judged
        seed: of the random numbers
        watch: called with (candidates done, candidates)
        up: direction against gravity in the arm's reference frame, (3,)

    Raises:
        InputError: a setting, or an arm without masses
    """
    if not (period_s >= 2.0 and repeats >= 1 and rate_hz > 0.0 and candidates >= 1):
        raise InputError(
            f"excite: got period {period_s:g} s, {repeats} repeats, {rate_hz:g} Hz, {candidates}"
            " candidates; allowed: 2 s or more, 1 or more, more than 0, 1 or more"
        )
    joints = recorded_joints(arm)
    count = len(joints)
    model = EffortModel(arm, moving_bodies(arm, joints), structure(arm))
    rng = np.random.default_rng(seed)
    best = _random(rng, count)
    condition, rank, slipping = _judge(model, best, period_s, up)
    first = condition
    for number in range(1, candidates):
        watch(number, candidates)
        if number < candidates // 2:
            trial = _random(rng, count)
        else:
            step = 0.5 * (1.0 - number / candidates)
            trial = best + step * _random(rng, count)
        value, excited, slips = _judge(model, trial, period_s, up)
        if (excited, slips, -value) > (rank, slipping, -condition):
            best, condition, rank, slipping = trial, value, excited, slips
    time = np.arange(round(repeats * period_s * rate_hz) + 1) / rate_hz
    q, qd = _faded(model.arm, best, time, period_s)
    return Excitation(joints, rate_hz, q, qd, condition, first, rank)


def trajectory_csv(excitation: Excitation) -> str:
    """Return a trajectory as CSV: time, JOINT_position, JOINT_velocity (SI units)."""
    head = [
        "time",
        *(f"{joint}_position" for joint in excitation.joints),
        *(f"{joint}_velocity" for joint in excitation.joints),
    ]
    time = np.arange(len(excitation.q)) / excitation.rate_hz
    text = io.StringIO()
    np.savetxt(
        text,
        np.column_stack([time, excitation.q, excitation.qd]),
        fmt="%.9g",
        delimiter=",",
        header=",".join(head),
        comments="",
    )
    return text.getvalue()


def _random(rng: np.random.Generator, count: int) -> Array:
    """Return sine and cosine coefficients, (2, HARMONICS, count); high harmonics are smaller."""
    return rng.normal(size=(2, HARMONICS, count)) / np.arange(1, HARMONICS + 1)[:, None] ** DECAY


def _series(
    arm: ArmDescription, series: Array, time: Array, period_s: float
) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations of a series scaled into the limits."""
    count = series.shape[2]
    lower, upper = arm.mechanism.lower[:count], arm.mechanism.upper[:count]
    stops: Array = np.array([[j.stop_lower, j.stop_upper] for j in arm.joints[:count]])
    lower = np.where(np.isfinite(stops[:, 0]), np.maximum(lower, stops[:, 0]), lower)
    upper = np.where(np.isfinite(stops[:, 1]), np.minimum(upper, stops[:, 1]), upper)
    speed = np.array([joint.velocity_max for joint in arm.joints[:count]])
    growth = np.array([joint.acceleration_max for joint in arm.joints[:count]])
    dense = np.linspace(0.0, period_s, 40 * HARMONICS, endpoint=False)
    shapes = [_derivative(series, dense, period_s, order) for order in range(3)]
    reach = np.maximum(np.abs(shapes[0]).max(axis=0), 1e-12)
    scale: Array = USED * np.minimum.reduce(
        [
            0.5 * (upper - lower) / reach,
            speed / np.abs(shapes[1]).max(axis=0),
            growth / np.abs(shapes[2]).max(axis=0),
        ]
    )
    middle = 0.5 * (lower + upper)
    mechanism = arm.mechanism
    for frame, ratios in zip(mechanism.frames, mechanism.ratios[:, :count], strict=True):
        at, far = float(ratios @ middle), float(np.abs(shapes[0] @ (scale * ratios)).max())
        room = USED * min(frame.upper - at, at - frame.lower)
        scale = np.where(ratios * far != 0.0, min(1.0, room / max(far, 1e-12)) * scale, scale)
    q, qd, qdd = (scale * _derivative(series, time, period_s, order) for order in range(3))
    return q + middle, qd, qdd


def _derivative(series: Array, time: Array, period_s: float, order: int) -> Array:
    """Return a derivative of a Fourier series, (k, n)."""
    rates = 2.0 * np.pi / period_s * np.arange(1, HARMONICS + 1)
    angles = np.outer(time, rates) + 0.5 * np.pi * order
    return (np.sin(angles) * rates**order) @ series[0] + (np.cos(angles) * rates**order) @ series[1]


def _faded(arm: ArmDescription, series: Array, time: Array, period_s: float) -> tuple[Array, Array]:
    """Return positions and velocities that begin and end at rest in the middle of the ranges."""
    q, qd, _ = _series(arm, series, time, period_s)
    apart = q - _middle(arm, series, period_s)
    most = np.array([joint.velocity_max for joint in arm.joints[: q.shape[1]]])
    from_end = np.minimum(time, time[-1] - time)[:, None]
    side = np.where(time < 0.5 * time[-1], 1.0, -1.0)[:, None]
    fade_s = FADE_S
    while True:
        x = np.clip(from_end / fade_s, 0.0, 1.0)
        fade = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        rate = np.where(x < 1.0, 30.0 * x**2 * (1.0 - x) ** 2, 0.0) * side / fade_s
        speed = fade * qd + rate * apart
        fade_s += LONGER_S
        if (np.abs(speed) <= most).all() or fade_s > 0.5 * time[-1]:
            return q + (fade - 1.0) * apart, speed


def _middle(arm: ArmDescription, series: Array, period_s: float) -> Array:
    period = np.linspace(0.0, period_s, 40 * HARMONICS, endpoint=False)
    return _series(arm, series, period, period_s)[0].mean(axis=0)


def _judge(model: EffortModel, series: Array, period_s: float, up: Array) -> tuple[float, int, int]:
    """Judge a series.

    Returns:
        the condition number, and the numbers of base parameters that the series excites and of
        drivetrains whose stop elements all slip both ways
    """
    time = np.linspace(0.0, period_s, JUDGED, endpoint=False)
    parts = _series(model.arm, series, time, period_s)
    count = series.shape[2]
    rest = len(model.arm.joints) - count
    home = np.tile(model.arm.poses["home"][count:] if rest else np.zeros(0), (len(time), 1))
    still = np.zeros((len(time), rest))
    q, qd, qdd = (
        np.hstack([one, more]) for one, more in zip(parts, (home, still, still), strict=True)
    )
    matrix, _ = model.regressor(JointMotion(q, qd, qdd, up=up))
    inertial = matrix[:, :count, : 10 * len(model.frames)]
    # as large as the effort limits let it be
    limits = np.array([joint.effort_max for joint in model.arm.joints[:count]])
    rows = (inertial / limits[:, None]).reshape(-1, inertial.shape[-1])
    condition, rank = base_condition(Compressed.of(rows, np.zeros(len(rows)), 1.0), STRUCTURAL)
    slipping = sum(
        float(np.ptp(q @ weights(train, model.arm))) > 2.0 * max(train.stop_limits, default=0.0)
        for train in model.trains.values()
    )
    return condition, rank, slipping
