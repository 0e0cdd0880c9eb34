"""Scores of a task as the field defines them: motion, forces, and time with errors.

All take arrays over time; `score_recording` reads them from a recording, arm by arm.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import butter, sosfiltfilt  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.descriptions import ArmDescription, RigDescription, load_rig
from trocar.descriptions.mounting import rig_with_tool
from trocar.errors import InputError, LogError, UnknownNameError
from trocar.kinematics.chain_pose import chain_pose
from trocar.recording import Recorded, open_recording

Array = NDArray[np.float64]

#: Cut-off frequency of `low_pass`. Source: the band of SPARC, Balasubramanian et al., J.
#: NeuroEngineering and Rehabilitation 12:112, 2015 (10 Hz hold voluntary arm movements). [Hz]
CUTOFF_HZ = 10.0
#: Order of the Butterworth filter that runs forwards and backwards. Source: our own choice.
ORDER = 2
#: Largest difference of two time steps, over their mean. Source: our own choice, rounding.
UNEVEN = 1e-3
#: Time between the samples of a recording that are scored. Source: our own choice; twenty times
#: faster than `CUTOFF_HZ`. [s]
SAMPLE_S = 0.005
#: Largest extent of the path of an arm that rests, and is left out unless it is named. Source: our
#: own choice. [m]
RESTS_M = 1e-3
#: Time after which a peg transfer scores nothing. Source: as `fls_score`. [s]
PEG_TRANSFER_S = 300.0


@dataclass(frozen=True)
class MotionScore:
    """Scores of one movement of a point.

    Attributes:
        time_s: duration [s]
        path_length_m: length of the path [m]
        economy: shortest path over the path, 0 to 1; NaN for a point at rest
        smoothness: log dimensionless jerk, negative, larger is smoother; NaN for a point at rest
        speed_max_m_s: peak speed [m/s]
    """

    time_s: float
    path_length_m: float
    economy: float
    smoothness: float
    speed_max_m_s: float


@dataclass(frozen=True)
class ForceScore:
    """Scores of a force over time.

    Source: Trejos et al., Surgical Endoscopy 28(7), 2014 (peak, mean and integral of the force
    separate novices from experts).

    Attributes:
        peak, mean: of its magnitude [N]
        impulse: its time integral [N s]
    """

    peak: float
    mean: float
    impulse: float


def score_motion(
    time: ArrayLike, positions: ArrayLike, stations: ArrayLike | None = None
) -> MotionScore:
    """Return all scores of a movement.

    Args:
        time: evenly spaced, (k,) [s]
        positions: of the tool tip, in a frame at rest, (k, 3) [m]
        stations: points that the task prescribes in their order, (m, 3) [m]; see `economy`

    Raises:
        InputError: shapes, numbers or times that are not allowed
    """
    t, p = _checked(time, positions)
    speeds = np.linalg.norm(np.diff(p, axis=0), axis=1) / np.diff(t)
    return MotionScore(
        float(t[-1] - t[0]),
        path_length(p),
        economy(p, stations),
        log_dimensionless_jerk(t, p),
        float(speeds.max()),
    )


def path_length(positions: ArrayLike) -> float:
    """Return the length of a path through positions, (k, 3) [m]."""
    p = _points("positions", positions)
    return float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum())


def economy(positions: ArrayLike, stations: ArrayLike | None = None) -> float:
    """Return the economy of motion: length of the shortest path over that of the path.

    1 for a straight line. Source: path length as Cotin et al., MICCAI 2002; its ratio is the
    straightness index, Batschelet, Circular Statistics in Biology, 1981. Some simulators call the
    path length itself economy of motion.

    Args:
        positions: path of the tool tip, (k, 3) [m]
        stations: points that the shortest path visits in their order between the first and the
            last position, such as the pegs of a transfer, (m, 3) [m]; none when omitted

    Returns:
        0 to 1, above 1 where the path misses stations; NaN for a point at rest
    """
    p = _points("positions", positions)
    between = np.zeros((0, 3)) if stations is None else _points("stations", stations)
    length = path_length(p)
    shortest = path_length(np.concatenate([p[:1], between, p[-1:]]))
    return shortest / length if length > 0.0 else math.nan


def log_dimensionless_jerk(time: ArrayLike, positions: ArrayLike) -> float:
    """Return the smoothness of a movement, -ln(T^3 / v_max^2 * integral |d3p/dt3|^2 dt).

    It depends neither on duration nor on size or direction; larger (nearer to 0) is smoother. A
    straight minimum-jerk reach, the smoothest, has -ln(204.8) = -5.32. Third differences amplify
    noise: apply `low_pass` to measured positions first.

    Source: Hogan and Sternad, J. Motor Behavior 41(6), 2009 (dimensionless jerk); Balasubramanian
    et al., J. NeuroEngineering and Rehabilitation 12:112, 2015 (peak speed, logarithm; of positions
    in space the norm of the jerk vector).

    Args:
        time: evenly spaced, (k,) [s]
        positions: (k, 3) [m]

    Returns:
        the logarithm; NaN for a point at rest, infinity at constant velocity

    Raises:
        InputError: shapes, numbers or times that are not allowed
    """
    t, p = _checked(time, positions)
    period = (t[-1] - t[0]) / (len(t) - 1)
    speed = float((np.linalg.norm(np.diff(p, axis=0), axis=1) / period).max())
    if speed == 0.0:
        return math.nan
    squares = (np.diff(p, 3, axis=0) ** 2).sum(axis=1) / period**6
    # Each is the jerk in the middle of four samples; the outermost hold on to the ends.
    integral = period * (squares.sum() + squares[0] + squares[-1])
    jerk = (t[-1] - t[0]) ** 3 / speed**2 * integral
    return -math.log(jerk) if jerk > 0.0 else math.inf


def low_pass(time: ArrayLike, positions: ArrayLike, cutoff_hz: float = CUTOFF_HZ) -> Array:
    """Return positions without noise above a frequency and without delay, (k, 3) [m].

    A Butterworth filter that runs forwards and backwards.

    Args:
        time: evenly spaced, (k,) [s]
        positions: (k, 3) [m]
        cutoff_hz: of the filter [Hz]

    Raises:
        InputError: shapes, numbers or times that are not allowed, or too few samples
    """
    t, p = _checked(time, positions)
    rate = (len(t) - 1) / (t[-1] - t[0])
    if rate <= 2.0 * cutoff_hz:
        return p  # nothing is above
    sections = cast(Array, butter(ORDER, cutoff_hz, fs=rate, output="sos"))
    most = min(len(p) - 1, round(3.0 * rate / cutoff_hz))
    return np.asarray(sosfiltfilt(sections, p, axis=0, padlen=most), np.float64)


def score_forces(time: ArrayLike, forces: ArrayLike) -> ForceScore:
    """Return the scores of a force.

    Args:
        time: (k,) [s]
        forces: contact forces of a tool, (k, 3) [N]

    Raises:
        InputError: shapes, numbers or times that are not allowed
    """
    f = _points("forces", forces)
    t = _times(time, len(f))
    magnitude = np.linalg.norm(f, axis=1)
    impulse = float(np.trapezoid(magnitude, t))
    return ForceScore(float(magnitude.max()), impulse / float(t[-1] - t[0]), impulse)


def fls_score(
    time_s: float, objects: int, drops: int = 0, wrong: int = 0, cutoff_s: float = PEG_TRANSFER_S
) -> float:
    """Return a score like those of the Fundamentals of Laparoscopic Surgery, in points.

    max(0, cut-off time - time - penalty), a point a second, where the penalty is the percentage of
    objects that were lost. Source: MISTELS, of which FLS came: Derossis et al., American Journal of
    Surgery 175(6), 1998; Fraser et al., Surgical Endoscopy 17(6), 2003. FLS normalises this by
    constants that are not published. Counting an object on a wrong peg as lost is our own choice.

    Args:
        time_s: until the task was complete [s]
        objects: number of objects to transfer
        drops: objects dropped
        wrong: objects left on a wrong peg, or not transferred
        cutoff_s: time after which nothing is scored [s]

    Raises:
        InputError: a time, a count or a cut-off time that is not allowed
    """
    if not time_s >= 0.0 or not 0.0 < cutoff_s < math.inf:
        raise InputError(
            f"got a time of {time_s:g} s and a cut-off of {cutoff_s:g} s; allowed: 0 or more, and"
            " above 0"
        )
    if objects < 1 or drops < 0 or wrong < 0:
        raise InputError(
            f"got {objects} objects, {drops} drops, {wrong} wrong; allowed: 1 or more objects, 0 or"
            " more of the others"
        )
    return max(0.0, cutoff_s - time_s - 100.0 * (drops + wrong) / objects)


@dataclass(frozen=True)
class ArmScore:
    """Scores of an arm in a recording.

    Attributes:
        motion: of its tip in the arm's reference frame, after `low_pass`
        jaw_effort_max: largest effort of its jaw; None without one [N m]
        events: how often each event of the arm happened, {"jaw/drop": 1}
    """

    motion: MotionScore
    jaw_effort_max: float | None
    events: Mapping[str, int]


@dataclass(frozen=True)
class RecordingScore:
    """Scores of a recording.

    Attributes:
        file: the recording
        start_s, end_s: the scored interval, simulated time since the recording's reference [s]
        arms: {name: scores}
        problem: why the recording ends early, "" where it is whole
    """

    file: str
    start_s: float
    end_s: float
    arms: Mapping[str, ArmScore]
    problem: str


def score_recording(
    file: str | Path,
    arm: str | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    rig: RigDescription | str | Path | None = None,
) -> RecordingScore:
    """Return the scores of the arms in a recording.

    Args:
        file: a recording (`trocar sim --record`)
        arm: this arm alone; every arm whose tip moved when omitted
        start_s, end_s: interval to score, simulated time [s]; the whole recording when omitted
        rig: the recorded rig, if it is no longer found under the recorded name or path

    Raises:
        LogError: no recording, or one of a rig that is not found
        UnknownNameError: no such arm
        InputError: an interval outside the recording
    """
    recorded = open_recording(file)
    if arm is not None and arm not in recorded.arms:
        raise UnknownNameError("arm", arm, recorded.arms, recorded.file)
    first = recorded.start if start_s is None else start_s
    last = recorded.end if end_s is None else end_s
    if not recorded.start <= first < last <= recorded.end:
        raise InputError(
            f"{file}: got the interval {first:g} to {last:g} s; allowed: a part of"
            f" {recorded.start:g} to {recorded.end:g} s"
        )
    tools = _tools(recorded, rig)
    every = max(1, round(SAMPLE_S / recorded.timestep))
    found: dict[str, ArmScore] = {}
    for name in recorded.arms if arm is None else (arm,):
        columns = recorded.columns(name)
        if columns is None:
            continue
        states = recorded.states(columns, every)
        inside = (states.time >= first) & (states.time <= last)
        time, q = states.time[inside], states.position[inside]
        tips = _tips(tools[name], time, q)
        if arm is None and np.ptp(tips, axis=0).max() <= RESTS_M:
            continue
        entries = [e for e in recorded.entries if e.kind == "event" and e.source == name]
        found[name] = ArmScore(
            score_motion(time, low_pass(time, tips)),
            float(np.abs(states.effort[inside, -1]).max()) if states.arm.jaw else None,
            dict(Counter(e.name for e in entries if first <= e.time <= last)),
        )
    return RecordingScore(recorded.file, first, last, found, recorded.problem)


def score_tip(
    time: ArrayLike,
    positions: ArrayLike,
    start_s: float | None = None,
    end_s: float | None = None,
) -> ArmScore:
    """Return the scores of a tip that was recorded alone.

    Args:
        time: evenly spaced, (k,) [s]
        positions: in a frame at rest, (k, 3) [m]
        start_s, end_s: interval to score, of the same times [s]; all of it when omitted

    Raises:
        InputError: shapes, numbers, times or an interval that are not allowed
    """
    t, p = _checked(time, positions)
    first = t[0] if start_s is None else start_s
    last = t[-1] if end_s is None else end_s
    if not t[0] <= first < last <= t[-1]:
        raise InputError(
            f"got the interval {first:g} to {last:g} s; allowed: a part of {t[0]:g} to {t[-1]:g} s"
        )
    inside = (t >= first) & (t <= last)
    t, p = t[inside], p[inside]
    return ArmScore(score_motion(t, low_pass(t, p)), None, {})


def _tools(
    recorded: Recorded, rig: RigDescription | str | Path | None
) -> dict[str, list[tuple[float, ArmDescription]]]:
    """Return each arm's descriptions over time, {arm: [(beginning, description), ...]}."""
    about, file = recorded.about, recorded.file
    source = about["rig_source"] if rig is None else rig
    if isinstance(source, str) and not source:
        raise LogError(
            file, f"its rig {about['rig']!r} was built in Python, not read from a file; pass it"
        )
    now = source
    if not isinstance(now, RigDescription):
        now = load_rig(now, recorded.overlays() or None)
    found = {a.name: [(-math.inf, a.arm)] for a in now.arms}
    for entry in (*recorded.past, *recorded.entries):
        if entry.kind == "command" and entry.name == "exchange_tool":
            name = str(entry.values["name"])
            try:
                now = rig_with_tool(now, name, str(entry.values["tool"]))
            except InputError:
                continue  # the world rejected it, too
            found[name].append((entry.time, now.arm(name).arm))
    return found


