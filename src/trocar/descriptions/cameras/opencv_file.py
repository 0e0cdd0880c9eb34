"""Calibrations as OpenCV's samples write them: a YAML file with one eye or two.

Names are those of OpenCV's samples `calibration` and `stereo_calib` (the latter writes intrinsics
and extrinsics into two files; they may be given together). R and T lead from the left eye to the
right one: p_right = R p_left + T.

Source: OpenCV 4, samples/cpp/calibration.cpp and samples/cpp/stereo_calib.cpp.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras.entries import Entries
from trocar.descriptions.cameras.records import (
    Calibration,
    Intrinsics,
    MonoCalibration,
    StereoCalibration,
)
from trocar.descriptions.cameras.rectification import rectified
from trocar.descriptions.cameras.ros_file import ROUNDED
from trocar.errors import DescriptionError, InputError
from trocar.geometry.se3 import inverse, transform

Array = NDArray[np.float64]

#: Names of a matrix; the first is what is written.
ONE = (
    ("camera_matrix", "cameraMatrix", "K", "mtx"),
    ("distortion_coefficients", "distCoeffs", "D"),
)
LEFT = (("M1", "K1", "cameraMatrix1"), ("D1", "distCoeffs1"))
RIGHT = (("M2", "K2", "cameraMatrix2"), ("D2", "distCoeffs2"))
SIZES = ("imageSize", "image_size", "size")


def calibration_from_opencv(entries: Entries) -> Calibration:
    """Return the calibration of one eye or of two.

    Raises:
        DescriptionError: naming file, entry, what was got and what is allowed
    """
    if not entries.has(*LEFT[0]) and not entries.has(*RIGHT[0]):
        return MonoCalibration(_eye(entries, ONE), "", entries.file)
    left, right = _eye(entries, LEFT), _eye(entries, RIGHT)
    turn = entries.matrix(3, 3, "R")
    first, _, last = np.linalg.svd(turn)
    nearest = first @ last
    if np.linalg.det(turn) <= 0.0 or np.abs(nearest - turn).max() > ROUNDED:
        raise entries.fail("R", f"got {turn.tolist()}; allowed: a rotation matrix")
    T_right_left = transform(nearest, entries.matrix(3, 1, "T")[:, 0])
    try:
        return StereoCalibration(left, right, inverse(T_right_left), "", entries.file)
    except InputError as problem:
        raise DescriptionError(entries.file, "", str(problem)) from problem


def opencv_text(calibration: Calibration) -> str:
    """Return the text of a file that OpenCV reads; numbers come back to the last bit."""
    eyes = calibration.eyes
    lines = ["%YAML:1.0", "---"]
    lines += [f"image_width: {eyes[0].width}", f"image_height: {eyes[0].height}"]
    if isinstance(calibration, MonoCalibration):
        eye = calibration.eye
        lines += _matrix_lines(ONE[0][0], eye.K) + _matrix_lines(ONE[1][0], eye.distortion[None])
        return "\n".join(lines) + "\n"
    for eye, (matrix, coefficients) in zip(eyes, (LEFT, RIGHT), strict=True):
        lines += _matrix_lines(matrix[0], eye.K)
        lines += _matrix_lines(coefficients[0], eye.distortion[None])
    T_right_left = inverse(calibration.T_left_right)
    lines += _matrix_lines("R", T_right_left[:3, :3]) + _matrix_lines("T", T_right_left[:3, 3:])
    for number, turn in enumerate(rectified(calibration), 1):
        lines += _matrix_lines(f"R{number}", turn.R) + _matrix_lines(f"P{number}", turn.P)
    return "\n".join(lines) + "\n"


def _matrix_lines(key: str, matrix: Array) -> list[str]:
    rows, columns = matrix.shape
    data = ", ".join(repr(float(v)) for v in matrix.ravel())
    head = [f"{key}: !!opencv-matrix", f"  rows: {rows}", f"  cols: {columns}", "  dt: d"]
    return [*head, f"  data: [{data}]"]


def _eye(entries: Entries, names: tuple[tuple[str, ...], tuple[str, ...]]) -> Intrinsics:
    width, height = _size(entries)
    K = entries.matrix(3, 3, *names[0])
    coefficients = entries.numbers(*names[1]) if entries.has(*names[1]) else np.zeros(0)
    try:
        return Intrinsics(width, height, K, coefficients)
    except InputError as problem:
        raise DescriptionError(entries.file, names[0][0], str(problem)) from problem


def _size(entries: Entries) -> tuple[int, int]:
    """Return the picture's size; the sample stereo_calib leaves it out."""
    for key in SIZES:
        if key in entries:
            width, height = entries.matrix(1, 2, key).ravel().tolist()
            if width != round(width) or height != round(height):
                raise entries.fail(key, f"got {[width, height]}; allowed: two whole numbers")
            return int(width), int(height)
    if not entries.has("image_width"):
        raise entries.fail(
            "image_width",
            "is missing, as OpenCV's sample leaves it out; write image_width and image_height of"
            " the calibration's pictures into the file",
        )
    return entries.whole("image_width"), entries.whole("image_height")
