"""Pictures as JPEG or PNG, packed while other threads run."""

from __future__ import annotations

import io
import os
import weakref
from collections import deque
from typing import IO, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.errors import UnknownNameError

Format = Literal["jpeg", "png"]
FORMATS: tuple[str, ...] = get_args(Format)
Picture = NDArray[np.uint8]

#: Of JPEG. Source: our own choice; 640x480 of an endoscope's view take about 40 kB.
QUALITY = 85
#: Of PNG: quickly rather than small. Source: our own choice.
LEVEL = 1
#: Pictures that are known again: both eyes of two cameras. Source: our own choice.
KNOWN = 4


class Packer:
    """Packs pictures; in one thread only.

    Pillow lets other threads run while it packs into a file, and not while it packs into memory:
    a tick of a millisecond would wait for it. So it gets a file that lies in memory.

    A picture that nobody can write to, and that comes again, is not packed again.

    Args:
        format: "jpeg" or "png"

    Raises:
        UnknownNameError: another format
    """

    def __init__(self, format: str = "jpeg") -> None:  # noqa: A002  the word of sensor_msgs
        if format not in FORMATS:
            raise UnknownNameError("image format", format, FORMATS)
        self.format = format
        self._options = {"quality": QUALITY} if format == "jpeg" else {"compress_level": LEVEL}
        self._file: IO[bytes] | None = None
        self._known: deque[tuple[Picture, bytes]] = deque(maxlen=KNOWN)

    def pack(self, picture: Picture) -> bytes:
        """Return a picture (h, w, 3) or (h, w) as the bytes of a file."""
        if picture.flags.writeable:
            return self._packed(picture)
        for known, data in self._known:
            if known is picture:
                return data
        data = self._packed(picture)
        self._known.append((picture, data))
        return data

    def _packed(self, picture: Picture) -> bytes:
        image = Image.fromarray(picture)
        file = self._begun()
        image.save(file, self.format, **self._options)
        size = file.tell()
        file.seek(0)
        return file.read(size)

    def _begun(self) -> IO[bytes]:
        if self._file is None:
            self._file = _file_in_memory()
            weakref.finalize(self, self._file.close)
        self._file.seek(0)
        return self._file


def _file_in_memory() -> IO[bytes]:
    """Return a file with a descriptor where the system has such files, else a plain buffer."""
    make = getattr(os, "memfd_create", None)
    return io.BytesIO() if make is None else os.fdopen(make("trocar-picture"), "r+b", buffering=0)
