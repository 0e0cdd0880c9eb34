"""Pictures of a world as it stands, videos of it in motion, and the motions to film."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.errors import InputError, LogError, MissingExtraError, TrocarError
from trocar.outputs import whole_file
from trocar.rendering.frames import picture
from trocar.simulation.trials import TICK_S, paper_sine

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]
#: Steps a world until a time [s].
Move = Callable[[float], None]
#: Called after each picture with the count so far and the final count.
Progress = Callable[[int, int], None]

#: File extensions. Source: the formats that Pillow and ffmpeg write everywhere.
PICTURES, VIDEOS = (".png", ".jpg", ".jpeg"), (".mp4",)
#: Quality of H.264, 0 to 10. Source: our own choice; edges of instruments stay sharp.
QUALITY = 8.0
MOTIONS = ("instruments", "sine", "still")
#: Amplitude and frequency of an instrument's joints [rad or m, Hz]. Source: our own choice: slow
#: motions of a person at the console, all in view.
SWINGS = {
    "yaw": (0.05, 0.11),
    "pitch": (0.04, 0.17),
    "insertion": (0.012, 0.13),
    "roll": (0.7, 0.10),
    "wrist_pitch": (0.4, 0.19),
    "wrist_yaw": (0.45, 0.15),
    "jaw": (0.35, 0.31),
}
#: Largest amplitude over the distance to the joint's limit, and time to full amplitude [s]. Source:
#: our own choice.
SHARE, BEGIN_S = 0.8, 0.5


def kind_of(path: Path) -> str:
    """Return "picture" or "video".

    Raises:
        InputError: another ending, or a folder that is not there
    """
    ending = path.suffix.lower()
    if ending not in PICTURES + VIDEOS:
        allowed = ", ".join(PICTURES + VIDEOS)
        raise InputError(f"{path}: got extension {ending!r}; allowed: {allowed}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: cannot be written: no folder {path.absolute().parent}")
    return "video" if ending in VIDEOS else "picture"


def take_picture(
    capture: Callable[[], Any],
    path: Path,
    *,
    eye: str = "both",
    show: str = "colour",
    overwrite: bool = False,
) -> tuple[int, int]:
    """Write the image of a camera, and return its width and height [px].

    Args:
        capture: returns a frame
        path: ends in one of PICTURES
        eye, show: as of `picture`
        overwrite: replace a file that exists

    Raises:
        InputError: a path that cannot be written, or content that cannot be shown
    """
    if kind_of(path) != "picture":
        raise InputError(f"{path}: allowed for an image: {', '.join(PICTURES)}")
    found = picture(capture(), eye, show)
    with whole_file(path, overwrite) as part:
        Image.fromarray(found).save(part)
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
    overwrite: bool = False,
    progress: Progress | None = None,
) -> tuple[int, int, int]:
    """Write a video of a world, and return its width, height [px] and how many pictures it has.

    Every picture is drawn, however long that takes: time in the video is simulated time.

    Args:
        world: is moved; it begins as it stands
        capture: returns a frame of the world as it is
        path: ends in one of VIDEOS
        duration_s: simulated time [s]
        rate_hz: pictures a second
        motion: as of `mover`
        eye, show: as of `picture`
        overwrite: replace a file that exists
        progress: called after each picture

    Raises:
        InputError: a duration or rate that is not above 0, or a path that cannot be written
        TrocarError: ffmpeg gave up
    """
    if kind_of(path) != "video":
        raise InputError(f"{path}: allowed for a video: {', '.join(VIDEOS)}")
    for name, got in (("duration", duration_s), ("rate", rate_hz)):
        if not 0.0 < got < float("inf"):
            raise InputError(f"--{name}: got {got:g}; allowed: above 0")
    if motion not in MOTIONS:
        raise InputError(f"--motion: got {motion!r}; allowed: {', '.join(MOTIONS)}")
    count = max(1, round(duration_s * rate_hz))
    move = mover(world, duration_s, motion)
    first = picture(capture(), eye, show)
    size = first.shape[1], first.shape[0]
    begin = world.time
    with video(path, size, rate_hz, overwrite=overwrite) as add:
        add(first)
        for number in range(1, count):
            move(begin + number / rate_hz)
            add(picture(capture(), eye, show))
            if progress is not None:
                progress(number + 1, count)
    return *size, count


@contextmanager
def video(
    path: Path,
    size: tuple[int, int],
    rate_hz: float,
    *,
    overwrite: bool = False,
    quality: float = QUALITY,
    keyframes: int = 0,
) -> Generator[Callable[[NDArray[np.uint8]], None]]:
    """Yield a function that appends a picture (h, w, 3) to a video, until the block ends.

    Args:
        path: of the file
        size: width, height [px]; an odd one loses a column or a row
        rate_hz: pictures a second
        overwrite: replace a file that exists
        quality: from 1 to 10
        keyframes: pictures from one that is stored whole to the next; 0: as the encoder has it

    Raises:
        MissingExtraError: the extra `video` is not installed
        InputError: the path exists or cannot be written
        TrocarError: ffmpeg failed, as on a full disk
    """
    library = _library("writing videos")
    width, height = (side // 2 * 2 for side in size)  # H.264 keeps colours for two pixels at once
    count = 0
    with whole_file(path, overwrite) as part:
        writer = library.write_frames(
            str(part),
            (width, height),
            fps=rate_hz,
            quality=quality,
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=["-g", str(keyframes)] if keyframes else [],
        )
        writer.send(None)

        def add(one: NDArray[np.uint8]) -> None:
            nonlocal count
            count += 1
            writer.send(np.ascontiguousarray(one[:height, :width]))

        try:
            try:
                yield add
            finally:
                writer.close()
            written, _ = library.count_frames_and_secs(str(part))
        except (OSError, RuntimeError) as problem:
            raise _incomplete(path, count) from problem
        if written != count:
            raise _incomplete(path, count)


def join_videos(parts: Sequence[Path], path: Path) -> None:
    """Write videos of one size, rate and encoder after each other into one, as they are.

    Raises:
        MissingExtraError: the extra `video` is not installed
        InputError: the path exists or cannot be written
        TrocarError: ffmpeg failed
    """
    program = _library("writing videos").get_ffmpeg_exe()
    with tempfile.TemporaryDirectory(prefix="trocar-") as folder, whole_file(path) as part:
        # A list, since a command line has no room for thousands of files.
        entries = Path(folder) / "parts.txt"
        names = (str(one.resolve()).replace("'", "'\\''") for one in parts)
        entries.write_text("".join(f"file '{name}'\n" for name in names), encoding="utf-8")
        command = [program, "-v", "error", "-y", "-f", "concat", "-safe", "0", "-i", str(entries)]
        done = subprocess.run(
            [*command, "-c", "copy", "-f", "mp4", str(part)], capture_output=True, check=False
        )
        if done.returncode:
            problem = done.stderr.decode(errors="replace").strip()
            raise TrocarError(f"{path}: ffmpeg failed: {problem}")


def read_video(path: Path, start_s: float = 0.0) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures of a video, (h, w, 3) each.

    Args:
        path: of the file
        start_s: pictures before this time are left out [s]

    Raises:
        MissingExtraError: the extra `video` is not installed
        LogError: no video, or a damaged one
    """
    program = _library("reading videos").get_ffmpeg_exe()
    from_there = ["-ss", f"{start_s:.6f}"] if start_s > 0.0 else []
    form = ["-fps_mode", "passthrough", "-f", "image2pipe", "-vcodec", "ppm", "-"]
    command = [program, "-v", "error", "-xerror", *from_there, "-i", str(path), *form]
    with (
        tempfile.TemporaryFile() as problems,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=problems) as process,
    ):
        stream = process.stdout
        try:
            while stream is not None and stream.readline():
                width, height = map(int, stream.readline().split())
                stream.readline()
                data = stream.read(3 * width * height)
                yield np.frombuffer(data, np.uint8).reshape(height, width, 3)
            status = process.wait()
        except ValueError:  # a picture that breaks off
            status = -1
        finally:
            process.kill()
        if status:
            problems.seek(0)
            text = " ".join(problems.read().decode(errors="replace").split())[-200:]
            raise LogError(str(path), f"cannot be read as a video: {text or 'it breaks off'}")


