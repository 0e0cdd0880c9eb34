"""Recordings of real arms: rows of positions, velocities and efforts, read as they come."""

from __future__ import annotations

import gzip
import io
import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Literal, TextIO

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError, LogError
from trocar.kinematics.coupling import Coupling, joint_effort_from_actuator, joint_from_actuator

Array = NDArray[np.float64]
Wrist = Literal["motor", "joint"]

#: What a row holds of every joint, one after the other.
QUANTITIES = ("positions", "velocities", "efforts")
#: Joints that recordings of a PSM hold as their motors turn; the roll is the joint already.
#: Source: dvrk_dynamics_identification, its recording script.
MOTOR_SIDE = ("wrist_pitch", "wrist_yaw", "jaw")
#: Rows that are read at once. Source: our own choice.
CHUNK_ROWS = 500
#: No row of numbers is longer. Source: our own choice; 21 columns take some 450 characters.
LONGEST_LINE = 1 << 16
#: A position this many joint ranges beyond a limit is no recording of this arm, nor are such
#: velocities [per s] and efforts [N m or N]. Source: our own choice, ten times what the arms do.
MOST_RANGES_BEYOND = 1.0
MOST_VELOCITY = 300.0
MOST_EFFORT = 1000.0


def read_log(
    path: str | Path, arm: ArmDescription, wrist: Wrist = "motor", chunk_rows: int = CHUNK_ROWS
) -> Iterator[Array]:
    """Read a recording chunk by chunk, in the arm's public joints.

    The file is text, plain or gzip: comma-separated numbers without a header, a row per sample,
    the positions of all joints, then their velocities, then their efforts (SI).

    Args:
        path: the file
        arm: whose recording it is, with the tool that was mounted
        wrist: how a PSM's wrist and jaw were written down: "motor" side, or as public "joint"s
        chunk_rows: rows of a chunk at most

    Yields:
        (k, 3, n) positions, velocities, efforts [rad or m, per s, N m or N]; k >= 1

    Raises:
        LogError: no such file, truncated, or no recording of this arm; file and row are named
        InputError: recordings of this arm cannot be read
    """
    convert = _converter(arm, wrist)
    count = len(QUANTITIES) * len(arm.joints)
    first, rows = 1, []
    for number, line in _lines(path):
        rows.append(_numbers(str(path), number, line, count, arm))
        if len(rows) == chunk_rows:
            yield _chunk(str(path), first, rows, arm, convert)
            first, rows = number + 1, []
    if rows:
        yield _chunk(str(path), first, rows, arm, convert)


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
    """Return which joints a PSM's recording holds motor-side, and the coupling of these alone.

    Raises:
        InputError: the arm's tool has no such coupling
    """
    names = arm.mechanism.joint_names
    coupled = arm.coupling.joints if arm.coupling else ()
    if arm.coupling is None or not set(MOTOR_SIDE) <= set(coupled):
        raise InputError(
            f"{arm.name}: its tool has no coupling of {', '.join(MOTOR_SIDE)}, which a motor-side"
            " recording needs; allowed: wrist joint"
        )
    inner = [coupled.index(name) for name in MOTOR_SIDE]
    outer = [k for k in range(len(coupled)) if k not in inner]
    matrix = arm.coupling.actuator_to_joint
    if matrix[np.ix_(inner, outer)].any() or matrix[np.ix_(outer, inner)].any():
        raise InputError(
            f"{arm.name}: the coupling mixes {', '.join(MOTOR_SIDE)} with other joints; allowed:"
            " wrist joint"
        )
    return [names.index(name) for name in MOTOR_SIDE], Coupling(matrix[np.ix_(inner, inner)])


