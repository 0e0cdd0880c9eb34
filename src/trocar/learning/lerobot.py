"""Datasets in LeRobot's format, v3.0: written and read by pyarrow alone, videos by ffmpeg.

Source of the layout: lerobot 0.4.4, `lerobot.datasets.utils` and `lerobot.datasets.compute_stats`.
"""

from __future__ import annotations

import itertools
import json
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError, LogError, MissingExtraError, UnknownNameError
from trocar.learning.films import Film
from trocar.rendering.film import join_videos, read_video

Array = NDArray[np.float64]
Row = Mapping[str, Any]

#: Version that is written; versions that are read: v2 has a file for each episode.
VERSION, READABLE = "v3.0", ("v2.0", "v2.1", "v3.0")
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
INFO, STATS, TASKS = "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
TASKS_V2 = "meta/tasks.jsonl"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
#: Files of a chunk; sizes after which a file of data or of videos ends [MB]. Source: lerobot.
CHUNK, DATA_MB, VIDEO_MB = 1000, 100, 200
#: Columns that each dataset has, of one number each.
INDEXES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
#: Quantiles of a column in its statistics [%]. Source: lerobot's own.
QUANTILES = (1, 10, 50, 90, 99)
#: Errors of pyarrow and Python for damaged files.
DAMAGED = (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError)


@dataclass(frozen=True)
class Feature:
    """A column: numbers of each frame.

    Attributes:
        names: of the numbers, with the unit at the end where they have one: "PSM1.yaw_rad"
        dtype: "float32", "int64" or "bool"
        frame: that positions are in, "world" or "" without
    """

    names: tuple[str, ...]
    dtype: str = "float32"
    frame: str = ""

    def document(self) -> dict[str, Any]:
        """Return the entry of `info.json`."""
        more = {"frame": self.frame} if self.frame else {}
        return {"dtype": self.dtype, "shape": [len(self.names)], "names": [*self.names], **more}


