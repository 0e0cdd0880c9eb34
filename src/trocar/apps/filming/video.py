"""Writes videos: pictures in, an MP4 out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, MissingExtraError, TrocarError

#: From 0 to 10. Source: our own choice; edges of instruments stay sharp.
QUALITY = 8.0


class Video(Protocol):
    """Takes pictures of one size."""

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Write the next picture (h, w, 3)."""
        ...


def ffmpeg_library() -> ModuleType:
    """Import imageio_ffmpeg, which brings a program of its own.

    Raises:
        MissingExtraError: it is not installed
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise MissingExtraError("imageio-ffmpeg", "video", "writing videos") from error
    return imageio_ffmpeg


@contextmanager
def video(path: Path, size: tuple[int, int], rate_hz: float) -> Iterator[Video]:
    """Write a video while the `with` block lasts.

    Args:
        path: of the file; what is there is written over
        size: width, height [px]; an odd one loses a column or a row
        rate_hz: pictures a second

    Raises:
        MissingExtraError: the extra `video` is not installed
        InputError: the path cannot be written
        TrocarError: ffmpeg gave up, as on a disk that is full
    """
    library = ffmpeg_library()
    try:
        path.open("wb").close()
    except OSError as problem:
        raise InputError(f"{path}: cannot be written: {problem.strerror}") from problem
    width, height = (side // 2 * 2 for side in size)  # H.264 keeps colours for two pixels at once
    writer = library.write_frames(
        str(path),
        (width, height),
        fps=rate_hz,
        quality=QUALITY,
        macro_block_size=2,
        ffmpeg_log_level="error",
    )
    writer.send(None)
    out = _Writer(writer, (width, height))
    try:
        yield out
    except OSError as problem:
        raise _incomplete(path, out.count) from problem
    finally:
        writer.close()
    try:
        written, _ = library.count_frames_and_secs(str(path))
    except RuntimeError as problem:
        raise _incomplete(path, out.count) from problem
    if written != out.count:
        raise _incomplete(path, out.count)


def _incomplete(path: Path, count: int) -> TrocarError:
    said = f"{path}: ffmpeg did not write all of {count} pictures, as it says above"
    return TrocarError(f"{said}; is the disk full?")


class _Writer:
    def __init__(self, writer: Any, size: tuple[int, int]) -> None:
        self._writer, self._size = writer, size
        self.count = 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        width, height = self._size
        self.count += 1
        self._writer.send(np.ascontiguousarray(picture[:height, :width]))
