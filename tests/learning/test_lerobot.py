"""Datasets of LeRobot: written ones are read back, torn ones are named."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.errors import InputError, LogError, UnknownNameError
from trocar.learning import lerobot
from trocar.learning.films import Film, FilmWriter
from trocar.learning.lerobot import DatasetWriter, Feature, open_dataset

pytest.importorskip("pyarrow", reason="the extra `learn` is not there")

FEATURES = {
    "observation.state": Feature(("PSM1.yaw_rad", "PSM1.insertion_m"), frame="world"),
    "action": Feature(("a", "b", "c")),
    "next.reward": Feature(("reward",)),
    "next.done": Feature(("done",), "bool"),
}
LENGTHS = (4, 7, 1, 5)
CAMERA = "observation.images.left"
Rows = dict[str, NDArray[Any]]


def columns(count: int, seed: int) -> Rows:
    rng = np.random.default_rng(seed)
    return {
        "observation.state": rng.normal(size=(count, 2)),
        "action": rng.normal(size=(count, 3)),
        "next.reward": rng.normal(size=count),
        "next.done": np.arange(count) == count - 1,
    }


def grey(episode: int, frame: int) -> int:
    return 30 + 40 * episode + 5 * frame


def film(episode: int, count: int) -> Film:
    with FilmWriter(50.0) as writer:
        for k in range(count):
            writer.add(np.full((16, 32, 3), grey(episode, k), np.uint8))
        return writer.film()


def write(root: Path, *, images: bool = False) -> list[Rows]:
    """Write a dataset, and return the columns of its episodes."""
    root.mkdir(exist_ok=True)
    added = [columns(count, k) for k, count in enumerate(LENGTHS)]
    with DatasetWriter(root, 50, FEATURES, "dvrk", {CAMERA: (32, 16)} if images else {}) as writer:
        for k, rows in enumerate(added):
            films = {CAMERA: film(k, LENGTHS[k])} if images else {}
            writer.add(rows, f"task {k % 2}", films, seed=10 + k)
    return added


@pytest.fixture
def root(tmp_path: Path) -> Path:
    write(tmp_path / "data")
    return tmp_path / "data"


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    root = tmp_path_factory.mktemp("filmed") / "data"
    write(root, images=True)
    return root


def check(root: Path, added: list[Rows]) -> None:
    """Check that a dataset has these columns, in single precision, and the indexes."""
    found = open_dataset(root)
    assert (len(found), found.rate_hz, found.features) == (len(added), 50.0, FEATURES)
    first = 0
    for k, rows in enumerate(added):
        read, count = found.rows(k), len(rows["action"])
        for name, values in rows.items():
            kept = values.astype(np.float32) if values.dtype == np.float64 else values
            assert np.array_equal(read[name], kept.reshape(count, -1)), name
        assert np.array_equal(read["index"], first + np.arange(count))
        assert np.array_equal(read["frame_index"], np.arange(count))
        assert np.array_equal(read["timestamp"], (np.arange(count) / 50.0).astype(np.float32))
        assert set(read["episode_index"]) == {k}
        assert set(read["task_index"]) == {k % 2}
        assert found.episodes[k]["tasks"] == [f"task {k % 2}"]
        assert found.episodes[k]["seed"] == 10 + k
        first += count


def test_episodes_are_read_as_they_were_written(tmp_path: Path) -> None:
    check(tmp_path, write(tmp_path))


def test_files_end_at_their_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lerobot, "DATA_MB", 1e-5)
    monkeypatch.setattr(lerobot, "CHUNK", 2)
    check(tmp_path, write(tmp_path))
    names = {str(p.relative_to(tmp_path)) for p in (tmp_path / "data").rglob("*.parquet")}
    assert names == {f"data/chunk-00{c}/file-00{f}.parquet" for c in (0, 1) for f in (0, 1)}


def test_images_are_those_of_their_episode(filmed: Path) -> None:
    found = open_dataset(filmed)
    assert found.cameras == {CAMERA: (32, 16)}
    for k in (2, 0, 3, 1):
        images = found.images(k, CAMERA)
        assert images.shape == (LENGTHS[k], 16, 32, 3)
        expected = [grey(k, frame) for frame in range(LENGTHS[k])]
        # H.264 keeps brightness in steps of 1/219; two frames differ by 5
        assert np.abs(images.mean(axis=(1, 2, 3)) - expected).max() < 2.5


def test_statistics_are_those_of_all_frames(filmed: Path) -> None:
    stats = json.loads((filmed / "meta/stats.json").read_text())
    parts = [columns(count, k) for k, count in enumerate(LENGTHS)]
    for name in FEATURES:
        count = sum(LENGTHS)
        values = np.concatenate([part[name] for part in parts]).reshape(count, -1).astype(float)
        for key, expected in (
            ("min", values.min(axis=0)),
            ("max", values.max(axis=0)),
            ("mean", values.mean(axis=0)),
            ("std", values.std(axis=0)),
            ("count", [count]),
        ):
            assert stats[name][key] == pytest.approx(expected), (name, key)
    greys = [grey(k, j) / 255.0 for k, count in enumerate(LENGTHS) for j in range(count)]
    assert np.shape(stats[CAMERA]["mean"]) == (3, 1, 1)
    assert np.ravel(stats[CAMERA]["std"]) == pytest.approx(np.full(3, np.std(greys)))


def test_the_error_of_an_episode_leaves_those_before(tmp_path: Path) -> None:
    rows = [columns(3, 0), columns(4, 1)]
    with suppress(KeyError), DatasetWriter(tmp_path, 50, FEATURES, "dvrk") as writer:
        for k, part in enumerate(rows):
            writer.add(part, f"task {k}", seed=10 + k)
        raise KeyError
    check(tmp_path, rows)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"action": np.zeros((4, 2))}, r"action: got \(4, 2\); allowed: \(4, 3\)"),
        ({"next.reward": np.zeros(3)}, r"next.reward: got \(3,\); allowed: \(4, 1\)"),
        ({"more": np.zeros(4)}, "columns: got action, more, .*; allowed: action, next.done"),
    ],
)
def test_other_columns_are_rejected(tmp_path: Path, changed: Rows, message: str) -> None:
    writer = DatasetWriter(tmp_path, 50, FEATURES, "dvrk")
    with pytest.raises(InputError, match=message):
        writer.add(columns(4, 0) | changed, "task")
    assert writer.episodes == 0


def test_an_empty_dataset_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="got no episode; allowed: one or more"):
        DatasetWriter(tmp_path, 50, FEATURES, "dvrk").close()
    assert not [*tmp_path.iterdir()]


# ------------------------------------------------------------------ torn datasets


def edit(name: str, change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def apply(root: Path) -> None:
        content = json.loads((root / name).read_text())
        change(content)
        (root / name).write_text(json.dumps(content))

    return apply


def cut(name: str, size: int) -> Callable[[Path], None]:
    def apply(root: Path) -> None:
        (root / name).write_bytes((root / name).read_bytes()[:size])

    return apply


def drop(name: str) -> Callable[[Path], None]:
    return lambda root: (root / name).unlink()


def shorten(name: str) -> Callable[[Path], None]:
    """Drop the last row of a table."""

    def apply(root: Path) -> None:
        from pyarrow import parquet

        table: Any = parquet.read_table(root / name)
        parquet.write_table(table.slice(0, table.num_rows - 1), root / name)

    return apply


INFO, DATA = "meta/info.json", "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TASKS = "meta/tasks.parquet"


@pytest.mark.parametrize(
    ("tear", "file", "problem"),
    [
        (drop(INFO), INFO, "no such file; allowed: a dataset of LeRobot's"),
        (cut(INFO, 100), INFO, "is torn"),
        (edit(INFO, lambda i: i.pop("fps")), INFO, "is torn or no part of a dataset: 'fps'"),
        (
            edit(INFO, lambda i: i.update(codebase_version="v1.6")),
            INFO,
            "got version 'v1.6'; allowed: v2.0, v2.1, v3.0",
        ),
        (
            edit(INFO, lambda i: i.update(total_frames=18)),
            INFO,
            "total_frames: got 18; the table of episodes has 17",
        ),
        (drop(EPISODES), EPISODES, "no such file"),
        (cut(EPISODES, 500), EPISODES, "is torn"),
        (
            shorten(EPISODES),
            INFO,
            "total_episodes: got 4; the table of episodes has 3",
        ),
        (cut(TASKS, 300), TASKS, "is torn"),
        (drop(TASKS), TASKS, "no such file; meta/info.json has 2 tasks in it"),
        (shorten(TASKS), TASKS, "got 1 tasks; expected 2"),
        (drop(DATA), DATA, "no such file"),
        (cut(DATA, 1500), DATA, "is torn"),
        (shorten(DATA), DATA, "got 16 frames; expected 17 by the table of episodes"),
        (
            edit(INFO, lambda i: i["features"].update(q={"dtype": "float32", "shape": [1]})),
            DATA,
            "lacks the columns q, which meta/info.json lists",
        ),
    ],
)
def test_a_torn_dataset_is_rejected_and_the_file_named(
    root: Path, tear: Callable[[Path], None], file: str, problem: str
) -> None:
    tear(root)
    with pytest.raises(LogError) as error:
        open_dataset(root)
    assert error.value.file == str(root / file)
    assert str(error.value).startswith(f"{root / file}: {problem}")


def test_a_missing_and_a_truncated_video_are_named(filmed: Path, tmp_path: Path) -> None:
    root = tmp_path / "torn"
    shutil.copytree(filmed, root)
    video = root / f"videos/{CAMERA}/chunk-000/file-000.mp4"
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(LogError, match="cannot be read as a video") as error:
        open_dataset(root).images(3, CAMERA)
    assert error.value.file == str(video)
    video.write_bytes(film(0, 6).mp4)
    with pytest.raises(LogError, match="got 2 images of episode 1; expected 7 by the table"):
        open_dataset(root).images(1, CAMERA)
    video.unlink()
    with pytest.raises(LogError, match="no such file; the table of episodes has images") as error:
        open_dataset(root)
    assert error.value.file == str(video)


def test_no_such_episode_and_no_such_camera(root: Path) -> None:
    found = open_dataset(root)
    with pytest.raises(InputError, match="episode: got 4; allowed: 0 to 3"):
        found.rows(4)
    with pytest.raises(UnknownNameError, match="unknown camera"):
        found.images(0, CAMERA)


# ------------------------------------------------------------------ others


def test_datasets_of_version_2_are_read(tmp_path: Path) -> None:
    """As Open-H has them: a file for each episode, names in a list of lists."""
    added = write(tmp_path / "new")
    new, old = open_dataset(tmp_path / "new"), tmp_path / "old"
    info = json.loads((tmp_path / "new" / INFO).read_text()) | {
        "codebase_version": "v2.1",
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    }
    info["features"]["action"]["names"] = [["a", "b", "c"]]
    info["features"]["instruction.text"] = {"dtype": "string", "shape": [1]}
    (old / "meta").mkdir(parents=True)
    (old / "data/chunk-000").mkdir(parents=True)
    (old / INFO).write_text(json.dumps(info))
    from pyarrow import parquet

    lines: list[str] = []
    table: Any = parquet.read_table(tmp_path / "new" / DATA)
    for k, row in enumerate(new.episodes):
        part = table.slice(row["dataset_from_index"], row["length"])
        parquet.write_table(part, old / f"data/chunk-000/episode_{k:06d}.parquet")
        about = {"episode_index": k, "tasks": row["tasks"], "length": row["length"]}
        lines.append(json.dumps({**about, "seed": row["seed"]}))
    (old / "meta/episodes.jsonl").write_text("\n".join(lines) + "\n")
    with pytest.raises(LogError, match=r"meta/tasks\.jsonl: no such file"):
        open_dataset(old)
    texts = [{"task_index": k, "task": f"task {k}"} for k in range(2)]
    (old / "meta/tasks.jsonl").write_text("\n".join(map(json.dumps, texts)) + "\n")
    check(old, added)
    (old / "data/chunk-000/episode_000002.parquet").unlink()
    with pytest.raises(LogError, match=r"episode_000002\.parquet: no such file"):
        open_dataset(old)


#: Read by lerobot: lengths, a window of actions, images.
SCRIPT = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
windows = {"action": [0.0, 0.02]}
options = {"delta_timestamps": windows, "video_backend": "pyav"}
data = LeRobotDataset("trocar/test", root=sys.argv[1], **options)
rows = [data[k] for k in range(len(data))]
print(json.dumps({
    "episodes": data.num_episodes,
    "fps": data.fps,
    "state": [row["observation.state"].tolist() for row in rows],
    "action": [row["action"].tolist() for row in rows],
    "done": [bool(row["next.done"]) for row in rows],
    "task": [row["task"] for row in rows],
    "grey": [float(row["observation.images.left"].mean()) for row in rows],
    "std": data.meta.stats["action"]["std"].tolist(),
}))
"""


