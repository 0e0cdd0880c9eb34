"""Cameras: records of their eyes, lens models, calibration files of ROS and OpenCV."""

from trocar.cameras.calibration_files import read_calibration, write_camera
from trocar.cameras.records import (
    Calibration,
    CameraDescription,
    Intrinsics,
    MonoCalibration,
    Rectification,
    StereoCalibration,
)
from trocar.cameras.rectification import CameraInfo, camera_infos, rectified

__all__ = [
    "Calibration",
    "CameraDescription",
    "CameraInfo",
    "Intrinsics",
    "MonoCalibration",
    "Rectification",
    "StereoCalibration",
    "camera_infos",
    "read_calibration",
    "rectified",
    "write_camera",
]
