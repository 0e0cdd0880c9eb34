"""A picture of a world as it stands, and a video of it as it moves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from trocar.apps.filming.motions import MOTIONS, mover
from trocar.apps.filming.show import picture
from trocar.apps.filming.video import video
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.simulation import World

#: What a file's name ends in. Source: what Pillow and ffmpeg write for everybody.
PICTURES, VIDEOS = (".png", ".jpg", ".jpeg"), (".mp4",)
#: Told after each picture: how many there are, and how many there will be.
Progress = Callable[[int, int], None]


def kind_of(path: Path) -> str:
    """Return "picture" or "video".

    Raises:
        InputError: another ending, or a folder that is not there
    """
    ending = path.suffix.lower()
    if ending not in PICTURES + VIDEOS:
        allowed = ", ".join(PICTURES + VIDEOS)
        raise InputError(f"{path}: got the ending {ending!r}; allowed: {allowed}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: cannot be written: there is no folder {path.absolute().parent}")
    return "video" if ending in VIDEOS else "picture"


def take_picture(
    capture: Callable[[], Any], path: Path, *, eye: str = "both", show: str = "colour"
) -> tuple[int, int]:
    """Write what a camera sees now, and return the picture's width and height [px].

    Args:
        capture: returns a frame
        path: ends in one of PICTURES; what is there is written over
        eye, show: as of `show.picture`

    Raises:
        InputError: a path that cannot be written, or what cannot be shown
    """
    if kind_of(path) != "picture":
        raise InputError(f"{path}: a picture ends in {', '.join(PICTURES)}")
    found = picture(capture(), eye, show)
    try:
        Image.fromarray(found).save(path)
    except OSError as problem:
        raise InputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem
    return found.shape[1], found.shape[0]


def film(
    world: World,
    capture: Callable[[], Any],
    path: Path,
    *,
    duration_s: float,
    rate_hz: float,
    motion: str = "instruments",
    eye: str = "both",
    show: str = "colour",
    progress: Progress | None = None,
) -> tuple[int, int, int]:
    """Write a video of a world, and return its width, height [px] and how many pictures it has.

    Every picture is drawn, however long that takes: time in the video is simulated time.

    Args:
        world: is moved; it begins as it stands
        capture: returns a frame of the world as it is
        path: ends in one of VIDEOS; what is there is written over
        duration_s: simulated time [s]
        rate_hz: pictures a second
        motion: as of `motions.mover`
        eye, show: as of `show.picture`
        progress: told after each picture

    Raises:
        InputError: a duration or rate that is not above 0, or a path that cannot be written
        TrocarError: ffmpeg gave up
    """
    count = _checked_count(path, duration_s, rate_hz, motion)
    move = mover(world, duration_s, motion)
    first = picture(capture(), eye, show)
    size = first.shape[1], first.shape[0]
    begin = world.time
    with video(path, size, rate_hz) as out:
        out.add(first)
        for number in range(1, count):
            move(begin + number / rate_hz)
            out.add(picture(capture(), eye, show))
            if progress is not None:
                progress(number + 1, count)
    return *size, count


def _checked_count(path: Path, duration_s: float, rate_hz: float, motion: str) -> int:
    if kind_of(path) != "video":
        raise InputError(f"{path}: a video ends in {', '.join(VIDEOS)}")
    for name, got in (("duration", duration_s), ("rate", rate_hz)):
        if not 0.0 < got < float("inf"):
            raise InputError(f"--{name}: got {got:g}; allowed: above 0")
    if motion not in MOTIONS:
        raise InputError(f"--motion: got {motion!r}; allowed: {', '.join(MOTIONS)}")
    return max(1, round(duration_s * rate_hz))