def _library(purpose: str) -> Any:
    """Import imageio-ffmpeg, whose annotations forbid rates that it takes."""
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingTypeStubs] - it has no types
    except ImportError as error:
        raise MissingExtraError("imageio-ffmpeg", "video", purpose) from error
    return imageio_ffmpeg


def _incomplete(path: Path, count: int) -> TrocarError:
    text = f"{path}: ffmpeg did not write all of {count} frames, see its message above"
    return TrocarError(f"{text}; is the disk full?")


def mover(world: World, duration_s: float, motion: str) -> Move:
    """Return a function that moves a world while it is filmed; the arms may start elsewhere.

    Args:
        world: is moved by the function that is returned
        duration_s: at most so long [s]
        motion: one of MOTIONS: the instruments about where they are, every arm but the setup
            joints along the paper's sine, or none
    """
    if motion == "still":
        return _player(world, {}, 1)
    every = max(1, round(TICK_S / world.timestep))
    tick = every * world.timestep
    count = int(duration_s / tick) + 2
    if motion == "sine":
        sine = paper_sine(world.rig, count * tick, tick)
        for name, q in sine.start.items():
            world.set_state(name, q)
        return _player(world, sine.positions, every)
    times = tick * np.arange(1, count + 1, dtype=np.float64)
    arms = [arm for arm in world.arms.values() if arm.description.type == "PSM"]
    tables = {arm.name: swings(arm, times, number) for number, arm in enumerate(arms)}
    return _player(world, tables, every if tables else 1)


def swings(arm: Arm, times: Array, number: int) -> Array:
    """Return set-points (k, n) [rad or m] of an instrument that swings about its position.

    Args:
        arm: the instrument's
        times: since the motion began (k,) [s]
        number: of the instrument; sets the phase
    """
    still = arm.runtime.snapshot(None).setpoint
    found = np.tile(still, (len(times), 1))
    begin = np.clip(times / BEGIN_S, 0.0, 1.0)
    for joint, name in enumerate(arm.joints.names):
        if name not in SWINGS:
            continue
        far, often = SWINGS[name]
        middle = max(still[joint], far) if name == "jaw" else still[joint]  # it opens and closes
        room = SHARE * min(arm.joints.upper[joint] - middle, middle - arm.joints.lower[joint])
        phase = 2.1 * number + joint
        swing = np.sin(2.0 * np.pi * often * times + phase) - np.sin(phase) * (1.0 - begin)
        found[:, joint] += begin * (middle - still[joint] + min(far, max(room, 0.0)) * swing)
    return found


def _player(world: World, positions: dict[str, Array], every: int) -> Move:
    """Return a function that plays tables of set-points piece by piece, or just steps the world."""
    row, tick = 0, every * world.timestep

    def move(until: float) -> None:
        nonlocal row
        count = round((until - world.time) / tick)
        if count > 0 and positions:
            part = {name: q[row : row + count] for name, q in positions.items()}
            world.play(part, every=every, record=False)
            row += count
        elif count > 0:
            world.step(count)

    return move
