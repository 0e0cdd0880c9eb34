"""CSV exports of OptiTrack Motive, formats 1.20 to 1.25, read by labels.

Source: Motive documentation, "Data Export: CSV", editions 2.1 to 3.2; public takes and readers.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.cells import BodyTrack, Row, check_order, checked_track, numbers
from trocar.errors import TracksError

Array = NDArray[np.float64]

FIRST = "Format Version"
KEYS = (
    FIRST, "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate",
    "Capture Start Time", "Capture Start Frame", "Total Frames in Take", "Total Exported Frames",
    "Rotation Type", "Length Units", "Coordinate Space",
)  # fmt: skip
VERSIONS = {"1.2", *(f"1.2{minor}" for minor in range(6))}
#: What `Length Units` may say, in metres.
UNITS = {"Meters": 1.0, "Centimeters": 1e-2, "Millimeters": 1e-3, "Inches": 0.0254}
#: (kind, axis) of a rigid body's seven columns: the position, then the quaternion scalar first.
PARTS = (
    ("Position", "X"), ("Position", "Y"), ("Position", "Z"),
    ("Rotation", "W"), ("Rotation", "X"), ("Rotation", "Y"), ("Rotation", "Z"),
)  # fmt: skip
#: Rows of labels that are told by their second cell.
LABELS = ("Type", "Name", "ID", "Parent")


@dataclass(frozen=True)
class Columns:
    """Where the time and each body's seven columns stand in a line; the frame is the first."""

    time: int
    bodies: Mapping[str, tuple[int, ...]]


def is_motive(head: Sequence[str]) -> bool:
    """Tell whether a first line is that of a Motive export."""
    return bool(head) and head[0].strip() == FIRST


def read_motive(
    file: str, rows: Sequence[Row]
) -> tuple[Mapping[str, BodyTrack], float | None, tuple[str, ...]]:
    """Read the lines of an export; its rigid bodies are taken, its markers are not.

    Args:
        file: for the errors
        rows: every line that is not empty, the one of keys first

    Returns:
        the bodies, the rate that the header tells [Hz] or None, and warnings

    Raises:
        TracksError: naming the line, what was got and what is allowed
    """
    told = _keys(rows[0].cells)
    unit = _unit(file, told)
    start = next((i for i, row in enumerate(rows) if row.cells[0].strip() == "Frame"), None)
    if start is None:
        raise TracksError(file, 'no line begins with "Frame"; export it with the header on')
    columns = _columns(file, rows[1:start], rows[start])
    samples = rows[start + 1 :]
    if not samples:
        raise TracksError(file, "has a header and no frames")
    bodies = _bodies(file, samples, columns, unit)
    return bodies, _rate(file, told), tuple(_warnings(told, len(samples)))


def _keys(cells: Sequence[str]) -> dict[str, str]:
    """Return what the first line tells; free text with commas in it does no harm."""
    stripped = [cell.strip() for cell in cells]
    found: dict[str, str] = {}
    for key, value in zip(stripped, [*stripped[1:], ""], strict=True):
        if key in KEYS:
            found[key] = "" if value in KEYS else value
    return found


def _unit(file: str, told: Mapping[str, str]) -> float:
    """Return metres per unit of length, after a look at what else makes an export unusable."""
    units = told.get("Length Units", "")
    if units not in UNITS:
        got = repr(units) if units else "none"
        raise TracksError(file, f"Length Units: got {got}; allowed: {', '.join(UNITS)}", 1)
    rotation = told.get("Rotation Type", "Quaternion")
    if rotation != "Quaternion":
        raise TracksError(
            file, f"Rotation Type: got {rotation!r}; allowed: Quaternion; export it again so", 1
        )
    space = told.get("Coordinate Space", "Global")
    if space != "Global":
        raise TracksError(
            file, f"Coordinate Space: got {space!r}; allowed: Global; export it again so", 1
        )
    return UNITS[units]


def _rate(file: str, told: Mapping[str, str]) -> float | None:
    """Return the rate of the exported frames, None when it is not told [Hz]."""
    text = told.get("Export Frame Rate") or told.get("Capture Frame Rate")
    if not text:
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = np.nan
    if not 0.0 < rate < np.inf:
        raise TracksError(file, f"Export Frame Rate: got {text!r}; allowed: above 0 Hz", 1)
    return rate


