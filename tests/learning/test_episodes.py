"""A log of an episode: it is the episode, its parts agree, and it can be driven again."""

from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.learning.episodes import EpisodeLog, record_episode
from trocar.learning.films import FilmWriter
from trocar.learning.readings import SceneReadings, read_task
from trocar.rendering.film import read_video
from trocar.robot.follow import repeat
from trocar.tasks import Task, make_task, run_episode


@pytest.fixture(scope="module")
def reach() -> Task:
    return make_task("needle-reach")


def same(one: SceneReadings, other: SceneReadings) -> bool:
    """Whether all readings are equal to the last bit."""
    for part in fields(SceneReadings):
        a, b = getattr(one, part.name), getattr(other, part.name)
        pairs = [(a[k], b[k]) for k in a] if isinstance(a, dict) else [(a, b)]
        if not all(np.array_equal(x, y) for x, y in pairs):
            return False
    return True


def row(log: EpisodeLog, k: int) -> SceneReadings:
    """Return one row of the readings of a log."""

    def cut(value: Any) -> Any:
        if isinstance(value, dict):
            parts = cast(dict[str, Any], value)
            return {name: part[k : k + 1] for name, part in parts.items()}
        return value if isinstance(value, tuple) else value[k : k + 1]

    return SceneReadings(
        **{p.name: cut(getattr(log.readings, p.name)) for p in fields(log.readings)}
    )


def test_keeping_an_episode_changes_nothing_of_it(reach: Task) -> None:
    log = record_episode(reach, 4)
    assert log.result == run_episode(reach, 4)
    assert len(log.readings) == len(log) + 1
    assert log.readings.time[-1] == log.result.time_s
    assert log.rewards.sum() == pytest.approx(1.0)


def test_driving_the_actions_with_their_noise_again_gives_the_same_readings(reach: Task) -> None:
    log = record_episode(reach, 5, noise=0.02)
    assert log.noise.any()
    reach.reset(5)
    assert same(read_task(reach), row(log, 0))
    for k, action in enumerate(log.actions + log.noise):
        assert reach.command(action) == log.rewards[k]
        assert same(read_task(reach), row(log, k + 1))
    assert reach.result(5) == log.result


def test_noise_follows_from_the_seed(reach: Task) -> None:
    log, again, other = (record_episode(reach, seed, noise=0.01) for seed in (1, 1, 2))
    assert np.array_equal(log.noise, again.noise)
    assert not np.array_equal(log.noise[0], other.noise[0])


def test_noise_leaves_the_jaws_of_both_arms_alone() -> None:
    noise = record_episode(make_task("needle-handover"), 1, noise=0.01).noise
    assert not noise[:, [6, 13]].any()
    assert np.delete(noise, [6, 13], axis=1).any(axis=0).all()


def test_noise_is_as_strong_as_it_is_stated(reach: Task) -> None:
    logs = [record_episode(reach, seed, noise=0.01) for seed in range(40)]
    steps = np.concatenate([np.diff(one.noise, axis=0) + 0.1 * one.noise[:-1] for one in logs])
    ratio = steps[:, :6].std(axis=0) / reach.limits[1][:6]
    assert ratio == pytest.approx(np.full(6, 0.01), rel=0.1)  # of some 2,000 numbers: 2 % (1 sigma)


def test_its_recording_repeats(reach: Task, tmp_path: Path) -> None:
    record_episode(reach, 1)
    log = record_episode(reach, 6, mcap=True)
    (tmp_path / "a.mcap").write_bytes(log.recording)
    assert repeat(tmp_path / "a.mcap").identical
    assert log.result == run_episode(reach, 6)


def test_films_have_an_image_for_each_period(reach: Task, tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    shown: list[int] = []

    def capture() -> np.ndarray:
        shown.append(20 + 3 * len(shown))
        return np.full((16, 32, 3), shown[-1], np.uint8)

    log = record_episode(reach, 2, cameras={"left": capture})
    film = log.films["left"]
    assert (film.count, film.size) == (len(log), (32, 16)) and len(shown) == len(log)
    (tmp_path / "a.mp4").write_bytes(film.mp4)
    seen = np.stack([*read_video(tmp_path / "a.mp4")])
    assert seen.shape == (len(log), 16, 32, 3)
    # H.264 keeps brightness in steps of 1/219
    assert np.abs(seen.mean(axis=(1, 2, 3)) - shown).max() < 3.0
    greys = np.array(shown) / 255.0
    assert film.mean == pytest.approx(np.full(3, greys.mean()))
    assert film.std == pytest.approx(np.full(3, greys.std()))
    assert (film.low[0], film.high[0]) == (greys[0], greys[-1])


def test_images_of_odd_or_changing_size_are_rejected() -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    with FilmWriter(50.0) as writer:
        with pytest.raises(InputError, match=r"got 5x4; allowed: even sides"):
            writer.add(np.zeros((4, 5, 3), np.uint8))
        writer.add(np.zeros((16, 16, 3), np.uint8))
        with pytest.raises(InputError, match=r"got 18x16; allowed: 16x16"):
            writer.add(np.zeros((16, 18, 3), np.uint8))