class DatasetWriter:
    """Writes a dataset episode by episode; a context manager, which closes it.

    What was added is kept in memory up to 100 MB (images: in a temporary folder), and written at
    the end, which an interruption does not skip.

    Args:
        root: an empty folder
        rate_hz: frames a second, a whole number
        features: {column: its feature}
        robot: its type
        cameras: {column of images: width and height [px]}

    Raises:
        MissingExtraError: the extra `learn` is not installed
    """

    def __init__(
        self,
        root: Path,
        rate_hz: int,
        features: Mapping[str, Feature],
        robot: str,
        cameras: Mapping[str, tuple[int, int]] | None = None,
    ) -> None:
        self._arrow, self._parquet = pyarrow("writing a dataset")
        self.root, self.rate_hz, self.robot = root, rate_hz, robot
        self.features, self.cameras = dict(features), dict(cameras or {})
        self._rows: list[dict[str, Any]] = []
        self._tasks: list[str] = []
        #: Episodes that no file has yet: row, table, films.
        self._pending: list[tuple[dict[str, Any], Any, Mapping[str, Film]]] = []
        self._files = 0
        self.frames = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.episodes:
            self.close()

    @property
    def episodes(self) -> int:
        """Number of episodes that were added."""
        return len(self._rows) + len(self._pending)

    def add(
        self,
        columns: Mapping[str, ArrayLike],
        task: str,
        films: Mapping[str, Film] | None = None,
        **about: object,
    ) -> None:
        """Add an episode.

        Args:
            columns: {column: (n, d), or (n,) of one number}
            task: in words
            films: {column of images: film of n images}
            about: further entries of the table of episodes

        Raises:
            InputError: other columns than the dataset's, or of other lengths
        """
        values = {name: np.asarray(column) for name, column in columns.items()}
        films = films or {}
        count = len(next(iter(values.values())))
        self._check(values, films, count)
        number, tasks = self.episodes, [*dict.fromkeys([*self._tasks, task])]
        index = {
            "timestamp": np.arange(count) / self.rate_hz,
            "frame_index": np.arange(count),
            "episode_index": np.full(count, number),
            "index": self.frames + np.arange(count),
            "task_index": np.full(count, tasks.index(task)),
        }
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [task],
            "length": count,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + count,
            **about,
        }
        for name, column in (*values.items(), *index.items()):
            for key, value in _statistics(np.asarray(column, np.float64)).items():
                row[f"stats/{name}/{key}"] = value
        for name, film in films.items():
            for key, value in _film_statistics(film).items():
                row[f"stats/{name}/{key}"] = value
        table = self._table({**values, **index})
        self._tasks, self.frames = tasks, self.frames + count
        self._pending.append((row, table, films))
        size = sum(table.nbytes for _, table, _ in self._pending)
        filmed = (len(film.mp4) for _, _, films in self._pending for film in films.values())
        if size > 1e6 * DATA_MB or sum(filmed) > 1e6 * VIDEO_MB:
            self._write_files()

    def close(self) -> None:
        """Write what no file has yet, the tables and the statistics.

        Raises:
            InputError: there is no episode
        """
        if not self.episodes:
            raise InputError(f"{self.root}: got no episode; allowed: one or more")
        self._write_files()
        meta = {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        self._write(EPISODES, self._arrow.Table.from_pylist([row | meta for row in self._rows]))
        self._write(TASKS, self._task_table())
        _write_json(self.root / STATS, _pooled(self._rows))
        _write_json(self.root / INFO, self._info())

    # ------------------------------------------------------------------ inside

    def _check(self, values: Mapping[str, Any], films: Mapping[str, Film], count: int) -> None:
        for kind, got, known in (
            ("columns", set(values), set(self.features)),
            ("images", set(films), set(self.cameras)),
        ):
            if got != known:
                names = ", ".join(sorted(got)) or "none"
                raise InputError(
                    f"{kind}: got {names}; allowed: {', '.join(sorted(known)) or 'none'}"
                )
        for name, column in values.items():
            size = len(self.features[name].names)
            if column.shape not in ((count, size), *([(count,)] if size == 1 else [])):
                raise InputError(f"{name}: got {column.shape}; allowed: {(count, size)}")
        for name, film in films.items():
            if (film.count, film.size) != (count, self.cameras[name]):
                raise InputError(
                    f"{name}: got {film.count} images of {film.size}; allowed: {count} of"
                    f" {self.cameras[name]}"
                )

    def _table(self, values: Mapping[str, NDArray[Any]]) -> Any:
        """Return the rows of an episode in Arrow's types."""
        arrow, columns = self._arrow, dict[str, Any]()
        for name, column in values.items():
            feature = self.features.get(name, _index_feature(name))
            kind = {"float32": arrow.float32(), "int64": arrow.int64(), "bool": arrow.bool_()}
            flat = arrow.array(column.ravel(), kind[feature.dtype])
            size = len(feature.names)
            one = size == 1
            columns[name] = flat if one else arrow.FixedSizeListArray.from_arrays(flat, size)
        return arrow.table(columns)

    def _write_files(self) -> None:
        """Write one file of data and one of each camera with the episodes that no file has."""
        if not self._pending:
            return
        place = {"chunk_index": self._files // CHUNK, "file_index": self._files % CHUNK}
        rows = [row | {f"data/{key}": n for key, n in place.items()} for row, _, _ in self._pending]
        path = self._path(DATA.format(**place))
        tables = [table for _, table, _ in self._pending]
        with self._parquet.ParquetWriter(path, tables[0].schema, compression="snappy") as writer:
            for table in tables:
                writer.write_table(table)
        for name in self.cameras:
            path = self._path(VIDEO.format(video_key=name, **place))
            path.unlink(missing_ok=True)
            _join([films[name] for _, _, films in self._pending], path)
            first = 0
            for row in rows:
                row |= {f"videos/{name}/{key}": n for key, n in place.items()}
                last = first + row["length"]
                row[f"videos/{name}/from_timestamp"] = first / self.rate_hz
                row[f"videos/{name}/to_timestamp"] = last / self.rate_hz
                first = last
        self._files += 1
        self._rows, self._pending = [*self._rows, *rows], []

    def _task_table(self) -> Any:
        """Return the table of tasks, whose index, as pandas has it, is a task in words."""
        arrow, index = self._arrow, "__index_level_0__"
        number = {"name": "task_index", "field_name": "task_index", "metadata": None}
        number |= {"pandas_type": "int64", "numpy_type": "int64"}
        words = {"name": None, "field_name": index, "metadata": None}
        words |= {"pandas_type": "unicode", "numpy_type": "object"}
        about = {"index_columns": [index], "column_indexes": [], "columns": [number, words]}
        about |= {"creator": {"library": "pyarrow", "version": arrow.__version__}}
        about |= {"pandas_version": "2.3.0"}
        numbers = arrow.array(range(len(self._tasks)), arrow.int64())
        table = arrow.table({"task_index": numbers, index: arrow.array(self._tasks)})
        return table.replace_schema_metadata({b"pandas": json.dumps(about).encode()})

    def _info(self) -> dict[str, Any]:
        features = {name: one.document() for name, one in self.features.items()}
        for name, (width, height) in self.cameras.items():
            features[name] = {
                "dtype": "video",
                "shape": [height, width, 3],
                "names": ["height", "width", "channels"],
                "info": {
                    "video.height": height,
                    "video.width": width,
                    "video.codec": "h264",
                    "video.pix_fmt": "yuv420p",
                    "video.is_depth_map": False,
                    "video.fps": self.rate_hz,
                    "video.channels": 3,
                    "has_audio": False,
                },
            }
        features |= {name: _index_feature(name).document() | {"names": None} for name in INDEXES}
        return {
            "codebase_version": VERSION,
            "robot_type": self.robot,
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": self.rate_hz,
            "splits": {"train": f"0:{self.episodes}"},
            "data_path": DATA,
            "video_path": VIDEO if self.cameras else None,
            "features": features,
        }

    def _path(self, name: str) -> Path:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def _write(self, name: str, table: Any) -> None:
        self._parquet.write_table(table, self._path(name), compression="snappy")


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset on disk; made by `open_dataset`.

    Attributes:
        root: its folder
        rate_hz: frames a second
        robot: its type
        features: columns of numbers, the `INDEXES` left out
        cameras: {column of images: width and height [px]}
        episodes: their rows in the table of episodes, without statistics
        info: all of `info.json`
    """

    root: Path
    rate_hz: float
    robot: str
    features: Mapping[str, Feature]
    cameras: Mapping[str, tuple[int, int]]
    episodes: tuple[Row, ...]
    info: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.episodes)

    def rows(self, episode: int) -> dict[str, NDArray[Any]]:
        """Return the columns of an episode, (n, d) each, and the `INDEXES`, (n,) each.

        Raises:
            InputError: no such episode
            LogError: a torn file
        """
        row, path = self._row(episode), self.data_file(episode)
        names = [*self.features, *INDEXES]
        _, parquet = pyarrow("reading a dataset")
        try:
            key = ("episode_index", "=", row["episode_index"])
            table = parquet.read_table(path, columns=names, filters=[key])
            found = {name: _column(table[name]) for name in names}
        except DAMAGED as problem:
            raise _torn(path, problem) from problem
        if table.num_rows != row["length"]:
            raise LogError(
                str(path),
                f"got {table.num_rows} frames of episode {row['episode_index']}; expected"
                f" {row['length']} by the table of episodes",
            )
        for name, feature in self.features.items():
            found[name] = found[name].reshape(len(found[name]), -1)
            if found[name].shape[1] != len(feature.names):
                raise LogError(
                    str(path),
                    f"{name}: got {found[name].shape[1]} numbers; expected {len(feature.names)} by"
                    f" {INFO}",
                )
        return found

    def images(self, episode: int, camera: str) -> NDArray[np.uint8]:
        """Return the images of an episode, (n, h, w, 3).

        Raises:
            UnknownNameError: no such camera
            InputError: no such episode
            LogError: a torn file
        """
        row = self._row(episode)
        if camera not in self.cameras:
            raise UnknownNameError("camera", camera, self.cameras, str(self.root))
        # half a period earlier, as times of images are rounded
        start_s = row.get(f"videos/{camera}/from_timestamp", 0.0) - 0.5 / self.rate_hz
        path, count = self.video_file(episode, camera), int(row["length"])
        images = [*itertools.islice(read_video(path, start_s), count)]
        if len(images) != count:
            raise LogError(
                str(path),
                f"got {len(images)} images of episode {row['episode_index']}; expected {count} by"
                " the table of episodes",
            )
        return np.stack(images)

    def data_file(self, episode: int) -> Path:
        """Return the path of the file with an episode's numbers."""
        return self._file(self.info["data_path"], self._row(episode), "data")

    def video_file(self, episode: int, camera: str) -> Path:
        """Return the path of the file with an episode's images."""
        row = self._row(episode)
        return self._file(self.info["video_path"], row, f"videos/{camera}", camera)

    @cached_property
    def one_file_each(self) -> bool:
        """Whether each episode has a file of its own, as in version 2."""
        return str(self.info["codebase_version"]).startswith("v2")

    def _file(self, template: str, row: Row, group: str, camera: str = "") -> Path:
        number = int(row["episode_index"])
        place = {"episode_index": number, "episode_chunk": number // self.info["chunks_size"]}
        if not self.one_file_each:
            place = {key: int(row[f"{group}/{key}"]) for key in ("chunk_index", "file_index")}
        return self.root / template.format(video_key=camera, **place)

    def _row(self, episode: int) -> Row:
        if not 0 <= episode < len(self.episodes):
            raise InputError(
                f"{self.root}: episode: got {episode}; allowed: 0 to {len(self.episodes) - 1}"
            )
        return self.episodes[episode]


def open_dataset(root: str | Path) -> Dataset:
    """Open a dataset of LeRobot's, v3.0 or v2, and check that none of its files is missing or torn.

    Raises:
        LogError: no dataset, one of another version, or a torn one; the file is named
        MissingExtraError: the extra `learn` is not installed
    """
    where = Path(root).expanduser()
    _, parquet = pyarrow("reading a dataset")
    info = _read_json(where / INFO)
    try:
        version = info["codebase_version"]
        if version not in READABLE:
            allowed = ", ".join(READABLE)
            raise LogError(str(where / INFO), f"got version {version!r}; allowed: {allowed}")
        features, cameras = _features(info["features"])
        rows = tuple(_episode_rows(where, version))
        found = Dataset(
            where, float(info["fps"]), str(info["robot_type"]), features, cameras, rows, info
        )
        totals = {"total_episodes": len(rows), "total_frames": sum(r["length"] for r in rows)}
        for key, count in totals.items():
            if info[key] != count:
                raise LogError(
                    str(where / INFO), f"{key}: got {info[key]}; the table of episodes has {count}"
                )
        lengths: dict[Path, int] = {}
        for number, row in enumerate(rows):
            path = found.data_file(number)
            lengths[path] = lengths.get(path, 0) + row["length"]
        films = {found.video_file(n, camera) for n in range(len(rows)) for camera in cameras}
    except (KeyError, TypeError, ValueError, AttributeError) as problem:
        if isinstance(problem, LogError):
            raise
        raise _torn(where / INFO, problem) from problem
    if total := info.get("total_tasks", 0):
        _check_tasks(where / (TASKS_V2 if found.one_file_each else TASKS), total, parquet)
    for path, length in lengths.items():
        _check_data(path, length, [*features, *INDEXES], parquet)
    for path in sorted(films):
        if not path.is_file():
            raise LogError(str(path), "no such file; the table of episodes has images in it")
    return found


def pyarrow(purpose: str) -> tuple[Any, Any]:
    """Import pyarrow and its module of Parquet.

    Raises:
        MissingExtraError: it is not installed; the error names `purpose`
    """
    try:
        import pyarrow as arrow  # pyright: ignore[reportMissingTypeStubs] - it has no types
        from pyarrow import parquet  # pyright: ignore[reportMissingTypeStubs] - it has no types
    except ImportError as error:
        raise MissingExtraError("pyarrow", "learn", purpose) from error
    return cast(Any, arrow), cast(Any, parquet)


# ------------------------------------------------------------------ writing


def _index_feature(name: str) -> Feature:
    return Feature((name,), "float32" if name == "timestamp" else "int64")


def _statistics(values: Array) -> dict[str, Any]:
    """Return the statistics of a column's numbers, a list each."""
    table = values.reshape(len(values), -1)
    quantiles = np.quantile(table, np.array(QUANTILES) / 100.0, axis=0)
    return {
        "min": table.min(axis=0).tolist(),
        "max": table.max(axis=0).tolist(),
        "mean": table.mean(axis=0).tolist(),
        "std": table.std(axis=0).tolist(),
        "count": [len(table)],
        **{f"q{p:02d}": row.tolist() for p, row in zip(QUANTILES, quantiles, strict=True)},
    }


def _film_statistics(film: Film) -> dict[str, Any]:
    """Return the statistics of images, (3, 1, 1) each."""
    found = {"min": film.low, "max": film.high, "mean": film.mean, "std": film.std}
    shaped = {key: value.reshape(3, 1, 1).tolist() for key, value in found.items()}
    return {**shaped, "count": [film.count]}


def _pooled(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return statistics over all episodes; quantiles are means of theirs, as lerobot's."""
    found: dict[str, dict[str, Any]] = {}
    for key in rows[0]:
        _, _, rest = key.partition("stats/")
        name, _, kind = rest.rpartition("/")
        if not name:
            continue
        values = np.array([row[key] for row in rows], np.float64)
        counts = np.array([row[f"stats/{name}/count"][0] for row in rows], np.float64)
        weights = (counts / counts.sum()).reshape(-1, *(1,) * (values.ndim - 1))
        if kind in ("min", "max"):
            pooled = values.min(axis=0) if kind == "min" else values.max(axis=0)
        elif kind == "count":
            pooled = values.sum(axis=0).astype(np.int64)
        elif kind == "std":
            means = np.array([row[f"stats/{name}/mean"] for row in rows], np.float64)
            middle = (weights * means).sum(axis=0)
            pooled = np.sqrt((weights * (values**2 + (means - middle) ** 2)).sum(axis=0))
        else:
            pooled = (weights * values).sum(axis=0)
        found.setdefault(name, {})[kind] = pooled.tolist()
    return found


def _join(films: Iterable[Film], path: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="trocar-") as folder:
        parts: list[Path] = []
        for number, film in enumerate(films):
            parts.append(Path(folder) / f"{number}.mp4")
            parts[-1].write_bytes(film.mp4)
        join_videos(parts, path)


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")


# ------------------------------------------------------------------ reading


def _read_json(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise LogError(str(path), "no such file; allowed: a dataset of LeRobot's, its folder")
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as problem:
        raise _torn(path, problem) from problem
    if not isinstance(found, dict):
        raise LogError(str(path), "is no JSON object")
    return cast(dict[str, Any], found)


def _features(entries: Mapping[str, Any]) -> tuple[dict[str, Feature], dict[str, tuple[int, int]]]:
    """Return the columns of numbers, and the sizes of the columns of images."""
    features: dict[str, Feature] = {}
    cameras: dict[str, tuple[int, int]] = {}
    for name, entry in entries.items():
        shape = [int(side) for side in entry["shape"]]
        if entry["dtype"] == "video":
            cameras[name] = shape[1], shape[0]
        elif entry["dtype"] not in ("string", "image") and name not in INDEXES:
            size = int(np.prod(shape))
            names = tuple(_names(entry.get("names")))
            numbered = tuple(f"{name}[{k}]" for k in range(size)) if size > 1 else (name,)
            features[name] = Feature(
                names if len(names) == size else numbered,
                str(entry["dtype"]),
                str(entry.get("frame", "")),
            )
    return features, cameras


def _names(value: Any) -> Iterator[str]:
    """Yield names, which datasets have in lists, nested at will, or in dictionaries."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, list | dict):
        inner = cast(Any, value)
        for one in inner.values() if isinstance(value, dict) else inner:
            yield from _names(one)


def _episode_rows(root: Path, version: str) -> Iterator[Row]:
    """Yield the rows of the table of episodes, without statistics."""
    if version.startswith("v2"):
        path = root / "meta" / "episodes.jsonl"
        if not path.is_file():
            raise LogError(str(path), "no such file")
        try:
            for line in path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                yield {**row, "length": int(row["length"])}
        except DAMAGED as problem:
            raise _torn(path, problem) from problem
        return
    _, parquet = pyarrow("reading a dataset")
    paths = sorted((root / "meta" / "episodes").glob("*/*.parquet"))
    if not paths:
        raise LogError(str(root / EPISODES), "no such file")
    for path in paths:
        try:
            names = [n for n in parquet.read_schema(path).names if not n.startswith("stats/")]
            yield from parquet.read_table(path, columns=names).to_pylist()
        except DAMAGED as problem:
            raise _torn(path, problem) from problem


def _check_tasks(path: Path, total: object, parquet: Any) -> None:
    """Reject a table of tasks that is missing, damaged or of another length.

    The rows of episodes have their tasks in words, too; LeRobot's own reader needs the table.
    """
    if not path.is_file():
        raise LogError(str(path), f"no such file; {INFO} has {total} tasks in it")
    try:
        if path.suffix == ".jsonl":
            lines = path.read_text(encoding="utf-8").splitlines()
            count = len([json.loads(line)["task"] for line in lines if line.strip()])
        else:
            count = parquet.read_table(path).num_rows
    except DAMAGED as problem:
        raise _torn(path, problem) from problem
    if count != total:
        raise LogError(str(path), f"got {count} tasks; expected {total} by {INFO}")


def _check_data(path: Path, length: int, names: Sequence[str], parquet: Any) -> None:
    """Reject a file of numbers that is missing, damaged or of another length."""
    if not path.is_file():
        raise LogError(str(path), "no such file; the table of episodes has frames in it")
    try:
        about = parquet.read_metadata(path)
        columns = set(parquet.read_schema(path).names)
    except DAMAGED as problem:
        raise _torn(path, problem) from problem
    if about.num_rows != length:
        raise LogError(
            str(path), f"got {about.num_rows} frames; expected {length} by the table of episodes"
        )
    if missing := [name for name in names if name not in columns]:
        raise LogError(str(path), f"lacks the columns {', '.join(missing)}, which {INFO} lists")


def _column(column: Any) -> NDArray[Any]:
    """Return a column of Arrow's as an array, (n,) or (n, d)."""
    whole = column.combine_chunks()
    if not hasattr(whole, "flatten") or not hasattr(whole.type, "value_type"):
        return whole.to_numpy(zero_copy_only=False)
    return whole.flatten().to_numpy(zero_copy_only=False).reshape(len(whole), -1)


def _torn(path: Path, problem: Exception) -> LogError:
    text = " ".join(str(problem).split())[:200]
    return LogError(str(path), f"is torn or no part of a dataset: {text or repr(problem)}")
