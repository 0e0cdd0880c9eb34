"""Recordings of one real arm as rows of positions, velocities and efforts: text files and bags."""

from __future__ import annotations

import gzip
import io
import math
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, TextIO

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError, LogError
from trocar.kinematics.coupling import Coupling, joint_effort_from_actuator, joint_from_actuator
from trocar.recording.bags import FORMATS, JOINT_STATE, Bag, open_bag

Array = NDArray[np.float64]
Wrist = Literal["motor", "joint"]

#: Formats that `trocar replay` reads.
READABLE = f"a recording of trocar's own (MCAP), a CSV file (plain or gzip), {FORMATS}"
#: The parts of a row, each of every joint.
QUANTITIES = ("positions", "velocities", "efforts")
#: Joints that recordings have as motor positions; the roll of a PSM is a joint position.
#: Source: dvrk_dynamics_identification, its recording script.
MOTOR_SIDE = {
    "PSM": ("wrist_pitch", "wrist_yaw", "jaw"),
    "MTM": ("shoulder_pitch", "elbow_pitch", "wrist_platform"),
}
#: Joints 2 to 4 of a master from its motors. Source: SAW share/kinematic/MTML.json.
MTM_COUPLING = Coupling(np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.6697, -0.6697, 1.0]]))
#: Rows per read. Source: our own choice.
CHUNK_ROWS = 500
#: Longest row of numbers [characters]. Source: our own choice; 21 columns take some 450.
LONGEST_LINE = 1 << 16
#: Longest gap between samples that is interpolated [s]. Source: our own choice.
LONGEST_GAP_S = 1.0
MEASURED, JAW = "/measured_js", "/jaw/measured_js"
#: Largest position beyond a limit [joint ranges], velocity [per s] and effort [N m or N] of a log
#: of an arm. Source: our own choice, ten times those of the arms.
MOST_RANGES_BEYOND = 1.0
MOST_VELOCITY = 300.0
MOST_EFFORT = 1000.0


def recorded_joints(arm: ArmDescription) -> tuple[str, ...]:
    """Return the joints that a row holds: all but the gripper of an MTM, which has no motor."""
    names = arm.mechanism.joint_names
    return names[: arm.own_joints] if arm.type == "MTM" else names


def read_log(
    path: str | Path, arm: ArmDescription, wrist: Wrist = "motor", chunk_rows: int = CHUNK_ROWS
) -> Iterator[Array]:
    """Read a recording chunk by chunk, in the arm's public joints.

    The file is text, plain or gzip: comma-separated numbers without a header, a row per sample,
    the positions of all joints, then their velocities, then their efforts (SI).

    Args:
        path: the file
        arm: the recorded arm, with the tool that was mounted
        wrist: how coupled joints (a PSM's wrist and jaw, an MTM's joints 2 to 4) were written down:
            "motor" side, or as public "joint"s
        chunk_rows: rows of a chunk at most

    Yields:
        (k, 3, n) positions, velocities, efforts [rad or m, per s, N m or N]; k >= 1

    Raises:
        LogError: no such file, truncated, or no recording of this arm; file and row are named
        InputError: recordings of this arm cannot be read
    """
    if wrist not in ("motor", "joint"):
        raise InputError(f"wrist: got {wrist!r}; allowed: motor, joint")
    coupled = actuators_of_recording(arm) if wrist == "motor" and arm.type in MOTOR_SIDE else None
    names, file = recorded_joints(arm), str(path)

    def chunk(first: int, rows: list[list[float]]) -> Array:
        """Return rows as (k, 3, n) in public joints, checked."""
        joints = np.array(rows).reshape(len(rows), len(QUANTITIES), len(names))
        if coupled is not None:
            which, coupling = coupled
            joints[:, :2, which] = joint_from_actuator(coupling, joints[:, :2, which])
            joints[:, 2, which] = joint_effort_from_actuator(coupling, joints[:, 2, which])
        check_rows(file, first, joints, arm)
        return joints

    first = 1
    rows: list[list[float]] = []
    for number, line in _lines(path):
        rows.append(_numbers(file, number, line, names))
        if len(rows) == chunk_rows:
            yield chunk(first, rows)
            first, rows = number + 1, []
    if rows:
        yield chunk(first, rows)


def count_rows(path: str | Path, arm: ArmDescription, wrist: Wrist = "motor") -> int:
    """Read a recording to its end and return its number of rows.

    Raises:
        LogError: as for `read_log`, and when there are fewer than two rows
        InputError: as for `read_log`
    """
    count = sum(len(chunk) for chunk in read_log(path, arm, wrist))
    if count < 2:
        got = "is empty" if count == 0 else "got 1 row"
        raise LogError(str(path), f"{got}; allowed: 2 rows or more")
    return count


