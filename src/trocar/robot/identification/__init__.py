"""Identify a robot's dynamics from logs, predict efforts with them, and plan exciting motions."""

from trocar.robot.identification.excitation import Excitation, excite, trajectory_csv
from trocar.robot.identification.fit import Identified, identify
from trocar.robot.identification.logs import (
    FilteredLog,
    Log,
    default_filters,
    filtered,
    log_kind,
    read_motion,
)
from trocar.robot.identification.predict import LogSettings, Prediction, predict
from trocar.robot.identification.regression import Weight, predicted_efforts
from trocar.robot.identification.rigid_body import JointMotion, rigid_efforts
from trocar.robot.identification.validation import Score, cross_validate, score

__all__ = [
    "Excitation",
    "FilteredLog",
    "Identified",
    "JointMotion",
    "Log",
    "LogSettings",
    "Prediction",
    "Score",
    "Weight",
    "cross_validate",
    "default_filters",
    "excite",
    "filtered",
    "identify",
    "log_kind",
    "predict",
    "predicted_efforts",
    "read_motion",
    "rigid_efforts",
    "score",
    "trajectory_csv",
]
