"""Logs of joint positions, velocities and efforts, and their zero-phase filters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay_records import FilterSettings
from trocar.errors import InputError, LogError, TrocarError
from trocar.recording import Recorded, is_recording, open_recording
from trocar.robot.identification.episodes import episode_arms, episode_rows, is_episode
from trocar.robot.identification.rigid_body import UPRIGHT, JointMotion
from trocar.robot.recordings import ReadSettings, read_arm_motion, recorded_joints
from trocar.robot.recordings.arm_motion import ArmMotion, check_rows, derivative
from trocar.robot.recordings.motor_side import MOTOR_SIDE, actuators_of_recording
from trocar.robot.recordings.read import recording_kind
from trocar.robot.standing import standing_arm

Array = NDArray[np.float64]

#: Least length of a log [s]. Source: our own choice, 1 s beyond both cut ends.
SHORTEST_S = 3.0
#: Time cut at both ends, where filters settle [s]. Source:
#: dvrk_dynamics_identification, 200 samples at 200 Hz.
CUT_S = 1.0
#: Highest rate to which motions with times are resampled, and rate above which they are [Hz].
#: Source: the published logs have 200 Hz; ten times the cut-off of the filters.
USUAL_HZ, FAST_HZ = 200.0, 250.0
#: Cut-off of the zero-phase filter ahead of fewer samples a second, as a ratio of their rate. A
#: set-point that is held makes a saw of the efforts, whose harmonics fold onto constant ones where
#: samples are in step with it. Source: our own choice; of what has the rate of the samples, 1e-5 is
#: left, and of what is compared behind 17 Hz nothing is lost.
KEPT = 0.4
#: Longest gap that is filled in, in usual steps; longer ones end a piece. Source: our own choice,
#: 25 ms at 200 Hz, within which the filters leave nothing.
LOST_STEPS = 5.0
#: Slope of velocities against the derivative of positions. Source: our own choice; recorded
#: velocities are up to 17 % too large, a wrong unit is a factor of 57 or 1000.
SLOPES = (0.5, 2.0)
#: Least correlation of velocities with the derivative of positions. Source: our own choice;
#: recorded ones correlate by 0.8 or more, swapped columns by chance.
CORRELATION = 0.6
#: Motion below which a joint stands still, as a ratio of its range. Source: our own choice.
STILL = 1e-3
#: Cut-off of filters, and of what velocities are compared by, as a ratio of the rate of a log that
#: is too slow for the usual cut-off. Source: our own choice, 2 Hz for a log of 10 Hz.
SLOW_CUTOFF = 0.2
#: Columns of a file of poses at rest: positions and efforts of an arm's first three joints. Source:
#: dvrk_python@a1b337b scripts/dvrk_ecm_psm_gc_collect.py.
POSE_JOINTS = 3
#: Least number of poses at rest. Source: our own choice; three joints have twelve combinations of
#: masses in their weight at most, three numbers a pose.
FEWEST_POSES = 6
#: Largest ratio of samples at the effort limit, and at the largest effort in the log, which a lower
#: limit of one's own may set. Source: our own choice.
SATURATED = 0.02


@dataclass(frozen=True, eq=False)
class Log:
    """Samples at even times, in the arm's public joints.

    Attributes:
        file: its path, as given
        rate_hz: samples a second [Hz]
        q, qd, effort: (k, n) [rad or m, per s, N m or N]; n joints of `recorded_joints`
        columns: names of the efforts as they are compared: joints, or motors where the log has them
        joint_from_column: q = joint_from_column @ column positions, (n, n)
        simulated: whether positions and velocities have no noise, so that they are not filtered
        up: direction against gravity in the arm's reference frame, (3,)
        poses: whether samples are poses at rest, which no time connects
        starts: samples at which an uninterrupted piece begins; each is filtered by itself
        understood: what was read and used, in words
    """

    file: str
    rate_hz: float
    q: Array
    qd: Array
    effort: Array
    columns: tuple[str, ...]
    joint_from_column: Array
    simulated: bool = False
    up: Array = field(default_factory=lambda: UPRIGHT)
    poses: bool = False
    starts: tuple[int, ...] = (0,)
    understood: str = ""

    def by_piece(self, values: Array, change: Callable[[Array], Array]) -> Array:
        """Return samples, (k, ...), of which each piece is changed by itself."""
        return np.concatenate([change(one) for one in np.split(values, self.starts[1:])])

    @property
    def silent(self) -> tuple[str, ...]:
        """Columns without recorded efforts: zero throughout."""
        size = np.abs(self.effort @ self.joint_from_column).max(axis=0)
        return tuple(name for name, most in zip(self.columns, size, strict=True) if not most)

    def still(self, arm: ArmDescription) -> tuple[str, ...]:
        """Return the columns that do not move."""
        column_from_joint = cast("Array", np.linalg.inv(self.joint_from_column))
        return self._still(arm, column_from_joint, self.columns)

    def still_joints(self, arm: ArmDescription) -> tuple[str, ...]:
        """Return the joints that do not move."""
        names = arm.mechanism.joint_names[: self.q.shape[1]]
        return self._still(arm, np.eye(len(names)), names)

    def _still(self, arm: ArmDescription, matrix: Array, names: tuple[str, ...]) -> tuple[str, ...]:
        span = (arm.mechanism.upper - arm.mechanism.lower)[: self.q.shape[1]]
        still = np.ptp(self.q @ matrix.T, axis=0) < STILL * (np.abs(matrix) @ span)
        return tuple(name for name, one in zip(names, still, strict=True) if one)


@dataclass(frozen=True, eq=False)
class FilteredLog:
    """A filtered log of all joints of an arm; its ends are not cut yet.

    Attributes:
        log: where it is from
        settings: of the filters
        motion: filtered unless it is simulated, (k, n_joints); joints that the log lacks rest
        effort: filtered, in the log's columns, (k, n) [N m or N]
    """

    log: Log
    settings: FilterSettings
    motion: JointMotion
    effort: Array

    def smooth(self, values: Array) -> Array:
        """Return predictions, (k, ...), filtered as the efforts are, with the ends cut."""
        if self.log.poses:
            return values
        cutoff_hz, rate_hz = self.settings.cutoff_hz, self.log.rate_hz
        return self.cut(
            self.log.by_piece(values, lambda v: low_pass(v, cutoff_hz, rate_hz, self.settings))
        )

    def cut(self, values: Array) -> Array:
        """Return samples, (k, ...), without those at both ends of a piece; all poses at rest."""
        if self.log.poses:
            return values
        ends = round(CUT_S * self.log.rate_hz)
        return self.log.by_piece(values, lambda v: v[ends:-ends])


def default_filters(arm: ArmDescription) -> FilterSettings:
    """Return the filters for the logs of an arm.

    Source: identified on recordings of a PSM and an MTM (docs/dynamics.md). The cut-offs are those
    that the published work used in effect: 5.4 and 1.8 rad/s-as-ratio of 200 Hz. Encoders of a
    PSM's first two joints see vibration of the structure at 10 to 15 Hz that its efforts do not.
    """
    names = arm.mechanism.joint_names
    if arm.type == "MTM":
        return FilterSettings(cutoff_hz=5.65, differentiated=names[4:7])
    second = {names[0]: 5.0, names[1]: 5.0} if arm.type == "PSM" else {}
    return FilterSettings(cutoff_hz=16.96, acceleration_cutoff_hz=second)


def slowed(settings: FilterSettings, rate_hz: float) -> FilterSettings:
    """Return filters with cut-offs that a log of a low rate has room for."""
    most = SLOW_CUTOFF * rate_hz
    highest = max(settings.cutoff_hz, *settings.acceleration_cutoff_hz.values(), 0.0)
    if highest < 0.5 * rate_hz:
        return settings
    second = {name: min(most, value) for name, value in settings.acceleration_cutoff_hz.items()}
    return replace(settings, cutoff_hz=min(most, settings.cutoff_hz), acceleration_cutoff_hz=second)


def log_kind(
    path: str | Path,
) -> Literal["recording", "bag", "episode", "table", "poses", "rows"]:
    """Determine the kind of a log.

    Returns:
        a recording, a bag, an episode of a public dataset, or CSV: a table with a header, poses at
        rest, or rows of numbers
    """
    if not is_recording(path) and is_episode(path):
        if Path(path).expanduser().is_dir():
            return "episode"
        try:
            episode_arms(path)
        except LogError:  # other columns: whatever they are called
            return "table"
        return "episode"
    kind = recording_kind(path)
    return "poses" if kind == "rows" and _has_poses(path) else kind


def read_motion(
    path: str | Path,
    arm: ArmDescription,
    reading: ReadSettings | None = None,
    *,
    up: Array | None = None,
    name: str = "",
) -> Log:
    """Read a log of one arm.

    Args:
        path: as for `read_arm_motion`; CSV of poses at rest: positions and efforts of the first
            three joints, as dvrk_python's script for gravity compensation writes it; a recording of
            trocar's own; or an episode of SurgSync or Open-H. A joint of the wrist or a jaw that a
            table lacks rests without efforts
        arm: the recorded arm, with the tool that was mounted
        reading: how to read it; a motion with times is read at its own rate, at 200 Hz where that
            is above 250 Hz, or at `rate_hz`
        up: direction against gravity in the arm's reference frame, (3,); None: as a recording of
            trocar's own has it, upright of other logs
        name: of the arm, in a recording or an episode of several

    Raises:
        LogError: no log of this arm, too short, or columns that cannot be what they are called
        InputError: the rate
    """
    how = reading or ReadSettings()
    file, joints, stands = str(path), recorded_joints(arm), UPRIGHT if up is None else up
    kind = log_kind(path)
    if how.columns and kind in ("episode", "poses"):
        kind = "table"
    columns, matrix, starts, understood = joints, np.eye(len(joints)), (0,), ""
    if kind == "poses":
        rows = _pose_rows(path, arm)
        check_rows(file, np.arange(1, len(rows) + 1), rows, arm)
        return Log(file, USUAL_HZ, *_parts(rows), columns, matrix, up=stands, poses=True)
    if kind == "recording":
        rows, rate_hz, recorded_up = _own_rows(file, arm, name or how.of or "")
        stands = recorded_up if up is None else up
    elif kind == "episode":
        rows, rate_hz = episode_rows(path, arm, name or how.of or "")
    else:
        motion = read_arm_motion(path, arm, how, partial=True)
        if not motion.has_efforts:
            raise LogError(file, "contains no efforts; allowed: recorded efforts")
        rows, rate_hz, starts, understood = _even_rows(motion, how.rate_hz)
        if kind == "rows" and not how.columns and how.wrist == "motor" and arm.type in MOTOR_SIDE:
            which, coupling = actuators_of_recording(arm)
            matrix[np.ix_(which, which)] = coupling.actuator_to_joint
            columns = tuple(
                f"motor_{k + 1}" if k in which else name for k, name in enumerate(joints)
            )
    check_rows(file, np.arange(1, len(rows) + 1), rows, arm)
    if len(rows) < SHORTEST_S * rate_hz:
        raise LogError(
            file, f"lasts {len(rows) / rate_hz:.3g} s; allowed: {SHORTEST_S:g} s or more"
        )
    log = Log(
        file, rate_hz, *_parts(rows), columns, matrix, kind == "recording", stands,
        starts=starts, understood=understood,
    )  # fmt: skip
    _check_columns(log, arm)
    return log


def _parts(rows: Array) -> tuple[Array, Array, Array]:
    """Return the positions, velocities and efforts of rows (k, 3, n)."""
    q, qd, effort = (np.ascontiguousarray(rows[:, k]) for k in range(3))
    return q, qd, effort


def _even_rows(
    motion: ArmMotion, rate_hz: float | None
) -> tuple[Array, float, tuple[int, ...], str]:
    """Return a motion's pieces at even times.

    Returns:
        rows (k, 3, n), their rate [Hz], the rows at which a piece begins, and what was used
    """
    own = motion.rate_hz
    rate = own
    if motion.timed:
        rate = rate_hz or (USUAL_HZ if own > FAST_HZ else own)
    cut = [one for piece in motion.pieces() for one in piece.cut_at(LOST_STEPS / own).pieces()]
    even = [_resampled(one, own, rate) for one in cut if len(one.times) > 1]
    long = [rows for rows in even if len(rows) >= SHORTEST_S * rate]
    used = long or even[:1]  # its length is refused
    starts = np.cumsum([0, *(len(rows) for rows in used[:-1])]).tolist()
    total = sum(float(piece.times[-1] - piece.times[0]) for piece in motion.pieces())
    words = motion.understood()
    if len(cut) > 1:
        words += (
            f"; used {sum(map(len, used)) / rate:.1f} of {total:.1f} s in {len(used)} of"
            f" {len(cut)} pieces, of {SHORTEST_S:g} s or more each"
        )
    return np.concatenate(used), rate, tuple(starts), words


def _resampled(piece: ArmMotion, own_hz: float, rate_hz: float) -> Array:
    """Return an uninterrupted piece, whose own rate is given, at another one, (k, 3, n)."""
    even = piece.at_rate(rate_hz)
    if rate_hz >= own_hz or len(even.rows) < SHORTEST_S * rate_hz:
        return even.rows
    even = piece.at_rate(own_hz)
    return replace(even, rows=decimable(even.rows, own_hz, rate_hz)).at_rate(rate_hz).rows


def decimable(rows: Array, own_hz: float, rate_hz: float) -> Array:
    """Return rows, (k, 3, n), whose velocities and efforts lack what folds at a lower rate.

    Positions stay as they are, as stop elements follow those ahead of any filter.
    """
    kept = low_pass(rows[:, 1:], KEPT * rate_hz, own_hz, FilterSettings())
    return np.concatenate([rows[:, :1], kept], axis=1)


def filtered(log: Log, arm: ArmDescription, settings: FilterSettings) -> FilteredLog:
    """Filter a log forwards and backwards, and differentiate it.

    The motion of a simulated log is differentiated alone: predictions along it are filtered as the
    efforts are. Filtered before that, too, efforts of a joint that sticks differ from them.

    Source of the order: dvrk_dynamics_identification filters positions, velocities and efforts
    alike, and differentiates velocities by central differences of five points.

    Raises:
        InputError: a cut-off at or above half of the log's rate
    """
    if log.poses:
        resting = np.tile(arm.poses["home"][log.q.shape[1] :], (len(log.q), 1))
        q = np.hstack([log.q, resting])
        motion = JointMotion(q, 0.0 * q, 0.0 * q, up=log.up)
        return FilteredLog(log, settings, motion, log.effort @ log.joint_from_column)
    for cutoff in (settings.cutoff_hz, *settings.acceleration_cutoff_hz.values()):
        if not cutoff < 0.5 * log.rate_hz:
            raise InputError(
                f"{log.file}: cut-off of {cutoff:g} Hz; allowed: below half of the log's"
                f" {log.rate_hz:g} Hz"
            )

    def smooth(values: Array, cutoff_hz: float = settings.cutoff_hz) -> Array:
        return log.by_piece(values, lambda v: low_pass(v, cutoff_hz, log.rate_hz, settings))

    def differentiated(values: Array) -> Array:
        return log.by_piece(values, lambda v: derivative(v, log.rate_hz))

    names = arm.mechanism.joint_names[: log.q.shape[1]]
    resting = len(arm.joints) - len(names)
    rest = np.tile(arm.poses["home"][len(names) :] if resting else np.zeros(0), (len(log.q), 1))
    still = np.zeros((len(log.q), resting))
    effort = smooth(log.effort @ log.joint_from_column)
    if log.simulated:
        parts = zip((log.q, log.qd, differentiated(log.qd)), (rest, still, still), strict=True)
        q, qd, qdd = (np.hstack(part) for part in parts)
        return FilteredLog(log, settings, JointMotion(q, qd, qdd, up=log.up), effort)
    q, qd = smooth(log.q), smooth(log.qd)
    qdd = smooth(differentiated(log.qd))
    for joint in settings.differentiated:
        k = names.index(joint)
        qd[:, k] = differentiated(q[:, k])
        qdd[:, k] = differentiated(qd[:, k])
    for joint, cutoff in settings.acceleration_cutoff_hz.items():
        k = names.index(joint)
        qdd[:, k] = smooth(qdd[:, k], cutoff)
    motion = JointMotion(
        np.hstack([q, rest]),
        np.hstack([qd, still]),
        np.hstack([qdd, still]),
        np.hstack([log.q, rest]),
        log.up,
    )
    return FilteredLog(log, settings, motion, effort)


def low_pass(values: Array, cutoff_hz: float, rate_hz: float, settings: FilterSettings) -> Array:
    """Return values, (k, ...), behind a Butterworth filter run forwards and backwards."""
    sections = cast("Array", butter(settings.order, cutoff_hz, fs=rate_hz, output="sos"))
    return sosfiltfilt(sections, values, axis=0)


def _own_rows(file: str, arm: ArmDescription, name: str) -> tuple[Array, float, Array]:
    """Return the rows of a recording of trocar's own, (k, 3, n), their rate [Hz], and `up`, (3,).

    An effort acts during the step that ends at its row: efforts are means of the steps before and
    after. Half a step of delay would take inertia times jerk for 9 % of a yaw's viscous friction.
    Held set-points and gravity compensation change within a row: what they do there is averaged.
    """
    recorded = open_recording(file)
    joints = recorded_joints(arm)
    known = [recorded.columns(one) for one in recorded.arms if name in ("", one)]
    fitting = [c for c in known if c is not None and set(joints) <= set(c.joints)]
    if len(fitting) != 1:
        raise LogError(
            file,
            f"contains {len(fitting)} arms with the joints of {arm.name}"
            f" ({', '.join(recorded.arms)}); allowed: one"
            " (of several, name a rig and the arm)",
        )
    every = max(1, round(0.005 / recorded.timestep))
    states = recorded.states(fitting[0])
    order = [list(fitting[0].joints).index(name) for name in joints]
    effort = 0.5 * (states.effort + np.concatenate([states.effort[1:], states.effort[-1:]]))
    rows = np.stack([states.position, states.velocity, effort], axis=1)
    rate_hz = 1.0 / (every * recorded.timestep)
    if every > 1 and len(rows) >= SHORTEST_S * every * rate_hz:
        rows = decimable(rows, every * rate_hz, rate_hz)
    return rows[::every, :, order], rate_hz, _recorded_up(recorded, fitting[0].name)


def _recorded_up(recorded: Recorded, name: str) -> Array:
    """Return the direction against gravity of a recorded arm, as its rig has it, (3,).

    A rig that was built in Python is not in the recording: its arms are taken to stand upright.
    """
    source = recorded.about["rig_source"]
    try:
        return standing_arm(name, rig=source).up if source else UPRIGHT
    except TrocarError as problem:
        raise LogError(
            recorded.file,
            f"its rig, on which the direction of gravity in {name} depends, cannot be read"
            f" ({problem}); allowed: name the rig, or the rotation of the base",
        ) from problem


def _has_poses(path: str | Path) -> bool:
    """Return whether a CSV file's first row has as many numbers as a pose at rest."""
    where = Path(path).expanduser()
    if not where.is_file():
        return False
    with where.open("rb") as stream:
        return stream.readline(1 << 14).count(b",") == 2 * POSE_JOINTS - 1


