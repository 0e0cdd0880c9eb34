"""Cameras from TOML: presets, one's own files of the same kind, and the lens of a plain view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras.records import (
    Calibration,
    Intrinsics,
    MonoCalibration,
    StereoCalibration,
)
from trocar.descriptions.table import Table, read_table
from trocar.errors import DescriptionError, InputError
from trocar.geometry.se3 import translation

Array = NDArray[np.float64]

#: The version of camera files. Source: that of arms, tools and rigs.
SCHEMA = 1


def read_camera(path: Path) -> Calibration:
    """Read a camera: two eyes alike and side by side where it has a baseline, else one.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table = read_table(path)
    if table.raw("schema") != SCHEMA:
        raise table.fail("schema", f"got {table.raw('schema')!r}; allowed: {SCHEMA}")
    name, title, source = table.text("name"), table.text("title", ""), table.text("source")
    eye = read_eye(table)
    baseline = table.quantity("baseline", "length", default=np.inf)
    table.done()
    if not np.isfinite(baseline):
        return MonoCalibration(eye, name, source, title)
    try:
        T = translation([baseline, 0.0, 0.0])
        return StereoCalibration(eye, eye, T, name, source, None, title)
    except InputError as problem:
        raise DescriptionError(str(path), "", str(problem)) from problem


def read_eye(table: Table) -> Intrinsics:
    """Read picture size, lens and distortion.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    size = table.numbers("size_px", 2)
    if (size < 1).any() or (size != np.round(size)).any():
        raise table.fail("size_px", f"got {size.tolist()}; allowed: two whole numbers above 0")
    width, height = (int(v) for v in size)
    focal = _read_focal_lengths(table, width)
    middle = np.array([0.5 * (width - 1.0), 0.5 * (height - 1.0)])
    if "principal_px" in table:
        middle = table.numbers("principal_px", 2)
    else:
        table.raw("principal_px")
    distortion = table.numbers("distortion") if "distortion" in table else np.zeros(0)
    table.raw("distortion")
    K = np.array([[focal[0], 0.0, middle[0]], [0.0, focal[1], middle[1]], [0.0, 0.0, 1.0]])
    try:
        return Intrinsics(width, height, K, distortion)
    except InputError as problem:
        raise DescriptionError(table.file, table.path, str(problem)) from problem


def _read_focal_lengths(table: Table, width: int) -> Array:
    """Return fx and fy [px], given as such or by the angle that the picture spans across."""
    if "focal_px" in table:
        if table.has("fov", "angle"):
            raise table.fail("focal_px", "contradicts fov; give one of them")
        return table.numbers("focal_px", 2)
    table.raw("focal_px")
    fov = table.quantity("fov", "angle")
    if not 0.0 < fov < np.pi:
        raise table.fail(
            "fov", f"got {np.degrees(fov):g} deg; allowed: above 0 to below 180 deg, or focal_px"
        )
    f = 0.5 * width / np.tan(0.5 * fov)
    return np.array([f, f])
