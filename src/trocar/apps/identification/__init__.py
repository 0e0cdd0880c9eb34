"""Identify a robot's dynamics from logs, predict efforts with them, and plan exciting motions."""

from trocar.apps.identification.excitation import Excitation, excite, trajectory_csv
from trocar.apps.identification.fit import Identified, identify
from trocar.apps.identification.logs import (
    FilteredLog,
    Log,
    default_filters,
    filtered,
    log_kind,
    read_motion,
)
from trocar.apps.identification.predict import LogSettings, Prediction, predict
from trocar.apps.identification.regression import Weight, predicted_efforts
from trocar.apps.identification.rigid_body import JointMotion, rigid_efforts
from trocar.apps.identification.validation import Score, cross_validate, score

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
