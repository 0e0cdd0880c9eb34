"""Rectification of two eyes: turn their pictures so that a point lies in the same row of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.lens import plane_from_pixels, undistort
from trocar.cameras.records import (
    Calibration,
    DistortionModel,
    Intrinsics,
    Rectification,
    StereoCalibration,
)
from trocar.geometry.rotations import (
    angle_between,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)

Array = NDArray[np.float64]

#: Eyes that are parallel to this need not be turned [rad]. Source: less than rounding of a file.
PARALLEL = 1e-9


@dataclass(frozen=True, eq=False)
class CameraInfo:
    """One eye as in ROS: sensor_msgs/CameraInfo without its header.

    Attributes:
        width, height: [px]
        distortion_model: plumb_bob or rational_polynomial
        D: (5,) or (8,)
        K: (3, 3), R: (3, 3), P: (3, 4), as in `Intrinsics` and `Rectification`
    """

    width: int
    height: int
    distortion_model: DistortionModel
    D: Array
    K: Array
    R: Array
    P: Array


def camera_infos(calibration: Calibration) -> tuple[CameraInfo, ...]:
    """Return the ROS camera info of each eye, left first."""
    return tuple(
        CameraInfo(eye.width, eye.height, eye.model, eye.distortion, eye.K, turn.R, turn.P)
        for eye, turn in zip(calibration.eyes, rectified(calibration), strict=True)
    )


def rectified(calibration: Calibration) -> tuple[Rectification, ...]:
    """Return each eye's rectification: the file's where it has one, else Bouguet's.

    Each eye turns by half of what they differ, then both so that x lies along the baseline; so
    neither turns farther than it must. Eyes that are parallel and alike stay as they are.

    Source: J.-Y. Bouguet, "Camera Calibration Toolbox for Matlab", as in OpenCV's stereoRectify.
    """
    if not isinstance(calibration, StereoCalibration):
        return (Rectification(np.eye(3), _projection(calibration.eye.K, 0.0)),)
    if calibration.rectification is not None:
        return calibration.rectification
    b, alike = calibration.baseline, (calibration.left.K == calibration.right.K).all()
    turns = _turns(calibration.T_left_right)
    still = max(float(angle_between(np.eye(3), R)) for R in turns) < PARALLEL
    if still and alike:
        turns, common = (np.eye(3), np.eye(3)), calibration.left.K
    else:
        common = _common_matrix(calibration, turns)
    return (
        Rectification(turns[0], _projection(common, 0.0)),
        Rectification(turns[1], _projection(common, -b)),
    )


def _turns(T_left_right: Array) -> tuple[Array, Array]:
    """Return R_rectified_left and R_rectified_right."""
    half = 0.5 * rotation_vector_from_matrix(T_left_right[:3, :3])
    R_mid_left = matrix_from_rotation_vector(-half)
    R_mid_right = matrix_from_rotation_vector(half)
    along = R_mid_left @ T_left_right[:3, 3]
    along /= np.linalg.norm(along)
    axis = np.cross(along, [1.0, 0.0, 0.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, along[0]))
    turn = matrix_from_rotation_vector(axis * (angle / sine if sine > 0.0 else 0.0))
    return turn @ R_mid_left, turn @ R_mid_right


def _common_matrix(calibration: StereoCalibration, turns: tuple[Array, Array]) -> Array:
    """Return K of both rectified pictures: the shorter focal length, what is seen in the middle."""
    f = min(float(eye.K[1, 1]) for eye in calibration.eyes)
    middles: list[Array] = []
    for eye, R in zip(calibration.eyes, turns, strict=True):
        rays = np.concatenate([_corners(eye), np.ones((4, 1))], axis=1) @ R.T
        middle = (f * rays[:, :2] / rays[:, 2:]).mean(axis=0)
        middles.append(0.5 * (np.array(eye.size) - 1.0) - middle)
    K = np.diag([f, f, 1.0])
    K[:2, 2] = np.mean(middles, axis=0)
    return K


def _corners(eye: Intrinsics) -> Array:
    w, h = eye.width - 1.0, eye.height - 1.0
    pixels = np.array([[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]])
    return undistort(plane_from_pixels(pixels, eye.K), eye.distortion)


def _projection(K: Array, x: float) -> Array:
    return np.concatenate([K, [[K[0, 0] * x], [0.0], [0.0]]], axis=1)
