"""Hinges and remote centres from measured poses: maximum likelihood, robust, with uncertainties."""

from trocar.kinematics.estimation.axes import Axis, AxisDistance, axis_distance
from trocar.kinematics.estimation.causes import likely_cause
from trocar.kinematics.estimation.hinge import LEAST_SPAN, SMALL_SPAN, HingeFit, fit_hinge
from trocar.kinematics.estimation.joint import SharedHinge, refine_hinges
from trocar.kinematics.estimation.noise import white_noise
from trocar.kinematics.estimation.pivot import LEAST_TURN, PivotFit, fit_pivot
from trocar.kinematics.estimation.plain import fit_hinge_least_squares
from trocar.kinematics.estimation.rest import RestPose, fit_pivot_in_body, rest_pose
from trocar.kinematics.estimation.robust import GROSS_M, not_gross

__all__ = [
    "GROSS_M",
    "LEAST_SPAN",
    "LEAST_TURN",
    "SMALL_SPAN",
    "Axis",
    "AxisDistance",
    "HingeFit",
    "PivotFit",
    "RestPose",
    "SharedHinge",
    "axis_distance",
    "fit_hinge",
    "fit_hinge_least_squares",
    "fit_pivot",
    "fit_pivot_in_body",
    "likely_cause",
    "not_gross",
    "refine_hinges",
    "rest_pose",
    "white_noise",
]