def _pose_rows(path: str | Path, arm: ArmDescription) -> Array:
    """Return poses at rest, (k, 3, n): the other joints at 0, as the script has them."""
    file, joints = str(path), recorded_joints(arm)
    found: list[list[float]] = []
    with Path(path).expanduser().open(encoding="utf-8-sig", errors="replace") as stream:
        for number, line in enumerate(stream, 1):
            if not line.strip():
                continue
            fields = line.strip().split(",")
            try:
                values = [float(field) for field in fields]
            except ValueError:
                values = []
            if len(values) != 2 * POSE_JOINTS or not np.isfinite(values).all():
                raise LogError(file, f"got {line.strip()[:60]!r}; allowed: positions and efforts of"
                    f" {', '.join(joints[:POSE_JOINTS])}", number)  # fmt: skip
            found.append(values)
    if len(found) < FEWEST_POSES:
        raise LogError(file, f"got {len(found)} poses; allowed: {FEWEST_POSES} or more")
    table = np.array(found)
    rows = np.zeros((len(table), 3, len(joints)))
    rows[:, 0, :POSE_JOINTS], rows[:, 2, :POSE_JOINTS] = np.hsplit(table, 2)
    return rows


def _check_columns(log: Log, arm: ArmDescription) -> None:
    """Reject columns whose units, signs or order cannot be right.

    Raises:
        LogError: the test that failed, and the joint
    """
    names = arm.mechanism.joint_names
    if not np.abs(log.effort).max() > 0.0:
        raise LogError(log.file, "efforts are zero throughout; allowed: recorded efforts")
    moved = log.by_piece(log.q, lambda v: derivative(v, log.rate_hz))
    rates = log.qd
    usual = default_filters(arm)
    if slowed(usual, log.rate_hz) is not usual:
        cutoff = SLOW_CUTOFF * log.rate_hz
        moved, rates = (
            log.by_piece(one, lambda v: low_pass(v, cutoff, log.rate_hz, usual))
            for one in (moved, rates)
        )
    still = log.still_joints(arm)
    for k, name in enumerate(names[: log.q.shape[1]]):
        if name in still:
            continue
        size = float(moved[:, k] @ moved[:, k])
        slope = float(rates[:, k] @ moved[:, k]) / size
        speed = np.linalg.norm(rates[:, k])
        similar = slope * np.sqrt(size) / speed if speed > 0.0 else 0.0
        if abs(similar) < CORRELATION:
            raise LogError(
                log.file,
                f"velocities: {name}: correlate by {similar:.2f} with the derivative of the"
                f" positions; allowed: {CORRELATION} or more (are columns swapped, or is the rate"
                f" not {log.rate_hz:g} Hz?)",
            )
        if not SLOPES[0] <= slope <= SLOPES[1]:
            raise LogError(
                log.file,
                f"velocities: {name}: {slope:.3g} times the derivative of the positions; allowed:"
                f" {SLOPES[0]} to {SLOPES[1]} (unit, sign, or a rate that is not"
                f" {log.rate_hz:g} Hz?)",
            )
        limit = arm.joints[k].effort_max
        at_limit = float(np.mean(np.abs(log.effort[:, k]) >= 0.999 * limit))
        if at_limit > SATURATED:
            raise LogError(
                log.file,
                f"efforts: {name}: {at_limit:.0%} of the samples are at or above the limit of"
                f" {limit:g}; allowed: {SATURATED:.0%} (saturated, or another unit?)",
            )
        peak = float(np.abs(log.effort[:, k]).max())
        clipped = float(np.mean(cast("Array", np.abs(log.effort[:, k]) == peak)))
        if peak > 0.0 and clipped > SATURATED:
            raise LogError(
                log.file,
                f"efforts: {name}: {clipped:.0%} of the samples are {peak:g} in magnitude, the"
                f" largest of all; allowed: {SATURATED:.0%} (saturated?)",
            )
    power = log.effort * log.qd
    work, exchanged = float(power.sum()), float(np.abs(power).sum())
    if work < -0.1 * exchanged:
        raise LogError(
            log.file,
            f"efforts: the motors take up {-work / log.rate_hz:.3g} J, but friction dissipates;"
            " allowed: efforts that drive the joints in their positive directions (sign?)",
        )