def _warnings(told: Mapping[str, str], count: int) -> Iterable[str]:
    version = told[FIRST]
    if version not in VERSIONS:
        yield f"the format {version or 'without a number'} is unknown; read as 1.25 is"
    announced = told.get("Total Exported Frames", "")
    if announced.isdigit() and int(announced) != count:
        yield f"the header announces {announced} frames, and {count} were found: is it cut short?"


def _columns(file: str, labels: Sequence[Row], axes: Row) -> Columns:
    """Find the columns of every rigid body.

    Raises:
        TracksError: no rigid body, a body without all its columns or twice, no times
    """
    named = [cell.strip() for cell in axes.cells]
    if "Time (Seconds)" not in named:
        raise TracksError(file, 'the header has no column "Time (Seconds)"', axes.line)
    bodies: dict[str, dict[tuple[str, str], int]] = {}
    types: set[str] = set()
    for column, (kind, of, name) in _described(file, labels, axes).items():
        types.add(of)
        part = (kind, named[column])
        if of == "Rigid Body" and part in PARTS:
            if part in bodies.setdefault(name, {}):
                raise TracksError(file, f"two rigid bodies are called {name!r}", axes.line)
            bodies[name][part] = column
    if not bodies:
        got = ", ".join(sorted(types)) or "nothing"
        raise TracksError(
            file, f"holds no rigid body, but columns of: {got}; allowed: Rigid Body", axes.line
        )
    for name, parts in bodies.items():
        if missing := [" ".join(part) for part in PARTS if part not in parts]:
            raise TracksError(
                file,
                f"{name}: columns missing: {', '.join(missing)}; is its rotation exported as"
                " angles? allowed: Quaternion",
                axes.line,
            )
    found = {name: tuple(parts[part] for part in PARTS) for name, parts in bodies.items()}
    return Columns(named.index("Time (Seconds)"), found)


def _described(file: str, labels: Sequence[Row], axes: Row) -> dict[int, tuple[str, str, str]]:
    """Return (kind, type, name) of each column that has a kind.

    Time code, where it is exported, adds a column in front: none is counted, labels are looked for.
    """
    rows: dict[str, Sequence[str]] = {}
    for row in labels:
        cells = [cell.strip() for cell in row.cells]
        rows |= {name: cells for name in LABELS if name in cells[1:3]}
        if {"Rotation", "Position"} & {*cells}:
            rows["Rotation, Position"] = cells
    for name in ("Type", "Name", "Rotation, Position"):
        if name not in rows:
            raise TracksError(file, f"the header has no row of {name}", axes.line)
    kinds, types, names = (rows[name] for name in ("Rotation, Position", "Type", "Name"))
    return {
        column: (kinds[column], _cell(types, column), _cell(names, column))
        for column in range(2, min(len(kinds), len(axes.cells)))
        if kinds[column]
    }


def _cell(cells: Sequence[str], column: int) -> str:
    return cells[column] if column < len(cells) else ""


def _bodies(
    file: str, samples: Sequence[Row], columns: Columns, unit: float
) -> dict[str, BodyTrack]:
    """Read and check the frames."""
    lines = np.array([row.line for row in samples])
    head = numbers(file, samples, (0, columns.time), ("Frame", "Time (Seconds)"))
    if np.isnan(head).any():
        row = int(np.argmax(np.isnan(head).any(axis=1)))
        raise TracksError(file, "the frame's number or its time is blank", int(lines[row]))
    back = np.flatnonzero(np.diff(head[:, 0]) <= 0.0)
    if len(back):
        row = int(back[0]) + 1
        raise TracksError(
            file,
            f"frame {head[row, 0]:g} comes after frame {head[row - 1, 0]:g}; allowed: numbers that"
            " increase",
            int(lines[row]),
        )
    check_order(file, "Time (Seconds)", head[:, 1], lines)
    found: dict[str, BodyTrack] = {}
    for body, places in columns.bodies.items():
        names = [f"{body}, {' '.join(part)}" for part in PARTS]
        values = numbers(file, samples, places, names)
        found[body] = checked_track(
            file, body, head[:, 1], unit * values[:, :3], values[:, 3:], lines
        )
    return found
