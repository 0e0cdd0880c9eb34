"""Collected datasets: what ran is what they have, however many workers, whatever ends them."""

import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.learning.collecting import Collection, EpisodeColumns, collect
from trocar.learning.episodes import record_episode
from trocar.learning.lerobot import open_dataset
from trocar.learning.observations import StateEncoder
from trocar.learning.policies import PolicyFile
from trocar.learning.readings import read_task
from trocar.robot.follow import repeat
from trocar.tasks import Task, make_task

pytest.importorskip("pyarrow", reason="the extra `learn` is not there")

REACH = Collection("needle-reach")


def content(root: Path) -> dict[str, bytes]:
    """Return the files of a folder, {path: content}."""
    found = [path for path in root.rglob("*") if path.is_file()]
    return {str(path.relative_to(root)): path.read_bytes() for path in found}


def sometimes(task: Task) -> Iterator[NDArray[np.float64]]:
    """Return the scripted actions where the needle is on the right, else none."""
    return task.policy() if task.object_pose("needle")[0, 3] > 0.0 else iter(())


@pytest.mark.slow
def test_the_dataset_does_not_depend_on_the_workers(tmp_path: Path) -> None:
    many = Collection("needle-reach", noise=0.01, mcap=True)
    for workers in (1, 2):
        collect(many, range(5), tmp_path / str(workers), workers=workers, command="x")
    one, two = content(tmp_path / "1"), content(tmp_path / "2")
    assert one == two
    recordings = [name for name in one if name.endswith(".mcap")]
    assert len(recordings) == 5
    assert all(repeat(tmp_path / "2" / name).identical for name in recordings)


@pytest.mark.slow
def test_a_killed_worker_loses_only_its_episode(tmp_path: Path) -> None:
    died = tmp_path / "died"
    (tmp_path / "mortal.py").write_text(
        "import os, pathlib, signal\n"
        f"died = pathlib.Path({str(died)!r})\n"
        "def make_policy(env):\n"
        "    def act(obs):\n"
        "        if env.task.time > 0.1 and not died.exists():\n"
        "            died.touch()\n"
        "            os.kill(os.getpid(), signal.SIGKILL)\n"
        "        return [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n"
        "    return act\n"
    )
    policy = PolicyFile(tmp_path / "mortal.py").script
    mortal = Collection("needle-reach", policy, "mortal.py")
    for name, workers in (("a", 2), ("b", 1)):
        found = collect(mortal, range(3), tmp_path / name, workers=workers, keep_failures=True)
        assert (found.kept, len(found.episodes)) == (3, 3)
    assert died.exists()
    assert content(tmp_path / "a") == content(tmp_path / "b")


def test_episodes_that_fail_are_left_out_unless_they_are_kept(tmp_path: Path) -> None:
    some = Collection("needle-reach", sometimes, "sometimes")
    found = collect(some, range(6), tmp_path / "some")
    all_ = collect(some, range(6), tmp_path / "all", keep_failures=True)
    good = [one.seed for one in found.episodes if one.success]
    assert 0 < len(good) < 6 and found.kept == len(good) and all_.kept == 6
    kept = open_dataset(tmp_path / "some")
    assert [row["seed"] for row in kept.episodes] == good
    assert all(kept.rows(k)["next.success"][-1, 0] for k in range(len(kept)))
    whole = open_dataset(tmp_path / "all")
    assert [row["success"] for row in whole.episodes] == [one.success for one in found.episodes]
    ends = [bool(whole.rows(k)["next.success"].any()) for k in range(6)]
    assert ends == [one.success for one in found.episodes]


def test_a_collection_without_success_writes_nothing(tmp_path: Path) -> None:
    idle = Collection("needle-reach", lambda _: iter(()), "idle")
    with pytest.raises(InputError, match="none of 1 episodes ended with success"):
        collect(idle, range(1), tmp_path / "data")
    assert not [*tmp_path.iterdir()]