@pytest.mark.slow
def test_lerobot_reads_the_same(filmed: Path) -> None:
    python = os.environ.get("TROCAR_LEROBOT", "")
    if not python:
        pytest.skip("TROCAR_LEROBOT names no Python that has lerobot (0.4.4)")
    done = subprocess.run(
        [python, "-c", SCRIPT, str(filmed)],
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": os.environ["PATH"], "HF_HUB_OFFLINE": "1", "HOME": os.environ["HOME"]},
    )
    assert done.returncode == 0, done.stderr
    read = json.loads(done.stdout.splitlines()[-1])
    parts = [columns(count, k) for k, count in enumerate(LENGTHS)]
    assert (read["episodes"], read["fps"]) == (len(LENGTHS), 50)
    state = np.concatenate([part["observation.state"] for part in parts])
    assert np.array_equal(read["state"], state.astype(np.float32))
    actions = [part["action"][[k, min(k + 1, len(part["action"]) - 1)]]
               for part in parts for k in range(len(part["action"]))]  # fmt: skip
    assert np.array_equal(read["action"], np.array(actions, np.float32))
    assert read["done"] == [k == n - 1 for n in LENGTHS for k in range(n)]
    assert read["task"] == [f"task {e % 2}" for e, n in enumerate(LENGTHS) for _ in range(n)]
    greys = [grey(e, k) / 255.0 for e, n in enumerate(LENGTHS) for k in range(n)]
    assert np.abs(np.subtract(read["grey"], greys)).max() < 0.01
    assert read["std"] == pytest.approx(np.concatenate([p["action"] for p in parts]).std(axis=0))
