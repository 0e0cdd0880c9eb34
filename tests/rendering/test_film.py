"""Pictures and videos as files: what is in them, when it was, and what cannot be written."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from trocar.errors import InputError, LogError, MissingExtraError, TrocarError, UnknownNameError
from trocar.rendering.film import (
    MOTIONS,
    SWINGS,
    film,
    join_videos,
    kind_of,
    mover,
    read_video,
    swings,
    take_picture,
    video,
)
from trocar.rendering.frames import EYES, SHOWN, picture
from trocar.simulation import World

SIZE = (64, 48)


def frame(eyes: int = 2, brightness: int = 200) -> Any:
    """A frame as the renderer makes them."""
    width, height = SIZE
    left = np.full((height, width, 3), brightness, np.uint8)
    depth = np.full((eyes, height, width), np.inf, np.float32)
    depth[:, :, : width // 2] = 0.1
    return SimpleNamespace(
        left=left,
        right=left // 2 if eyes == 2 else None,
        depth=depth,
        ids=np.arange(eyes * width * height, dtype=np.int32).reshape(eyes, height, width),
        normals=np.tile(np.array([0, 0, -1], np.float32), (eyes, height, width, 1)),
    )


@pytest.mark.parametrize("show", SHOWN)
@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("eyes", [1, 2])
def test_everything_can_be_shown_of_every_eye(eyes: int, eye: str, show: str) -> None:
    if eyes == 2 and eye == "anaglyph" and show != "colour":
        with pytest.raises(InputError, match="anaglyph"):
            picture(frame(eyes), eye, show)
        return
    found = picture(frame(eyes), eye, show)
    wide = eyes == 2 and eye == "both"
    assert found.shape == (SIZE[1], (1 + wide) * SIZE[0], 3)
    assert found.dtype == np.uint8


def test_what_was_not_rendered_or_is_unknown_cannot_be_shown() -> None:
    bare = SimpleNamespace(left=frame().left, right=None, depth=None, ids=None, normals=None)
    with pytest.raises(InputError, match="rendered without depth"):
        picture(bare, "left", "depth")
    with pytest.raises(UnknownNameError, match="both, left, right, anaglyph"):
        picture(bare, "third", "colour")
    with pytest.raises(UnknownNameError, match="colour, depth, ids, normals"):
        picture(bare, "left", "heat")


def test_depth_is_bright_near_and_dark_where_nothing_is() -> None:
    one = frame(1)
    one.depth[0, :, 0] = 0.05
    found = picture(one, "left", "depth").sum(axis=-1)
    assert found[0, 0] > found[0, 10] > found[0, -1]


def test_ids_that_follow_one_another_have_colours_that_differ() -> None:
    found = picture(frame(1), "left", "ids").reshape(-1, 3).astype(int)[:200]
    assert (found[0] == found[0][0]).all()  # nothing is grey
    apart = np.abs(np.diff(found, axis=0)).max(axis=1)
    assert apart.min() > 20


def test_a_picture_is_written(tmp_path: Path) -> None:
    path = tmp_path / "scope.png"
    assert take_picture(lambda: frame(brightness=130), path) == (128, 48)
    image = np.asarray(Image.open(path))
    assert (image[:, :64] == 130).all()
    assert (image[:, 64:] == 65).all()


@pytest.mark.parametrize("name", ["scope.gif", "scope", "scope.png.txt"])
def test_an_ending_that_says_nothing_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"allowed: \.png, \.jpg, \.jpeg, \.mp4"):
        kind_of(tmp_path / name)


def test_a_path_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written: no folder"):
        take_picture(frame, tmp_path / "nowhere" / "scope.png")
    (tmp_path / "taken.png").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        take_picture(frame, tmp_path / "taken.png")


# ------------------------------------------------------------------ videos


def test_a_video_has_a_picture_for_each_period_of_simulated_time(tmp_path: Path) -> None:
    library = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    world = World("psm")
    times: list[float] = []

    def capture() -> Any:
        times.append(world.time)
        return frame()

    path = tmp_path / "scope.mp4"
    size = film(world, capture, path, duration_s=0.5, rate_hz=20.0, motion="still")
    assert size == (128, 48, 10)
    np.testing.assert_allclose(times, np.arange(10) / 20.0, atol=1e-9)
    frames, seconds = library.count_frames_and_secs(str(path))
    assert frames == 10
    assert seconds == pytest.approx(0.5, abs=0.06)


def test_joined_videos_are_read_one_after_the_other_from_any_time_on(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    greys = [20 + 8 * k for k in range(9)]
    parts = {tmp_path / "it's a.mp4": greys[:4], tmp_path / "b.mp4": greys[4:]}
    for path, shown in parts.items():
        with video(path, SIZE, 25.0, keyframes=2) as add:
            for grey in shown:
                add(np.full((SIZE[1], SIZE[0], 3), grey, np.uint8))
    joined = tmp_path / "both.mp4"
    join_videos([*parts], joined)
    for first in range(9):
        seen = np.stack([*read_video(joined, (first - 0.5) / 25.0)])
        assert seen.shape == (9 - first, SIZE[1], SIZE[0], 3)
        # H.264 keeps brightness in steps of 1/219
        assert np.abs(seen.mean(axis=(1, 2, 3)) - greys[first:]).max() < 2.5
    with pytest.raises(InputError, match="exists already"):
        join_videos([*parts], joined)
    joined.write_bytes(b"no video")
    with pytest.raises(LogError, match=r"both\.mp4: cannot be read as a video: "):
        next(read_video(joined))


def test_a_video_that_cannot_be_written_or_is_none_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    world = World("psm")
    usual = {"duration_s": 1.0, "rate_hz": 10.0, "motion": "still"}
    (tmp_path / "taken.mp4").mkdir()
    for path, options, complaint in (
        (tmp_path / "taken.mp4", {}, "cannot be written"),
        (tmp_path / "a.mp4", {"duration_s": 0.0}, "duration"),
        (tmp_path / "a.mp4", {"rate_hz": float("nan")}, "rate"),
        (tmp_path / "a.mp4", {"motion": "dance"}, "instruments, sine, still"),
        (tmp_path / "a.png", {}, "allowed for a video"),
    ):
        with pytest.raises(InputError, match=complaint):
            film(world, frame, path, **{**usual, **options})
    assert world.time == 0.0


# imageio_ffmpeg leaves its pipe to an ffmpeg that has ended to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of file sizes")
@pytest.mark.parametrize("pictures", [2, 60])
def test_a_disk_that_is_full_is_an_error(pictures: int, tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not there")
    import resource

    path = tmp_path / "scope.mp4"

    def written() -> None:
        rng = np.random.default_rng(1)
        with video(path, (320, 240), 10.0) as add:
            for _ in range(pictures):
                add(rng.integers(0, 255, (240, 320, 3), np.uint8))

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(TrocarError, match=r"not write all of \d+ frames.*is the disk full"):
            written()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


def test_without_ffmpeg_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtraError, match=r"trocar\[video\]"):
        film(World("psm"), frame, tmp_path / "a.mp4", duration_s=1.0, rate_hz=5.0, motion="still")


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_motion_moves_what_it_says_and_clips_nothing(motion: str, caplog: Any) -> None:
    world = World("two_psm_ecm")
    move = mover(world, 1.0, motion)
    before = {name: arm.measured_js().position for name, arm in world.arms.items()}
    begin = world.time
    for count in range(1, 31):
        move(begin + count / 30.0)
    assert world.time - begin == pytest.approx(1.0, abs=0.006)
    moved = {
        name
        for name, arm in world.arms.items()
        if np.abs(arm.measured_js().position - before[name]).max() > 1e-3
    }
    assert (
        moved == {"instruments": {"PSM1", "PSM2"}, "sine": set(world.arms), "still": set()}[motion]
    )
    assert not caplog.records


def test_swings_begin_where_the_arm_stands_and_stay_inside_the_limits() -> None:
    arm = World("psm").arm("PSM1")
    found = swings(arm, np.arange(1, 20_000, dtype=np.float64) * 0.005, 2)
    assert np.abs(found[0] - arm.runtime.snapshot(None).setpoint).max() < 0.02
    assert (found >= arm.joints.lower).all()
    assert (found <= arm.joints.upper).all()
    assert set(SWINGS) == set(arm.joints.names)
    rates = np.abs(np.diff(found, axis=0)) / 0.005
    assert rates.max() < 3.0
