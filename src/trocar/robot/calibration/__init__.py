"""A robot from motion capture: tracks in, an overlay of its description out."""

from trocar.robot.calibration.calibrate import Calibration, calibrate
from trocar.robot.calibration.joints import JointsCalibration, calibrate_joints, has_chain
from trocar.robot.calibration.tracks import (
    Tracks,
    check_together,
    parse_bodies,
    read_tracks,
    select_bodies,
)

__all__ = [
    "Calibration",
    "JointsCalibration",
    "Tracks",
    "calibrate",
    "calibrate_joints",
    "check_together",
    "has_chain",
    "parse_bodies",
    "read_tracks",
    "select_bodies",
]