def test_an_interruption_leaves_a_readable_dataset(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def interrupt(count: int) -> None:
        if count == 2:
            raise KeyboardInterrupt

    collect(REACH, range(2), tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        collect(REACH, range(9), tmp_path / "part", watch=interrupt)
    assert content(tmp_path / "part") == content(tmp_path / "whole")
    assert caplog.messages == [f"{tmp_path / 'part'}: ended after 2 of 9 episodes"]
    with pytest.raises(KeyboardInterrupt):
        collect(REACH, range(9), tmp_path / "none", watch=lambda _: interrupt(2))
    assert len(open_dataset(tmp_path / "none")) == 1


@pytest.mark.parametrize("scene", ["needle-pick", "ecm-reach", "needle-handover"])
def test_columns_are_what_the_task_reads_period_by_period(scene: str) -> None:
    task = make_task(scene)
    log, encoder = record_episode(task, 3), StateEncoder(task)
    columns = EpisodeColumns(task)
    found = columns.of(log)
    task.reset(3)
    for k, action in enumerate(log.actions[:40]):
        seen = read_task(task)
        assert np.array_equal(found["observation.state"][k], encoder.encode(seen)[0])
        joints = np.concatenate([task.world.arms[name].joints.positions() for name in task.arms])
        assert np.array_equal(found["observation.joints"][k], joints)
        task.command(action)
        goals = [task.world.arms[name].joints.setpoints() for name in task.arms]
        assert np.array_equal(found["next.setpoints"][k], np.concatenate(goals))
    for name, feature in columns.features.items():
        assert np.reshape(found[name], (len(log), -1)).shape[1] == len(feature.names), name
        assert len(set(feature.names)) == len(feature.names), name


def test_the_card_says_how_to_make_the_dataset_again(tmp_path: Path) -> None:
    collect(REACH, range(3, 6), tmp_path, command="trocar learn collect needle-reach")
    card = tomllib.loads((tmp_path / "card.toml").read_text())
    assert (card["scene"], card["seeds"], card["successes"]) == ("needle-reach", [3, 4, 5], 3)
    assert card["command"] == "trocar learn collect needle-reach"
    assert card["versions"].keys() == {"trocar", "mujoco", "numpy"}
    text = (tmp_path / "README.md").read_text()
    assert text.startswith("---\n") and "| seeds | 3, 4, 5 |" in text
    assert "`next.setpoints`" in text


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"noise": -0.1}, "noise: got -0.1; allowed: 0 to 1"),
        ({"noise": float("nan")}, "noise: got nan; allowed: 0 to 1"),
        ({"images": (85, 84)}, "images: got 85x84; allowed: even sides"),
    ],
)
def test_settings_that_are_not_allowed(settings: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Collection("needle-reach", **settings)  # type: ignore[arg-type]


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"is not empty \(got mine.txt\)"):
        collect(REACH, range(1), tmp_path)
    assert content(tmp_path) == {"mine.txt": b"mine"}


def test_images_show_the_scene_at_the_beginning_of_each_period(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    pytest.importorskip("moderngl", reason="the extra `scope` is not there")
    from trocar.learning.images import SceneCamera

    seen = Collection("needle-reach", images=(48, 32))
    collect(seen, range(2), tmp_path)
    data = open_dataset(tmp_path)
    images = data.images(1, "observation.images.left")
    assert images.shape[1:] == (32, 48, 3)
    task = make_task("needle-reach")
    camera = SceneCamera(task, (48, 32))
    task.reset(1)
    for k, action in enumerate(data.rows(1)["action"].astype(float)):
        off = np.abs(camera.capture().astype(int) - images[k])
        assert off.mean() < 6.0  # of 255: H.264 at CRF 20
        task.command(action)
    camera.close()


@pytest.mark.slow
def test_a_cluster_changes_nothing(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="the extra cluster is not installed")
    code = f"""
from trocar.learning.collecting import Collection, collect
for name, workers, cluster in (("a", 2, "local"), ("b", 1, "")):
    collect(
        Collection("needle-reach", noise=0.01, mcap=True),
        range(4),
        {str(tmp_path)!r} + "/" + name,
        workers=workers,
        cluster=cluster,
    )
"""
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert content(tmp_path / "a") == content(tmp_path / "b")
