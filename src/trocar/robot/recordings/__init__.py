"""Recordings of a real arm's motion: one reader of bags, text and datasets (docs/recordings.md)."""

from trocar.robot.recordings.arm_motion import ArmMotion
from trocar.robot.recordings.motor_side import Wrist, recorded_joints
from trocar.robot.recordings.read import ReadSettings, read_arm_motion, recording_kind
from trocar.robot.recordings.tips import TipMotion, tip_motions

__all__ = [
    "ArmMotion",
    "ReadSettings",
    "TipMotion",
    "Wrist",
    "read_arm_motion",
    "recorded_joints",
    "recording_kind",
    "tip_motions",
]
