"""Images of an episode as a video, with the statistics of their colours."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.rendering.film import video

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Quality of a film, see `video`, and images from one that is stored whole to the next. Source: as
#: LeRobot writes, about CRF 20 and 2: single images are read fast.
QUALITY, KEYFRAMES = 6.0, 2


@dataclass(frozen=True, eq=False)
class Film:
    """Images of an episode, one at the beginning of each period.

    Attributes:
        mp4: H.264
        size: width, height [px]
        count: number of images
        low, high, mean, std: of red, green and blue over all pixels, (3,), from 0 to 1
    """

    mp4: bytes
    size: tuple[int, int]
    count: int
    low: Array
    high: Array
    mean: Array
    std: Array


class FilmWriter:
    """Makes a film of images as they come; a context manager.

    Args:
        rate_hz: images a second

    Raises:
        MissingExtraError: the extra `video` is not installed
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate = rate_hz
        self._stack = ExitStack()
        folder = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="trocar-"))
        self._path, self._file = Path(folder) / "film.mp4", self._stack.enter_context(ExitStack())
        self._size, self._count, self._pixels = (0, 0), 0, 0
        self._low, self._high = np.ones(3), np.zeros(3)
        self._sum, self._squares = np.zeros(3), np.zeros(3)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def add(self, image: Image) -> None:
        """Append an image (h, w, 3) with even sides.

        Raises:
            InputError: an odd side, or another size than that of the first one
        """
        size = image.shape[1], image.shape[0]
        if self._count == 0:
            if size[0] % 2 or size[1] % 2:
                raise InputError(f"image: got {size[0]}x{size[1]}; allowed: even sides")
            one = video(self._path, size, self._rate, quality=QUALITY, keyframes=KEYFRAMES)
            self._size, self._add = size, self._file.enter_context(one)
        elif size != self._size:
            known = "{}x{}".format(*self._size)
            raise InputError(f"image: got {size[0]}x{size[1]}; allowed: {known} as before")
        self._add(image)
        colours = image.reshape(-1, 3) / 255.0
        self._count, self._pixels = self._count + 1, self._pixels + len(colours)
        self._low = np.minimum(self._low, colours.min(axis=0))
        self._high = np.maximum(self._high, colours.max(axis=0))
        self._sum += colours.sum(axis=0)
        self._squares += (colours**2).sum(axis=0)

    def film(self) -> Film:
        """End the film of at least one image, and return it."""
        self._file.close()
        mean = self._sum / self._pixels
        std = np.sqrt(np.maximum(self._squares / self._pixels - mean**2, 0.0))
        data = self._path.read_bytes()
        return Film(data, self._size, self._count, self._low, self._high, mean, std)
