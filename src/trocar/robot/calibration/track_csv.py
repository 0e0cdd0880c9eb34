"""CSV files of motion capture: exports of OptiTrack Motive (formats 1.20 to 1.25) and tidy CSV.

Source: Motive documentation, "Data Export: CSV", editions 2.1 to 3.2; public takes and readers.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TracksError
from trocar.inputs import read_input

Array = NDArray[np.float64]

#: Source: our own choice; an hour of seven bodies at 120 Hz has 0.4 GB.
MOST_BYTES = 500_000_000
TIDY_COLUMNS = ("time_s", "body", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
MOTIVE_FIRST = "Format Version"
MOTIVE_KEYS = (
    MOTIVE_FIRST, "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate",
    "Capture Start Time", "Capture Start Frame", "Total Frames in Take", "Total Exported Frames",
    "Rotation Type", "Length Units", "Coordinate Space",
)  # fmt: skip
MOTIVE_VERSIONS = {"1.2", *(f"1.2{minor}" for minor in range(6))}
#: Metres per `Length Units`.
UNITS = {"Meters": 1.0, "Centimeters": 1e-2, "Millimeters": 1e-3, "Inches": 0.0254}
#: (kind, axis) of a rigid body's seven columns: the position, then the quaternion, scalar first.
PARTS = (
    ("Position", "X"), ("Position", "Y"), ("Position", "Z"),
    ("Rotation", "W"), ("Rotation", "X"), ("Rotation", "Y"), ("Rotation", "Z"),
)  # fmt: skip
TIME = "Time (Seconds)"
#: Largest deviation of a quaternion's length from 1; quaternions are normalised.
#: Source: our own choice; six decimals leave 1e-6, a wrong column far more.
UNIT_TOLERANCE = 1e-3
#: Replaces a blank cell; cells are stripped, so none is written like this.
BLANK = " nan"


@dataclass(frozen=True, eq=False)
class BodyTrack:
    """One body as a file has it.

    Attributes:
        times: (k,) [s], of the samples that have a row
        positions: (k, 3) [m], NaN if the body is not tracked
        quaternions: (k, 4) wxyz, unit length, NaN if the body is not tracked
    """

    times: Array
    positions: Array
    quaternions: Array


@dataclass(frozen=True)
class CsvRows:
    """Rows of a comma-separated file.

    Attributes:
        file: for the errors
        lines: number of each row's line, from 1
        cells: of each row
    """

    file: str
    lines: Sequence[int]
    cells: Sequence[list[str]]

    def error(self, problem: str, row: int) -> TracksError:
        """Return an error that names the line of a row."""
        return TracksError(self.file, problem, int(self.lines[row]))

    def part(self, begin: int, end: int | None = None) -> CsvRows:
        """Return the rows from `begin` to before `end`."""
        return CsvRows(self.file, self.lines[begin:end], self.cells[begin:end])

    def numbers(self, columns: Sequence[int], names: Sequence[str]) -> Array:
        """Return some columns as numbers, NaN for blank or missing cells, (n_rows, n_columns).

        Args:
            columns: index of each column
            names: of the columns, for the error

        Raises:
            TracksError: a cell that is not a finite number, with its line and column
        """
        last = max(columns)
        padded = (
            cells if len(cells) > last else cells + [""] * (last + 1 - len(cells))
            for cells in self.cells
        )
        picked = [[cells[c].strip() or BLANK for c in columns] for cells in padded]
        try:
            found = np.array(picked, dtype=np.float64).reshape(-1, len(columns))
        except ValueError:
            found = np.zeros((0, len(columns)))
        if np.isfinite(found).sum() == sum(cell is not BLANK for row in picked for cell in row):
            return found
        for row, cells in enumerate(picked):
            for column, cell, name in zip(columns, cells, names, strict=True):
                if cell is not BLANK and not _is_finite(cell):
                    raise self.error(
                        f"{name}: got {self.cells[row][column]!r}; allowed: a finite number, or"
                        " blank if the body is not tracked",
                        row,
                    )
        raise TracksError(self.file, "contains a value that is not a number")

    def check_times(self, name: str, times: Array) -> None:
        """Reject times that do not increase, or that are missing.

        Raises:
            TracksError: with the name and the line
        """
        if np.isnan(times).any():
            row = int(np.argmax(np.isnan(times)))
            raise self.error("time is blank; allowed: seconds", row)
        back = np.flatnonzero(np.diff(times) <= 0.0)
        if not len(back):
            return
        before, after = times[back[0]], times[back[0] + 1]
        what = "a second time" if before == after else f"after {before:.9g} s"
        raise self.error(
            f"{name}: got the time {after:.9g} s {what}; allowed: increasing times",
            int(back[0]) + 1,
        )

    def track(self, body: str, times: Array, values: Array) -> BodyTrack:
        """Return a body whose rows are complete or blank, in order of time, unit quaternions.

        Args:
            body: for the errors
            times: (k,) [s]
            values: position [m] and quaternion wxyz of each row, (k, 7)

        Raises:
            TracksError: with body and line
        """
        blanks = np.isnan(values).sum(axis=1)
        half = (blanks > 0) & (blanks < 7)
        if half.any():
            row = int(np.argmax(half))
            raise self.error(
                f"{body}: {blanks[row]} of 7 values are blank; allowed: seven numbers, or all"
                " seven blank if the body is not tracked",
                row,
            )
        self.check_times(body, times)
        length = np.linalg.norm(values[:, 3:], axis=1)
        wrong = np.abs(length - 1.0) > UNIT_TOLERANCE
        if wrong.any():
            row = int(np.argmax(wrong))
            got = ", ".join(f"{value:g}" for value in values[row, 3:])
            raise self.error(
                f"{body}: got a quaternion of norm {length[row]:.6g} (w, x, y, z = {got});"
                f" allowed: norm 1 within {UNIT_TOLERANCE:g}",
                row,
            )
        return BodyTrack(times, values[:, :3], values[:, 3:] / length[:, None])


@dataclass(frozen=True, eq=False)
class CsvTracks:
    """Contents of a file of motion capture.

    Attributes:
        bodies: {name: track}
        rate_hz: according to the header, None where it has none [Hz]
        warnings: for the user
    """

    bodies: Mapping[str, BodyTrack]
    rate_hz: float | None = None
    warnings: tuple[str, ...] = ()


def read_text(path: str | Path) -> tuple[str, str]:
    """Return the text of a comma-separated file, and its sha256.

    Raises:
        TracksError: it cannot be read
    """
    try:
        content = read_input(path, MOST_BYTES)
        return content.decode("utf-8-sig"), hashlib.sha256(content).hexdigest()
    except OSError as problem:
        raise TracksError(str(path), f"cannot be read: {problem.strerror}") from problem
    except UnicodeDecodeError as problem:
        raise TracksError(
            str(path), "is not UTF-8 text; allowed: comma-separated text"
        ) from problem


def csv_rows(file: str, text: str) -> CsvRows:
    """Return the rows of a comma-separated text, without blank lines.

    Raises:
        TracksError: naming the line
    """
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        every = [(reader.line_num, cells) for cells in reader if any(cells)]
    except csv.Error as problem:
        raise TracksError(
            file, f"is not comma-separated text: {problem}", reader.line_num
        ) from problem
    return CsvRows(file, [line for line, _ in every], [cells for _, cells in every])


def parse_csv(file: str, text: str) -> CsvTracks:
    """Read the text of a Motive export or a tidy file.

    Args:
        file: for the errors
        text: of the whole file

    Raises:
        TracksError: naming the line, what was got and what is allowed
    """
    rows = csv_rows(file, text)
    head = [cell.strip() for cell in rows.cells[0]] if rows.cells else []
    if head and head[0] == MOTIVE_FIRST:
        return _motive(rows)
    if {"body", "time_s"} <= {cell.lower() for cell in head}:
        return _tidy(rows)
    allowed = f'allowed: a Motive export ("{MOTIVE_FIRST}", ...), or {",".join(TIDY_COLUMNS)}'
    if not rows.cells:
        raise TracksError(file, f"is empty; {allowed}")
    if re.fullmatch(r"\s*[-+.\d][-+.\deE]*\s*", rows.cells[0][0]):
        raise rows.error(
            "has no header; export it with the header enabled (Motive: Data"
            f" Export, Header Information); {allowed}",
            0,
        )
    if ";" in head[0]:
        raise rows.error(f"is separated by semicolons; {allowed}, separated by commas", 0)
    got = ",".join(rows.cells[0])[:60]
    raise rows.error(f"got {got!r} as the first line; {allowed}", 0)


def _is_finite(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def _tidy(rows: CsvRows) -> CsvTracks:
    """Read a row for each body and sample; columns in any order, others are ignored."""
    head = [cell.strip().lower() for cell in rows.cells[0]]
    if missing := [name for name in TIDY_COLUMNS if name not in head]:
        raise rows.error(
            f"columns missing: {', '.join(missing)}; found: {', '.join(head)}; allowed:"
            f" {','.join(TIDY_COLUMNS)} (metres, seconds, quaternions with the scalar first)",
            0,
        )
    rows, column = rows.part(1), head.index("body")
    if not rows.cells:
        raise TracksError(rows.file, "has a header but no rows")
    names = [name for name in TIDY_COLUMNS if name != "body"]
    values = rows.numbers([head.index(name) for name in names], names)
    places: dict[str, list[int]] = {}
    for row, cells in enumerate(rows.cells):
        body = cells[column].strip() if len(cells) > column else ""
        if not body:
            raise rows.error("body: is blank; allowed: a body name", row)
        places.setdefault(body, []).append(row)
    found: dict[str, BodyTrack] = {}
    for body, at in places.items():
        own = CsvRows(rows.file, [rows.lines[i] for i in at], [rows.cells[i] for i in at])
        found[body] = own.track(body, values[at, 0], values[at, 1:])
    return CsvTracks(found)


def _motive(rows: CsvRows) -> CsvTracks:
    """Read the rigid bodies of a Motive export; its markers are ignored."""
    first = [cell.strip() for cell in rows.cells[0]]
    header: dict[str, str] = {}  # free text with commas in it does no harm
    for key, value in zip(first, [*first[1:], ""], strict=True):
        if key in MOTIVE_KEYS:
            header[key] = "" if value in MOTIVE_KEYS else value
    units = header.get("Length Units", "")
    if units not in UNITS:
        got = repr(units) if units else "none"
        raise rows.error(f"Length Units: got {got}; allowed: {', '.join(UNITS)}", 0)
    for key, allowed in (("Rotation Type", "Quaternion"), ("Coordinate Space", "Global")):
        if (value := header.get(key, allowed)) != allowed:
            raise rows.error(f"{key}: got {value!r}; allowed: {allowed}; export it again", 0)
    start = next((i for i, cells in enumerate(rows.cells) if cells[0].strip() == "Frame"), None)
    if start is None:
        raise TracksError(
            rows.file, 'no line begins with "Frame"; export it with the header enabled'
        )
    columns = _motive_columns(rows.part(1, start + 1))
    time = [cell.strip() for cell in rows.cells[start]].index(TIME)
    frames = rows.part(start + 1)
    if not frames.cells:
        raise TracksError(rows.file, "has a header but no frames")
    bodies = _motive_bodies(frames, time, columns, UNITS[units])
    return CsvTracks(
        bodies, _motive_rate(rows, header), _motive_warnings(header, len(frames.cells))
    )


def _motive_columns(rows: CsvRows) -> dict[str, list[int]]:
    """Return the seven columns of each rigid body, found by the rows of labels.

    Time code, where it is exported, adds a column in front: labels are searched, not counted.

    Raises:
        TracksError: no rigid body, a body without all its columns or twice, no times
    """
    last = len(rows.cells) - 1
    width = max(len(cells) for cells in rows.cells)
    axes = [cell.strip() for cell in rows.cells[last]]
    if TIME not in axes:
        raise rows.error(f'the header has no column "{TIME}"', last)
    labels: dict[str, list[str]] = {}
    for cells in rows.cells[:last]:
        row = [cell.strip() for cell in cells] + [""] * (width - len(cells))
        labels |= {name: row for name in ("Type", "Name", "ID", "Parent") if name in row[1:3]}
        if {"Rotation", "Position"} & {*row}:
            labels["Rotation, Position"] = row
    for name in ("Type", "Name", "Rotation, Position"):
        if name not in labels:
            raise rows.error(f"the header has no row of {name}", last)
    kinds, types, names = (labels[name] for name in ("Rotation, Position", "Type", "Name"))
    described = [column for column in range(2, len(axes)) if kinds[column]]
    bodies: dict[str, dict[tuple[str, str], int]] = {}
    for column in described:
        part = (kinds[column], axes[column])
        if types[column] == "Rigid Body" and part in PARTS:
            if part in bodies.setdefault(names[column], {}):
                raise rows.error(f"two rigid bodies are named {names[column]!r}", last)
            bodies[names[column]][part] = column
    if not bodies:
        got = ", ".join(sorted({types[column] for column in described})) or "nothing"
        raise rows.error(
            f"contains no rigid body; found columns of: {got}; allowed: Rigid Body", last
        )
    for name, parts in bodies.items():
        if missing := [" ".join(part) for part in PARTS if part not in parts]:
            raise rows.error(
                f"{name}: columns missing: {', '.join(missing)}; was its rotation exported as"
                " angles? allowed: Quaternion",
                last,
            )
    return {name: [parts[part] for part in PARTS] for name, parts in bodies.items()}


def _motive_bodies(
    frames: CsvRows, time: int, columns: Mapping[str, Sequence[int]], unit: float
) -> dict[str, BodyTrack]:
    """Read and check the frames."""
    head = frames.numbers((0, time), ("Frame", TIME))
    if np.isnan(head).any():
        row = int(np.argmax(np.isnan(head).any(axis=1)))
        raise frames.error("frame number or time is blank", row)
    back = np.flatnonzero(np.diff(head[:, 0]) <= 0.0)
    if len(back):
        row = int(back[0]) + 1
        raise frames.error(
            f"frame {head[row, 0]:g} comes after frame {head[row - 1, 0]:g}; allowed: increasing"
            " numbers",
            row,
        )
    frames.check_times(TIME, head[:, 1])
    scale = np.array([unit] * 3 + [1.0] * 4)
    return {
        body: frames.track(
            body,
            head[:, 1],
            scale * frames.numbers(places, [f"{body}, {' '.join(part)}" for part in PARTS]),
        )
        for body, places in columns.items()
    }


def _motive_rate(rows: CsvRows, header: Mapping[str, str]) -> float | None:
    """Return the rate of the exported frames, None when the header has none [Hz]."""
    text = header.get("Export Frame Rate") or header.get("Capture Frame Rate")
    if not text:
        return None
    rate = float(text) if _is_finite(text) else 0.0
    if rate <= 0.0:
        raise rows.error(f"Export Frame Rate: got {text!r}; allowed: above 0 Hz", 0)
    return rate


def _motive_warnings(header: Mapping[str, str], count: int) -> tuple[str, ...]:
    found: list[str] = []
    version, announced = header[MOTIVE_FIRST], header.get("Total Exported Frames", "")
    if version not in MOTIVE_VERSIONS:
        found.append(f"unknown format version {version or '(none)'}; read as version 1.25")
    if announced.isdigit() and int(announced) != count:
        found.append(
            f"the header announces {announced} frames, got {count}; the file may be truncated"
        )
    return tuple(found)