def actuators_of_recording(arm: ArmDescription) -> tuple[list[int], Coupling]:
    """Select the joints that a recording has on the motor side, and the coupling of these alone.

    Raises:
        InputError: the PSM's tool has no such coupling
    """
    names, sides = arm.mechanism.joint_names, MOTOR_SIDE[arm.type]
    which = [names.index(name) for name in sides if name in names]
    if arm.type == "MTM":
        return which, MTM_COUPLING
    coupled = arm.coupling.joints if arm.coupling else ()
    if arm.coupling is None or not set(sides) <= set(coupled):
        raise InputError(
            f"{arm.name}: the tool has no coupling of {', '.join(sides)}, required for a motor-side"
            " recording needs; allowed: wrist joint"
        )
    inner = [coupled.index(name) for name in sides]
    outer = [k for k in range(len(coupled)) if k not in inner]
    matrix = arm.coupling.actuator_to_joint
    if matrix[np.ix_(inner, outer)].any() or matrix[np.ix_(outer, inner)].any():
        raise InputError(
            f"{arm.name}: the coupling mixes {', '.join(sides)} with other joints; allowed:"
            " wrist joint"
        )
    return which, Coupling(matrix[np.ix_(inner, inner)])


def check_rows(file: str, first: int, chunk: Array, arm: ArmDescription) -> None:
    """Check that rows (k, 3, n) are what this arm can have done; `first` is the first one's number.

    Raises:
        LogError: they are not; file, row and joint are named
    """
    count = chunk.shape[2]
    lower, upper = arm.mechanism.lower[:count], arm.mechanism.upper[:count]
    beyond = MOST_RANGES_BEYOND * (upper - lower)
    least = np.stack([lower - beyond, np.full(len(lower), -MOST_VELOCITY), 0.0 * lower])
    most = np.stack([upper + beyond, np.full(len(lower), MOST_VELOCITY), 0.0 * lower])
    least[2], most[2] = -MOST_EFFORT, MOST_EFFORT
    bad = (chunk < least) | (chunk > most)
    if bad.any():
        row, quantity, joint = (int(k) for k in np.argwhere(bad)[0])
        raise LogError(
            file,
            f"{QUANTITIES[quantity]}: {arm.joints[joint].name}:"
            f" got {chunk[row, quantity, joint]:.6g};"
            f" allowed: {least[quantity, joint]:.6g} to {most[quantity, joint]:.6g}"
            f" (is this a recording of a {arm.name}?)",
            first + row,
        )


def _numbers(file: str, number: int, line: str, joints: Sequence[str]) -> list[float]:
    """Return the numbers of a row."""
    fields = line.split(",")
    count = len(QUANTITIES) * len(joints)
    if len(fields) != count:
        raise LogError(
            file,
            f"got {len(fields)} columns; allowed: {count} ({', '.join(QUANTITIES)} of"
            f" {', '.join(joints)})",
            number,
        )
    values: list[float] = []
    for column, field in enumerate(fields, 1):
        try:
            value = float(field)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            got = f"column {column}: got {field.strip()[:40]!r}; allowed: a number"
            raise LogError(file, got, number)
        values.append(value)
    return values