def _tips(arms: list[tuple[float, ArmDescription]], time: Array, q: Array) -> Array:
    """Return the tip in the arm's reference frame, by the description of each time, (k, 3) [m]."""
    tips = np.zeros((len(time), 3))
    for since, arm in arms:
        rows = time >= since
        if rows.any() and len(arm.mechanism.joint_names) == q.shape[1]:
            tips[rows] = chain_pose(arm.mechanism)(q[rows])[:, :3, 3]
    return tips


def _checked(time: ArrayLike, positions: ArrayLike) -> tuple[Array, Array]:
    p = _points("positions", positions)
    t = _times(time, len(p))
    if len(t) < 4:
        raise InputError(f"positions: got {len(t)} samples; allowed: 4 or more")
    steps = np.diff(t)
    if np.ptp(steps) > UNEVEN * steps.mean():
        raise InputError(
            f"time: got steps of {steps.min():g} to {steps.max():g} s; allowed: evenly spaced"
        )
    return t, p


def _times(time: ArrayLike, count: int) -> Array:
    t = np.asarray(time, np.float64)
    if t.shape != (count,) or count < 2 or not np.isfinite(t).all() or (np.diff(t) <= 0.0).any():
        raise InputError(
            f"time: got an array of shape {t.shape}; allowed: {max(count, 2)} finite rising numbers"
        )
    return t


def _points(name: str, values: ArrayLike) -> Array:
    p = np.asarray(values, np.float64)
    if p.ndim != 2 or p.shape[1] != 3 or not np.isfinite(p).all():
        raise InputError(f"{name}: got shape {p.shape}; allowed: finite numbers, (k, 3)")
    return p
