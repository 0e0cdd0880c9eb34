"""Workers: the same results however many, and a dead one loses its episode alone."""

import json
import multiprocessing
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from trocar.errors import InputError, TrocarError
from trocar.robot.follow import repeat
from trocar.tasks import Episode, play


@pytest.mark.slow
def test_workers_change_nothing_and_a_killed_ones_episode_runs_again(touch: Path) -> None:
    alone = list(play(str(touch), range(3)))
    found: list[Episode] = []
    for episode in play(str(touch), range(3), 2):
        if not found:
            multiprocessing.active_children()[0].kill()
        found.append(episode)
    assert found == alone
    assert not multiprocessing.active_children()


def test_an_error_of_a_worker_is_raised(touch: Path) -> None:
    broken = "class SceneTask:\n    pass\n"
    (touch.parent / "touch.py").write_text(broken, encoding="utf-8")
    with pytest.raises(TrocarError, match="allowed: a class that extends Task"):
        list(play(str(touch), range(2), 2))


def test_no_workers_are_rejected(touch: Path) -> None:
    with pytest.raises(InputError, match="workers: got 0; allowed: 1 or more"):
        list(play(str(touch), range(2), 0))


def trocar(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "trocar", *words], capture_output=True, text=True, timeout=100
    )


def test_the_command_prints_episodes_as_json(touch: Path, tmp_path: Path) -> None:
    done = trocar("play", str(touch), "--headless", "--json", "--record", str(tmp_path / "a.mcap"))
    assert done.returncode == 0, done.stderr
    (episode,) = json.loads(done.stdout)["episodes"]
    assert episode["success"] and episode["grasp"] == "friction+stick"
    assert set(episode) == set(asdict(next(play(str(touch), [0]))))
    report = repeat(tmp_path / "a.mcap")
    assert (report.identical, report.rig) == (True, "touch")


@pytest.mark.parametrize("workers", [1, 2])
def test_an_episode_is_stopped_after_a_duration(touch: Path, workers: int) -> None:
    found = list(play(str(touch), range(2), workers, duration_s=0.1))
    assert [(one.reason, one.success, round(one.time_s, 6)) for one in found] == [
        ("running", False, 0.1)
    ] * 2


def test_headless_episodes_stop_after_duration(touch: Path, tmp_path: Path) -> None:
    for more in ([], ["--record", str(tmp_path / "a.mcap")]):
        done = trocar("play", str(touch), "--headless", "--json", "--duration", "0.1", *more)
        assert done.returncode == 0, done.stderr
        (episode,) = json.loads(done.stdout)["episodes"]
        assert (episode["reason"], round(episode["time_s"], 6)) == ("running", 0.1)


@pytest.mark.slow
def test_an_episode_is_recorded_with_its_images(touch: Path, tmp_path: Path, opengl: str) -> None:  # noqa: ARG001
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed (extra record)")
    file = tmp_path / "a.mcap"
    images = ("--record-images", "--camera-rate", "1", "--preset", "dvrk_sd_640x480")
    done = trocar("play", str(touch), "--headless", "--record", str(file), *images)
    assert done.returncode == 0, done.stderr
    with file.open("rb") as stream:
        channels = reader.make_reader(stream).get_summary().channels.values()
    for eye in ("left", "right"):
        assert f"/endoscope/{eye}/image_raw/compressed" in {channel.topic for channel in channels}


#: Kills the first process that comes to its policy.
DEADLY = """
import os, signal
from pathlib import Path
from trocar.tasks import Task
MARK = Path(__file__).with_name("killed")
class SceneTask(Task):
    def policy(self):
        if not MARK.exists():
            MARK.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        yield from ()
"""


@pytest.mark.slow
def test_a_cluster_changes_nothing_and_a_killed_workers_episode_runs_again(touch: Path) -> None:
    pytest.importorskip("ray", reason="the extra cluster is not installed")
    (touch.parent / "touch.py").write_text(DEADLY, encoding="utf-8")
    text = touch.read_text(encoding="utf-8").replace("time_limit_s = 10", "time_limit_s = 0.5")
    touch.write_text(text, encoding="utf-8")
    code = f"""
from trocar.tasks import play
print("digests", [one.digest for one in play({str(touch)!r}, range(4), 2, "local")])
print("digests", [one.digest for one in play({str(touch)!r}, range(4))])
"""
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()  # Ray prints of the worker that died, too
    found, alone = (line for line in lines if line.startswith("digests"))
    assert found == alone
    assert (touch.parent / "killed").exists()


@pytest.mark.slow
def test_a_worker_of_a_cluster_keeps_its_task_from_episode_to_episode(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="the extra cluster is not installed")
    path = tmp_path / "counted.py"
    path.write_text(
        "from pathlib import Path\nfrom trocar.descriptions.catalogue import load_scene\n"
        "from trocar.tasks import play\nTASKS = Path(__file__).with_name('tasks')\n"
        "def script(task):\n    with TASKS.open('a') as file:\n"
        "        file.write(f'{id(task)}\\n')\n    return iter(())\n"
        "if __name__ == '__main__':\n"
        "    options = {'script': script, 'duration_s': 0.1}\n"
        "    print(len([*play(load_scene('needle-reach'), range(4), 1, 'local', **options)]))\n",
        encoding="utf-8",
    )
    done = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len({*(tmp_path / "tasks").read_text(encoding="utf-8").splitlines()}) == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["peg-bord"], "did you mean 'peg-board'?"),
        (["peg-board", "--headless", "--episodes", "0"], "--episodes: got 0"),
        (["peg-board", "--headless", "--policy", "none"], "--policy none: got --headless"),
        (["peg-board", "--json"], "allowed with --headless only"),
        (["peg-board", "--cluster", "local"], "allowed with --headless only"),
        (
            ["peg-board", "--headless", "--workers", "2", "--record", "a.mcap"],
            "with one worker only",
        ),
        (["peg-board", "--headless", "--record-images"], "requires --record FILE"),
        (["peg-board", "--headless", "--start", "now"], "allowed without --headless only"),
        (["peg-board", "--no-page", "--start", "viewer"], "--start: got viewer with --no-page"),
    ],
)
def test_bad_options_are_one_line_and_status_2(words: list[str], message: str) -> None:
    done = trocar("play", *words)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
