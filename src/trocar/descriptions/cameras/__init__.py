"""Cameras: what is known of their eyes, where rigs place them, and the files that tell it."""

from trocar.descriptions.cameras.files import (
    load_camera,
    load_stereo_camera,
    presets,
    write_camera,
)
from trocar.descriptions.cameras.records import (
    Calibration,
    CameraDescription,
    Intrinsics,
    MonoCalibration,
    Rectification,
    StereoCalibration,
)
from trocar.descriptions.cameras.rectification import CameraInfo, camera_infos, rectified

__all__ = [
    "Calibration",
    "CameraDescription",
    "CameraInfo",
    "Intrinsics",
    "MonoCalibration",
    "Rectification",
    "StereoCalibration",
    "camera_infos",
    "load_camera",
    "load_stereo_camera",
    "presets",
    "rectified",
    "write_camera",
]
