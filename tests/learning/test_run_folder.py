"""Folders of trainings: curves and videos."""

from dataclasses import replace
from pathlib import Path

import pytest

from trocar.errors import InputError
from trocar.learning.run_folder import RunFolder, film_episode
from trocar.rendering.film import read_video
from trocar.tasks import make_task
from trocar.tasks.play import scripted


# imageio_ffmpeg leaves the pipes to ffmpeg to the garbage collector
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_film_shows_the_episode_at_its_own_speed(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra video is not installed")
    request.getfixturevalue("opengl")
    task, path = make_task("needle-reach"), tmp_path / "episode.mp4"
    episode = film_episode(task, scripted, 0, path)
    assert episode.success
    frames = list(read_video(path))
    assert len(frames) == pytest.approx(25.0 * episode.time_s, abs=1.0)
    assert (frames[0] != frames[-1]).any()


def test_a_scene_without_an_endoscope_is_not_filmed(tmp_path: Path) -> None:
    task = make_task("needle-reach")
    task.world.rig = replace(task.world.rig, cameras=())
    with pytest.raises(InputError, match="needle-reach: its rig has no endoscope"):
        film_episode(task, scripted, 0, tmp_path / "episode.mp4")


def test_an_earlier_policy_is_kept(tmp_path: Path) -> None:
    (tmp_path / "policy.toml").touch()
    with pytest.raises(InputError, match=r"policy.toml: exists; allowed: a new folder"):
        RunFolder(tmp_path)
    RunFolder(tmp_path, overwrite=True)


def test_a_file_in_place_of_the_folder_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "run").touch()
    with pytest.raises(InputError, match="run: cannot be made: File exists"):
        RunFolder(tmp_path / "run")
