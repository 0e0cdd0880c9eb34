"""Numbers of a comma-separated file, read fast, each one that is none named with its line."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TracksError

Array = NDArray[np.float64]

#: A quaternion's length may be off by this; it is normalised.
#: Source: our own choice; six decimals leave 1e-6, a wrong column far more.
UNIT_TOLERANCE = 1e-3
#: Stands for a blank cell; no cell without white space around it is written so.
BLANK = " nan"
BLANK_OR_ALL = "allowed: seven numbers, or all seven blank where the body is not tracked"


@dataclass(frozen=True)
class Row:
    """A line of a file: its number, from 1, and its cells."""

    line: int
    cells: list[str]


@dataclass(frozen=True, eq=False)
class BodyTrack:
    """One body as a file has it.

    Attributes:
        times: (k,) [s], of the samples that have a row
        positions: (k, 3) [m], NaN where the body is not tracked
        quaternions: (k, 4) wxyz, unit length, NaN where the body is not tracked
    """

    times: Array
    positions: Array
    quaternions: Array


def read_rows(file: str, text: str) -> list[Row]:
    """Return every line that is not empty, in order.

    Raises:
        TracksError: a quote that never ends
    """
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        rows = [Row(reader.line_num, cells) for cells in reader]
    except csv.Error as problem:
        raise TracksError(
            file, f"is no comma-separated text: {problem}", reader.line_num
        ) from problem
    return [row for row in rows if any(row.cells)]


def numbers(file: str, rows: Sequence[Row], columns: Sequence[int], names: Sequence[str]) -> Array:
    """Return the cells of some columns as numbers, blank ones as NaN, (n_rows, n_columns).

    Args:
        file: for the error
        rows: lines; cells that a line lacks at its end are blank
        columns: which cells of each line
        names: what a user calls these columns

    Raises:
        TracksError: text that is no finite number, with its line and column
    """
    last = max(columns)
    picked = [
        [cells[c].strip() or BLANK for c in columns]
        for cells in (
            row.cells if len(row.cells) > last else row.cells + [""] * (last + 1 - len(row.cells))
            for row in rows
        )
    ]
    try:
        found = np.array(picked, dtype=np.float64).reshape(len(rows), len(columns))
    except ValueError:
        found = None
    written = sum(cell is not BLANK for cells in picked for cell in cells)
    if found is None or np.isfinite(found).sum() != written:
        raise _wrong_cell(file, rows, columns, names)
    return found


def _wrong_cell(
    file: str, rows: Sequence[Row], columns: Sequence[int], names: Sequence[str]
) -> TracksError:
    """Return the error that names the first cell that is no finite number."""
    for row in rows:
        for column, name in zip(columns, names, strict=True):
            cell = row.cells[column] if column < len(row.cells) else ""
            if cell.strip() and not _finite(cell):
                return TracksError(
                    file,
                    f"{name}: got {cell!r}; allowed: a finite number, or blank where the body is"
                    " not tracked",
                    row.line,
                )
    return TracksError(file, "holds something that is no number")


def _finite(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def checked_track(
    file: str,
    body: str,
    times: Array,
    positions: Array,
    quaternions: Array,
    lines: NDArray[np.int64],
) -> BodyTrack:
    """Return one body whose rows are whole or blank, in order of time, with unit quaternions.

    Args:
        file, body: for the errors
        times: (k,) [s]
        positions: (k, 3) [m]
        quaternions: (k, 4) wxyz
        lines: of each row in the file, (k,)

    Raises:
        TracksError: naming body and line
    """
    values = np.hstack([positions, quaternions])
    blank = np.isnan(values)
    half = blank.any(axis=1) & ~blank.all(axis=1)
    if half.any():
        row = int(np.argmax(half))
        raise TracksError(
            file, f"{body}: {int(blank[row].sum())} of 7 values are blank; {BLANK_OR_ALL}",
            int(lines[row]),
        )  # fmt: skip
    check_order(file, body, times, lines)
    length = np.linalg.norm(quaternions, axis=1)
    with np.errstate(invalid="ignore"):
        wrong = np.abs(length - 1.0) > UNIT_TOLERANCE
    if wrong.any():
        row = int(np.argmax(wrong))
        got = ", ".join(f"{value:g}" for value in quaternions[row])
        raise TracksError(
            file,
            f"{body}: got a quaternion of length {length[row]:.6g} (w, x, y, z = {got}); allowed:"
            f" length 1 to {UNIT_TOLERANCE:g}",
            int(lines[row]),
        )
    return BodyTrack(times, positions, quaternions / length[:, None])


def check_order(file: str, body: str, times: Array, lines: NDArray[np.int64]) -> None:
    """Refuse times that do not increase, or that are missing.

    Raises:
        TracksError: naming the body and the line
    """
    if np.isnan(times).any():
        row = int(np.argmax(np.isnan(times)))
        raise TracksError(file, "the time is blank; allowed: seconds", int(lines[row]))
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if not len(back):
        return
    row = int(back[0])
    before, after = float(times[row]), float(times[row + 1])
    what = "a second time" if before == after else f"after {before:.9g} s"
    raise TracksError(
        file,
        f"{body}: got the time {after:.9g} s {what}; allowed: times that increase",
        int(lines[row + 1]),
    )