def _converter(arm: ArmDescription, wrist: Wrist) -> Callable[[Array], Array]:
    """Return the function that turns rows (k, 3, n) as recorded into public joints."""
    if wrist not in ("motor", "joint"):
        raise InputError(f"wrist: got {wrist!r}; allowed: motor, joint")
    if arm.type == "MTM":
        raise InputError(
            f"{arm.name}: recordings of an MTM hold columns 2 to 4 motor-side and cannot be read"
            " yet; allowed: a PSM or an ECM"
        )
    if wrist == "joint" or arm.type != "PSM":
        return lambda rows: rows
    which, coupling = actuators_of_recording(arm)

    def convert(rows: Array) -> Array:
        joints = rows.copy()
        joints[:, :2, which] = joint_from_actuator(coupling, rows[:, :2, which])
        joints[:, 2, which] = joint_effort_from_actuator(coupling, rows[:, 2, which])
        return joints

    return convert


def _chunk(
    file: str,
    first: int,
    rows: list[list[float]],
    arm: ArmDescription,
    convert: Callable[[Array], Array],
) -> Array:
    """Return rows as (k, 3, n) in public joints, refusing what this arm cannot have done."""
    chunk = convert(np.array(rows).reshape(len(rows), len(QUANTITIES), len(arm.joints)))
    check_rows(file, first, chunk, arm)
    return chunk


def check_rows(file: str, first: int, chunk: Array, arm: ArmDescription) -> None:
    """Check that rows (k, 3, n) are what this arm can have done; `first` is the first one's number.

    Raises:
        LogError: they are not; file, row and joint are named
    """
    lower, upper = arm.mechanism.lower, arm.mechanism.upper
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


def _numbers(file: str, number: int, line: str, count: int, arm: ArmDescription) -> list[float]:
    """Return the numbers of a row."""
    fields = line.split(",")
    if len(fields) != count:
        raise LogError(
            file,
            f"got {len(fields)} columns; allowed: {count} ({', '.join(QUANTITIES)} of"
            f" {', '.join(arm.mechanism.joint_names)})",
            number,
        )
    try:
        values = [float(field) for field in fields]
    except ValueError:
        values = [math.nan]
    if all(map(math.isfinite, values)):
        return values
    column = next(k for k, field in enumerate(fields) if not _is_number(field))
    raise LogError(
        file, f"column {column + 1}: got {fields[column].strip()[:40]!r}; allowed: a number", number
    )


def _is_number(field: str) -> bool:
    try:
        return math.isfinite(float(field))
    except ValueError:
        return False


def _lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Give (row from 1, text) of a plain or gzip file; blank rows may only stand at its end."""
    file, number, blank = str(path), 0, 0
    try:
        with ExitStack() as stack:
            stream = _open(path, stack)
            while line := stream.readline(LONGEST_LINE):
                number += 1
                if len(line) >= LONGEST_LINE:
                    raise LogError(file, "is no table of numbers: the row never ends", number)
                if not line.strip():
                    blank = blank or number
                    continue
                if blank:
                    raise LogError(file, "is blank; allowed: blank rows at the end only", blank)
                yield number, line
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(
            file, f"the gzip file is truncated or damaged here ({error})", number + 1
        ) from error
    except UnicodeDecodeError as error:
        raise LogError(file, "is no text; allowed: comma-separated numbers", number + 1) from error
    except OSError as error:
        raise LogError(file, f"cannot be read: {error.strerror or error}") from error


def _open(path: str | Path, stack: ExitStack) -> TextIO:
    """Open a file as text, unpacked when it is gzip whatever its name says."""
    where = Path(path).expanduser()
    if not where.is_file():
        what = "is a folder" if where.is_dir() else "there is no such file"
        raise LogError(str(path), f"{what}; allowed: a CSV file, plain or gzip")
    raw = stack.enter_context(where.open("rb"))
    packed = raw.read(2) == b"\x1f\x8b"
    raw.seek(0)
    plain = stack.enter_context(gzip.GzipFile(fileobj=raw)) if packed else raw
    return stack.enter_context(io.TextIOWrapper(plain, encoding="utf-8-sig"))
