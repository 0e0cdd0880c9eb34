"""Portraits of a rig as PNG files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.rendering.portrait import VIEWS, View, portrait


def write_pictures(
    rig: RigDescription,
    folder: Path,
    views: Sequence[View] = tuple(VIEWS),
    size: tuple[int, int] = (1200, 900),
) -> tuple[Path, ...]:
    """Write a rig's portraits into a folder, front.png and so on, and return their paths.

    Raises:
        InputError: the folder cannot be written
        TrocarError: there is no OpenGL to draw with
    """
    images = {view: portrait(rig, view=view, size=size) for view in views}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for view, image in images.items():
            Image.fromarray(image).save(folder / f"{view}.png", optimize=True)
    except OSError as problem:
        raise InputError(f"{folder}: cannot be written: {problem.strerror}") from problem
    return tuple(folder / f"{view}.png" for view in views)
