"""Write tracks as a Motive export or as tidy CSV, and the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.outputs import check_file, whole_file
from trocar.robot.mocap.simulate import SimulatedTracks

Array = NDArray[np.float64]

Format = Literal["tidy", "motive"]
FORMATS = ("tidy", "motive")
TIDY_HEAD = "time_s,body,x_m,y_m,z_m,qw,qx,qy,qz"
#: Columns of a rigid body in a Motive export. Source: Motive documentation, format 1.23.
MOTIVE_COLUMNS = (
    ("Rotation", "X"), ("Rotation", "Y"), ("Rotation", "Z"), ("Rotation", "W"),
    ("Position", "X"), ("Position", "Y"), ("Position", "Z"), ("Mean Marker Error", ""),
)  # fmt: skip


def write_tracks(
    path: str | Path, tracks: SimulatedTracks, layout: Format = "tidy", *, overwrite: bool = False
) -> Path:
    """Write tracks, and the truth into a file of the same name with .truth.json at its end.

    Args:
        path: a new file
        tracks: from `simulate_tracks`
        layout: "tidy" keeps every digit, "motive" has six decimals as Motive has
        overwrite: replace files that exist

    Returns:
        the path of the truth

    Raises:
        InputError: another layout, or a path that exists or cannot be written
        TrocarError: the disk is full
    """
    if layout not in FORMATS:
        raise InputError(f"format: got {layout!r}; allowed: {', '.join(FORMATS)}")
    lines = _tidy(tracks) if layout == "tidy" else _motive(tracks, Path(path).stem)
    file, truth = check_tracks(path, overwrite)
    for target, text in ((file, "\n".join(lines)), (truth, json.dumps(tracks.truth, indent=2))):
        with whole_file(target, overwrite) as part:
            part.write_text(text + "\n", encoding="utf-8", newline="")
    return truth


def check_tracks(path: str | Path, overwrite: bool = False) -> tuple[Path, Path]:
    """Return the paths of tracks and their truth, before anything is simulated for them.

    Raises:
        InputError: one of them exists (without `overwrite`) or cannot be written
    """
    file = check_file(path, overwrite)
    return file, check_file(f"{file}.truth.json", overwrite)


def _columns(pose: Array) -> tuple[Array, Array, Array]:
    """Return a mask of tracked samples (n,), positions (n, 3) and quaternions wxyz (n, 4)."""
    seen = ~np.isnan(pose[:, 0, 0])
    turned = np.full((len(pose), 4), np.nan)
    turned[seen] = quaternion_from_matrix(pose[seen, :3, :3])
    return seen, pose[:, :3, 3], turned


def _tidy(tracks: SimulatedTracks) -> Iterator[str]:
    yield TIDY_HEAD
    stacked = {body: np.hstack(_columns(pose)[1:]) for body, pose in tracks.poses.items()}
    rows = {body: values.tolist() for body, values in stacked.items()}
    for index, time in enumerate(tracks.times.tolist()):
        for body, values in rows.items():
            row = values[index]
            cells = ",,,,,," if row[0] != row[0] else ",".join(map(repr, row))
            yield f"{time!r},{body},{cells}"


def _motive(tracks: SimulatedTracks, take: str) -> Iterator[str]:
    """Yield the lines of an export of format 1.23; the error of a simulated cluster is 0."""
    rate, count, bodies = tracks.rate_hz, len(tracks.times), list(tracks.poses)
    yield (
        f"Format Version,1.23,Take Name,{take.replace(',', ' ')},Take Notes,,Capture Frame Rate,"
        f"{rate:.6f},Export Frame Rate,{rate:.6f},Capture Start Time,2000-01-01 12.00.00.000 AM,"
        f"Total Frames in Take,{count},Total Exported Frames,{count},Rotation Type,Quaternion,"
        "Length Units,Meters,Coordinate Space,Global"
    )
    yield ""
    each = [(body, f'"{0xA0 + number:X}"') for number, body in enumerate(bodies)]
    width = len(MOTIVE_COLUMNS)
    yield ",Type," + ",".join(["Rigid Body"] * (width * len(bodies)))
    yield ",Name," + ",".join(body for body, _ in each for _ in range(width))
    yield ",ID," + ",".join(code for _, code in each for _ in range(width))
    yield ",," + ",".join(kind for _ in bodies for kind, _ in MOTIVE_COLUMNS)
    yield "Frame,Time (Seconds)," + ",".join(axis for _ in bodies for _, axis in MOTIVE_COLUMNS)
    columns = [_columns(pose) for pose in tracks.poses.values()]
    pieces = [
        np.hstack([turned[:, [1, 2, 3, 0]], place]).tolist() for _, place, turned in columns
    ]  # fmt: skip
    for index, time in enumerate(tracks.times.tolist()):
        cells = [
            7 * "," if piece[index][0] != piece[index][0] else
            ",".join([*(f"{value:.6f}" for value in piece[index]), "0.000000"])
            for piece in pieces
        ]  # fmt: skip
        yield f"{index},{time:.6f},{','.join(cells)}"