def _lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Give (row from 1, text) of a plain or gzip file; blank rows may only stand at its end."""
    file, number, blank = str(path), 0, 0
    try:
        with ExitStack() as stack:
            stream = _open(path, stack)
            while line := stream.readline(LONGEST_LINE):
                number += 1
                if len(line) >= LONGEST_LINE:
                    raise LogError(file, "is not a table of numbers: row too long", number)
                if not line.strip():
                    blank = blank or number
                    continue
                if blank:
                    raise LogError(
                        file, "row is blank; allowed: at the end of the file only", blank
                    )
                yield number, line
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(file, f"gzip data is truncated or damaged ({error})", number + 1) from error
    except UnicodeDecodeError as error:
        raise LogError(file, "is not text; allowed: comma-separated numbers", number + 1) from error
    except OSError as error:
        raise LogError(file, f"cannot be read: {error.strerror or error}") from error


def _open(path: str | Path, stack: ExitStack) -> TextIO:
    """Open a file as text, unpacked when it is gzip whatever its name says."""
    where = Path(path).expanduser()
    if not where.is_file():
        what = "is a folder" if where.is_dir() else "no such file"
        raise LogError(str(path), f"{what}; allowed: {READABLE}")
    raw = stack.enter_context(where.open("rb"))
    packed = raw.read(2) == b"\x1f\x8b"
    raw.seek(0)
    plain = stack.enter_context(gzip.GzipFile(fileobj=raw)) if packed else raw
    return stack.enter_context(io.TextIOWrapper(plain, encoding="utf-8-sig"))


def read_bag(
    path: str | Path, arm: ArmDescription, rate_hz: float, topic: str | None = None
) -> tuple[Array, bool]:
    """Read the motion of an arm at even times, in its public joints.

    Rows between two samples are filled in evenly. Velocities that a bag lacks are the differences
    of positions. The jaw has a topic of its own on the dVRK; without it, it stays closed.

    Args:
        path: the bag
        arm: the recorded arm, with the tool that was mounted
        rate_hz: of the rows [Hz]
        topic: of the joint states; the bag's only one that fits the arm when omitted

    Returns:
        (k, 3, n) positions, velocities, efforts [rad or m, per s, N m or N], and whether the bag
        has efforts; zeros stand for those that it lacks

    Raises:
        LogError: no bag, no such topic, or joint states that this arm does not have
        MissingExtraError: rosbags is not installed
    """
    bag, joints = open_bag(path), recorded_joints(arm)
    chosen = _topic(bag, arm, topic)
    own_joints = joints[: len(joints) - arm.has_jaw]
    times, names, table, has_efforts = _samples(bag, chosen)
    columns = _order(bag.file, chosen, names, joints, own_joints)
    # float64 rounds today's seconds to 0.2 us
    even = np.arange(times[0], times[-1] + 1e-6, 1.0 / rate_hz)
    rows = np.zeros((len(even), len(QUANTITIES), len(joints)))
    rows[:, :, : len(columns)] = _even(times, table, even)[:, :, columns]
    jaw = f"/{chosen}".removesuffix(MEASURED).lstrip("/") + JAW
    if arm.has_jaw and len(columns) < len(joints) and jaw in bag.topics:
        times, _, table, _ = _samples(bag, jaw)
        rows[:, :, len(columns) :] = _even(times, table, even)[:, :, :1]
    return rows, has_efforts


def _even(times: Array, table: Array, even: Array) -> Array:
    """Return samples (k, 3, n) at other times."""
    flat = table.reshape(len(table), -1)
    filled = [np.interp(even, times, column) for column in flat.T]
    return np.stack(filled, axis=1).reshape(len(even), *table.shape[1:])


def _order(
    file: str, topic: str, names: Sequence[str], joints: Sequence[str], own: Sequence[str]
) -> list[int]:
    """Map the joints of the arm to columns of a topic."""
    for expected in (joints, own):
        if set(names) == set(expected):
            return [list(names).index(name) for name in expected]
    if len(names) in (len(joints), len(own)):  # other names for the same joints
        return list(range(len(names)))
    raise LogError(
        file,
        f"/{topic}: got {len(names)} joints ({', '.join(names)}); allowed: {len(own)}"
        f" ({', '.join(own)})",
    )


def _topic(bag: Bag, arm: ArmDescription, topic: str | None) -> str:
    """Return the topic to read, without a leading slash."""
    found = sorted(
        name
        for name, kind in bag.topics.items()
        if kind == JOINT_STATE and f"/{name}".endswith(MEASURED) and not name.endswith(JAW)
    )
    known = ", ".join(f"/{name}" for name in found) or "none"
    if topic is not None:
        if topic.lstrip("/") not in bag.topics:
            raise LogError(bag.file, f"has no topic {topic!r}; joint states are in: {known}")
        return topic.lstrip("/")
    fitting = [name for name in found if name.upper().startswith(arm.type)]
    named = [name for name in fitting if name.split("/")[0].lower() == arm.name]
    if len(fitting) == 1 or len(named) == 1:
        return (named or fitting)[0]
    if not found:
        raise LogError(
            bag.file, f"contains no joint states; allowed: a topic /{arm.type}.../measured_js"
        )
    raise LogError(
        bag.file, f"{len(fitting)} topics fit a {arm.type}; select one with --topic: {known}"
    )  # fmt: skip


def _samples(bag: Bag, topic: str) -> tuple[Array, tuple[str, ...], Array, bool]:
    """Read a topic to its end: times (k,) [s], names, table (k, 3, n), whether it has efforts."""
    times: list[float] = []
    values: list[tuple[Any, ...]] = []
    names: tuple[str, ...] = ()

    def reject(problem: str) -> LogError:
        return LogError(bag.file, f"/{topic}: {problem}", len(times) + 1)

    for message in bag.messages([topic]):
        fields, at = message.fields, message.fields["stamp"]
        if times and at == times[-1]:
            continue
        if times and at < times[-1]:
            raise reject("time goes back")
        if times and at - times[-1] > LONGEST_GAP_S:
            gap = f"a gap of {at - times[-1]:.6g} s after {times[-1] - times[0]:.3f} s"
            raise reject(f"{gap}; allowed: up to {LONGEST_GAP_S:g} s")
        position = fields["position"]
        names = names or tuple(fields["name"]) or tuple(map(str, range(len(position))))
        if len(position) != len(names):
            raise reject(f"got {len(position)} positions; allowed: {len(names)}")
        if not np.isfinite(position).all():
            raise reject("positions must be finite")
        times.append(at)
        values.append((position, fields["velocity"], fields["effort"]))
    if len(times) < 2:
        raise LogError(bag.file, f"/{topic}: got {len(times)} samples; allowed: 2 or more")
    has_velocities, has_efforts = (all(len(v[k]) == len(names) for v in values) for k in (1, 2))
    time, position = np.array(times), np.array([v[0] for v in values])
    velocity = (
        np.array([v[1] for v in values])
        if has_velocities
        else np.gradient(position, time, axis=0)
    )  # fmt: skip
    effort = np.array([v[2] for v in values]) if has_efforts else np.zeros_like(position)
    return time, names, np.stack([position, velocity, effort], axis=1), has_efforts
