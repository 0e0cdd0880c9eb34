"""Hinges and remote centres from measured poses: maximum likelihood, robust, with uncertainties."""

from trocar.kinematics.estimation.axes import Axis, AxisDistance, axis_distance
from trocar.kinematics.estimation.hinge import LEAST_SPAN, SMALL_SPAN, HingeFit, fit_hinge
from trocar.kinematics.estimation.pivot import LEAST_TURN, PivotFit, fit_pivot

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
    "fit_pivot",
]
