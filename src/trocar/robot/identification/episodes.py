"""Episodes of public datasets of a dVRK-Si with joint efforts: SurgSync, and its part of Open-H.

SurgSync has a folder for each episode with ECM.parquet, PSM1.parquet and PSM2.parquet: a row for
each image, `master_timestamp_ns`, lists `measured_js.position`, `.velocity` and `.effort` of the
joints, and `jaw.measured_position`. Open-H (Surgical/jhu/lcsr/smarts, LeRobot v2.1) has a file for
each episode: `timestamp`, and for each arm lists `observation.state.ARM.joint_position`,
`.joint_velocity`, `.joint_effort` and `.gripper`. All in SI units; 10 images a second.
Source: jackzhy96/dvrk_multimodal_data_collection@4e9db9e, src/dvrk_data_processing/surgsync/schema
and scripts/convert_open_h.py.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import LogError, MissingExtraError
from trocar.robot.recordings import recorded_joints
from trocar.robot.recordings.arm_motion import LONGEST_GAP_S

Array = NDArray[np.float64]

SURGSYNC_TIME, OPENH_TIME = "master_timestamp_ns", "timestamp"
QUANTITIES = ("position", "velocity", "effort")
#: First and last bytes of a Parquet file.
MAGIC = b"PAR1"


def is_episode(path: str | Path) -> bool:
    """Return whether a path is a Parquet file, or a folder that has some."""
    where = Path(path).expanduser()
    if where.is_dir():
        return any(where.glob("*.parquet"))
    if not where.is_file():
        return False
    with where.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def episode_arms(path: str | Path) -> tuple[str, ...]:
    """Return the names of the arms whose joint states an episode has.

    Raises:
        LogError: none
        MissingExtraError: pyarrow is not installed
    """
    where = Path(path).expanduser()
    files = sorted(where.glob("*.parquet")) if where.is_dir() else [where]
    found = [name for file in files for name in _arms_of(file)]
    if not found:
        raise LogError(
            str(path),
            "has no joint states; allowed: an episode of SurgSync (columns measured_js.position,"
            " ...) or of Open-H (observation.state.ARM.joint_position, ...)",
        )
    return tuple(found)


def episode_rows(path: str | Path, arm: ArmDescription, name: str = "") -> tuple[Array, float]:
    """Read an arm's longest stretch without a gap at even times.

    Velocities of the jaw are differences of its positions; it has no efforts, which are 0 here.

    Args:
        path: the episode's file or folder
        arm: the recorded arm, with the tool that was mounted
        name: of the arm: "PSM1"; "" for the only one

    Returns:
        (k, 3, n) positions, velocities, efforts [rad or m, per s, N m or N], and their rate [Hz]

    Raises:
        LogError: no such arm, or not this arm's joints
        MissingExtraError: pyarrow is not installed
    """
    where, names = Path(path).expanduser(), episode_arms(path)
    chosen = name or names[0]
    if chosen not in names or (not name and len(names) > 1):
        raise LogError(
            str(path),
            f"has joint states of {', '.join(names)}; allowed: one of them"
            f" (got {name or 'none'}: name a rig and the arm)",
        )
    file = where / f"{chosen}.parquet" if where.is_dir() else where
    if where.is_dir() and not file.is_file():
        file = next(one for one in sorted(where.glob("*.parquet")) if chosen in _arms_of(one))
    table = _table(file)
    surgsync = SURGSYNC_TIME in table.column_names
    prefix = "measured_js." if surgsync else f"observation.state.{chosen.lower()}.joint_"
    jaw = "jaw.measured_position" if surgsync else f"observation.state.{chosen.lower()}.gripper"
    joints = recorded_joints(arm)
    own = joints[: len(joints) - arm.has_jaw]
    parts = [_column(table, file, prefix + quantity, len(own)) for quantity in QUANTITIES]
    time = _column(table, file, SURGSYNC_TIME if surgsync else OPENH_TIME, 0)
    time = time[:, 0] * (1e-9 if surgsync else 1.0)
    rows = np.zeros((len(time), 3, len(joints)))
    rows[:, :, : len(own)] = np.stack(parts, axis=1)
    if arm.has_jaw and jaw in table.column_names:
        rows[:, 0, -1] = _column(table, file, jaw, 1)[:, 0]
    whole = np.isfinite(rows).all(axis=(1, 2))
    time, rows = time[whole], rows[whole]
    if len(time) < 2 or not (np.diff(time) > 0.0).all():
        raise LogError(str(file), f"got {len(time)} samples; allowed: 2 or more in order of time")
    first, last = _longest(time)
    time, rows = time[first:last], rows[first:last]
    rate = 1.0 / float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 1e-6, 1.0 / rate)
    flat = rows.reshape(len(rows), -1)
    found = np.stack([np.interp(even, time, column) for column in flat.T], axis=1)
    found = found.reshape(len(even), *rows.shape[1:])
    if arm.has_jaw:
        found[:, 1, -1] = np.gradient(found[:, 0, -1], 1.0 / rate)
    return found, rate


def _longest(time: Array) -> tuple[int, int]:
    """Return the first sample of the longest stretch without a gap, and the one after its last."""
    ends = [0, *(np.flatnonzero(np.diff(time) > LONGEST_GAP_S) + 1).tolist(), len(time)]
    return max(pairwise(ends), key=lambda two: time[two[1] - 1] - time[two[0]])


def _arms_of(file: Path) -> list[str]:
    """Return the names of the arms in a file."""
    try:
        names: list[str] = _parquet().read_schema(file).names
    except (OSError, ValueError) as problem:  # pyarrow's errors are of both
        raise LogError(str(file), f"cannot be read: {problem}") from problem
    if SURGSYNC_TIME in names and "measured_js.position" in names:
        return [file.stem]
    parts = [name.split(".") for name in names if name.startswith("observation.state.")]
    return [part[2].upper() for part in parts if part[3:] == ["joint_position"]]


def _table(file: Path) -> Any:
    try:
        return _parquet().read_table(file)
    except (OSError, ValueError) as problem:  # pyarrow's errors are of both
        raise LogError(str(file), f"cannot be read: {problem}") from problem


def _column(table: Any, file: Path, name: str, size: int) -> Array:
    """Return a column of numbers or of lists of a size, (k, max(size, 1)), NaN where null."""
    if name not in table.column_names:
        raise LogError(
            str(file), f"lacks column {name}; allowed: joint positions, velocities and efforts"
        )
    width = max(size, 1)
    rows: list[list[float]] = []
    for number, value in enumerate(cast("list[Any]", table.column(name).to_pylist()), 1):
        numbers = cast("list[float | None]", value if isinstance(value, list) else [value])
        if value is None or not numbers:
            numbers = [None] * width
        if len(numbers) != width:
            raise LogError(
                str(file),
                f"{name}: got {len(numbers)} numbers; allowed: {width} (another arm?)",
                number,
            )
        rows.append([np.nan if one is None else float(one) for one in numbers])
    return np.array(rows).reshape(len(rows), width)


def _parquet() -> Any:
    try:
        from pyarrow import parquet  # pyright: ignore[reportMissingTypeStubs] - it has no types
    except ImportError as error:
        raise MissingExtraError("pyarrow", "learn", "reading an episode") from error
    return parquet
