"""Hinges and remote centres from measured poses: maximum likelihood, robust, with uncertainties."""

from trocar.kinematics.estimation.axes import Axis, AxisDistance, axis_distance
from trocar.kinematics.estimation.causes import likely_cause
from trocar.kinematics.estimation.hinge import LEAST_SPAN, SMALL_SPAN, HingeFit, fit_hinge
from trocar.kinematics.estimation.noise import white_noise
from trocar.kinematics.estimation.pivot import LEAST_TURN, PivotFit, fit_pivot
from trocar.kinematics.estimation.plain import fit_hinge_least_squares

__all__ = [
    "LEAST_SPAN",
    "LEAST_TURN",
    "SMALL_SPAN",
    "Axis",
    "AxisDistance",
    "HingeFit",
    "PivotFit",
    "axis_distance",
    "fit_hinge",
    "fit_hinge_least_squares",
    "fit_pivot",
    "likely_cause",
    "white_noise",
]
