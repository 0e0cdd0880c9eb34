"""The tidy format: time_s,body,x_m,y_m,z_m,qw,qx,qy,qz; a row for each body and sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from trocar.apps.calibration.cells import BodyTrack, Row, checked_track, numbers
from trocar.errors import TracksError

COLUMNS = ("time_s", "body", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
NUMBERS = tuple(name for name in COLUMNS if name != "body")


def is_tidy(head: Sequence[str]) -> bool:
    """Tell whether the cells of a first line are meant as this format's."""
    return {"body", "time_s"} <= {cell.strip().lower() for cell in head}


def read_tidy(file: str, rows: Sequence[Row]) -> Mapping[str, BodyTrack]:
    """Read the lines of a tidy file, columns in any order, others passed over.

    Args:
        file: for the errors
        rows: every line that is not empty, the header first

    Raises:
        TracksError: naming the line, what was got and what is allowed
    """
    head = [cell.strip().lower() for cell in rows[0].cells]
    missing = [name for name in COLUMNS if name not in head]
    if missing:
        raise TracksError(
            file,
            f"columns missing: {', '.join(missing)}; found: {', '.join(head)}; allowed:"
            f" {','.join(COLUMNS)} (metres, seconds, quaternions with the scalar first)",
            rows[0].line,
        )
    rows = rows[1:]
    if not rows:
        raise TracksError(file, "has a header and no rows")
    values = numbers(file, rows, [head.index(name) for name in NUMBERS], NUMBERS)
    lines = np.array([row.line for row in rows])
    return {
        body: checked_track(
            file, body, values[at, 0], values[at, 1:4], values[at, 4:8], lines[at]
        )
        for body, at in _rows_of_bodies(file, rows, head.index("body")).items()
    }  # fmt: skip


def _rows_of_bodies(file: str, rows: Sequence[Row], column: int) -> dict[str, list[int]]:
    """Return which rows are each body's, in the order in which bodies are met."""
    found: dict[str, list[int]] = {}
    for index, row in enumerate(rows):
        body = row.cells[column].strip() if len(row.cells) > column else ""
        if not body:
            raise TracksError(file, "body: is blank; allowed: the name of a body", row.line)
        found.setdefault(body, []).append(index)
    return found
