"""Calibrations as ROS keeps them: a YAML file of camera_info for each eye.

Where two files come together, the pose between the eyes is in their R and P: both pictures are
turned into the same axes by R, and in these the right eye stands at -P[0, 3] / P[0, 0] along x.

Source: ROS, camera_calibration_parsers; sensor_msgs/CameraInfo.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras.entries import Entries
from trocar.descriptions.cameras.records import (
    Intrinsics,
    MonoCalibration,
    Rectification,
    StereoCalibration,
)
from trocar.descriptions.cameras.rectification import CameraInfo, camera_infos
from trocar.errors import DescriptionError, InputError
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

#: ROS's models that trocar has, and how many coefficients each may have.
MODELS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (8,)}
#: Names of an entry in a file, and in a message printed by `rostopic echo` or `ros2 topic echo`.
SIZE = (("image_width", "width"), ("image_height", "height"))
MATRIX, COEFFICIENTS = ("camera_matrix", "K", "k"), ("distortion_coefficients", "D", "d")
TURN, PROJECTION = ("rectification_matrix", "R", "r"), ("projection_matrix", "P", "p")
#: R of a file has so many digits that it is a rotation to this. Source: six digits are printed.
ROUNDED = 1e-4
#: And one that is exact to this is kept to the last bit. Source: rounding of numbers of size 1.
EXACT = 1e-12


def is_ros(entries: Entries) -> bool:
    """Tell whether a file is ROS's."""
    return entries.has("projection_matrix", "camera_name", "distortion_model")


def mono_from_ros(entries: Entries) -> MonoCalibration:
    """Return the calibration of one eye; its P and R say nothing that is needed.

    Raises:
        DescriptionError: naming file, entry, what was got and what is allowed
    """
    return MonoCalibration(_eye(entries), entries.text("camera_name", ""), entries.file)


def stereo_from_ros(left: Entries, right: Entries) -> StereoCalibration:
    """Return the calibration of two eyes.

    Raises:
        DescriptionError: naming file, entry, what was got and what is allowed
    """
    turns = tuple(_rectification(entries) for entries in (left, right))
    (f, x), (f_right, x_right) = ((t.P[0, 0], t.P[0, 3]) for t in turns)
    if x != 0.0 or turns[0].P[1, 3] != 0.0:
        raise left.fail(
            PROJECTION[0], f"got P[0, 3] = {x:g}; allowed: 0 of the left eye. Are they exchanged?"
        )
    if x_right == 0.0:
        raise right.fail(
            PROJECTION[0],
            "got P[0, 3] = 0, which is a baseline of 0; allowed: -fx * baseline of the right eye",
        )
    if turns[1].P[1, 3] != 0.0:
        raise right.fail(
            PROJECTION[0],
            f"got P[1, 3] = {turns[1].P[1, 3]:g}: the eyes lie above each other; allowed: side by"
            " side",
        )
    if abs(f - f_right) > ROUNDED * f:
        raise right.fail(
            PROJECTION[0], f"got fx = {f_right:g}, the left eye's is {f:g}; allowed: the same"
        )
    shift = turns[0].R.T @ np.array([-x_right / f_right, 0.0, 0.0])
    T = transform(turns[0].R.T @ turns[1].R, shift)
    try:
        return StereoCalibration(
            _eye(left),
            _eye(right),
            T,
            left.text("camera_name", ""),
            f"{left.file}, {right.file}",
            (turns[0], turns[1]),
        )
    except DescriptionError:
        raise
    except InputError as problem:
        raise DescriptionError(f"{left.file}, {right.file}", "", str(problem)) from problem


def ros_texts(calibration: StereoCalibration | MonoCalibration, name: str = "") -> tuple[str, ...]:
    """Return the text of each eye's file; numbers come back to the last bit.

    Args:
        calibration: what is written
        name: of the camera; two eyes are called NAME/left and NAME/right
    """
    infos = camera_infos(calibration)
    named = name or calibration.name.partition("/")[0] or "camera"
    sides = (f"{named}/left", f"{named}/right") if len(infos) == 2 else (named,)
    return tuple(_text(info, side) for info, side in zip(infos, sides, strict=True))


def _text(info: CameraInfo, name: str) -> str:
    lines = [
        f"image_width: {info.width}",
        f"image_height: {info.height}",
        f"camera_name: {name}",
        *_matrix_lines(MATRIX[0], info.K),
        f"distortion_model: {info.distortion_model}",
        *_matrix_lines(COEFFICIENTS[0], info.D[None]),
        *_matrix_lines(TURN[0], info.R),
        *_matrix_lines(PROJECTION[0], info.P),
    ]
    return "\n".join(lines) + "\n"


def _matrix_lines(key: str, matrix: Array) -> list[str]:
    rows, columns = matrix.shape
    data = ", ".join(repr(float(v)) for v in matrix.ravel())
    return [f"{key}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{data}]"]


def _eye(entries: Entries) -> Intrinsics:
    width, height = (entries.whole(*names) for names in SIZE)
    K = entries.matrix(3, 3, *MATRIX)
    coefficients = entries.numbers(*COEFFICIENTS) if entries.has(*COEFFICIENTS) else np.zeros(0)
    guess = "rational_polynomial" if coefficients.size == 8 else "plumb_bob"
    model = entries.text("distortion_model", guess) or guess
    if model not in MODELS:
        raise entries.fail("distortion_model", f"got {model!r}; allowed: {', '.join(MODELS)}")
    if coefficients.size not in MODELS[model]:
        allowed = " or ".join(str(n) for n in MODELS[model] if n)
        raise entries.fail(
            COEFFICIENTS[0],
            f"got {coefficients.size} of them; allowed for {model}: {allowed}",
        )
    try:
        return Intrinsics(width, height, K, coefficients)
    except InputError as problem:
        raise DescriptionError(entries.file, "", str(problem)) from problem


def _rectification(entries: Entries) -> Rectification:
    turn = entries.matrix(3, 3, *TURN)
    left, _, right = np.linalg.svd(turn)
    nearest = left @ right
    if np.linalg.det(turn) <= 0.0 or np.abs(nearest - turn).max() > ROUNDED:
        raise entries.fail(TURN[0], f"got {turn.tolist()}; allowed: a rotation matrix")
    P = entries.matrix(3, 4, *PROJECTION)
    if P[0, 0] <= 0.0 or P[1, 1] <= 0.0:
        raise entries.fail(PROJECTION[0], f"focal length {P[0, 0]:g}; allowed: above 0")
    exact = np.abs(nearest - turn).max() < EXACT
    return Rectification(turn if exact else nearest, P)
