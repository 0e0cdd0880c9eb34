"""Parquet files as tables of numbers, alone or in a dataset of LeRobot's."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, LogError, MissingExtraError
from trocar.robot.recordings.tables import NumberTable

INFO = "meta/info.json"
MAGIC = b"PAR1"
EPISODE, STAMP = "episode_index", "timestamp"


def is_parquet(path: str | Path) -> bool:
    """Return whether a path is a Parquet file or a dataset of LeRobot's."""
    where = Path(path).expanduser()
    if where.is_dir():
        return (where / INFO).is_file()
    if not where.is_file():
        return False
    with where.open("rb") as stream:
        return stream.read(4) == MAGIC


def read_parquet(path: str | Path, episode: int | None = None) -> NumberTable:
    """Read an episode of a dataset, or a Parquet file.

    Columns of several numbers become one column each, "observation.state yaw" with the names of
    `meta/info.json`, "observation.state[0]" without.

    Args:
        path: a dataset's folder, or a file in it or alone
        episode: its number, where there are several

    Raises:
        LogError: a damaged file, or no such episode
        InputError: several episodes, and none is selected
        MissingExtraError: pyarrow is not installed
    """
    try:
        from pyarrow import parquet as library  # pyright: ignore[reportMissingTypeStubs]  no types
    except ImportError as error:
        raise MissingExtraError("pyarrow", "learn", "reading a Parquet file") from error
    where, file = Path(path).expanduser(), str(path)
    files = sorted((where / "data").rglob("*.parquet")) if where.is_dir() else [where]
    root = where if where.is_dir() else _root(where)
    if not files:
        raise LogError(file, "contains no Parquet file in data/")
    named = _names(root) if root else {}
    tables: list[dict[str, NDArray[Any]]] = []
    for one in files:
        try:
            read: Any = cast(Any, library).read_table(one)
            tables.append({n: _numbers(read.column(n)) for n in read.column_names})
        except (OSError, ValueError, TypeError, KeyError) as problem:
            raise LogError(str(one), f"cannot be read as Parquet: {problem}") from problem
    kept = [name for name in tables[0] if all(name in table for table in tables)]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in kept}
    chosen = _rows_of(file, columns, episode)
    names: list[str] = []
    values: list[NDArray[np.float64]] = []
    for name, table in columns.items():
        if table.ndim == 1:
            names.append(name)
            values.append(table[chosen])
            continue
        width = table.shape[1]
        inner = named.get(name, ())
        fitting = len(inner) == width
        names += [f"{name} {inner[k]}" if fitting else f"{name}[{k}]" for k in range(width)]
        values += list(table[chosen].T)
    table = np.column_stack(values).astype(np.float64)
    return NumberTable(file, tuple(names), table, np.arange(1, len(table) + 1))


def _rows_of(
    file: str, columns: Mapping[str, NDArray[Any]], episode: int | None
) -> NDArray[np.bool_]:
    """Find the rows of an episode."""
    numbers = columns.get(EPISODE)
    count = len(next(iter(columns.values())))
    if numbers is None:
        return np.ones(count, np.bool_)
    known = np.unique(numbers.astype(int)).tolist()
    if episode is None:
        if len(known) > 1:
            raise InputError(
                f"{file}: holds {len(known)} episodes, {known[0]} to {known[-1]}; select one with"
                " --episode"
            )
        episode = known[0]
    if episode not in known:
        raise LogError(file, f"has no episode {episode}; allowed: {known[0]} to {known[-1]}")
    return np.asarray(numbers == episode, np.bool_)


def _numbers(column: Any) -> NDArray[Any]:
    """Return a column's numbers, (k,) or (k, n); NaN where it holds something else."""
    values: Any = column.to_numpy()
    if values.dtype == object:
        try:
            return np.array([np.asarray(row, np.float64).ravel() for row in values], np.float64)
        except (TypeError, ValueError):
            return np.full(len(values), np.nan)
    if not np.issubdtype(values.dtype, np.number):
        return np.full(len(values), np.nan)
    return np.asarray(values, np.float64)


def _root(path: Path) -> Path | None:
    """Return the dataset that a file is in, None for a file alone."""
    return next((up for up in path.resolve().parents if (up / INFO).is_file()), None)


def _names(root: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of the numbers of each column, in meta/info.json."""
    try:
        features = json.loads((root / INFO).read_text(encoding="utf-8"))["features"]
        found: dict[str, tuple[str, ...]] = {}
        for name, one in features.items():
            names: Any = one.get("names")
            if isinstance(names, Mapping):  # v2.0: {"motors": [...]}
                inner = list(cast("Mapping[str, Any]", names).values())
                names = inner[0] if len(inner) == 1 else None
            if isinstance(names, list):
                found[name] = tuple(str(n) for n in cast("list[Any]", names))
        return found
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as problem:
        raise LogError(str(root / INFO), f"cannot be read: {problem}") from problem
