"""Hinges and remote centres from measured poses: maximum likelihood, robust, with uncertainties."""

from trocar.fitting.convention_errors import likely_cause
from trocar.fitting.hinge import (
    LEAST_SPAN,
    SMALL_SPAN,
    Axis,
    AxisDistance,
    HingeFit,
    angle_sigma,
    axis_distance,
    fit_hinge,
    rough_hinge,
)
from trocar.fitting.linkage import SharedHinge, expected_hinges, refine_hinges
from trocar.fitting.moving_rcm import WanderFit, fit_wander
from trocar.fitting.pivot import (
    LEAST_TURN,
    PivotFit,
    RestPose,
    expected_pivot_sigma,
    fit_pivot,
    fit_pivot_in_body,
    rest_pose,
    white_noise,
)
from trocar.fitting.robust import GROSS_M, not_gross
from trocar.fitting.slide import SlideFit, fit_slide
from trocar.fitting.still import STILL_S, still_start

__all__ = [
    "GROSS_M",
    "LEAST_SPAN",
    "LEAST_TURN",
    "SMALL_SPAN",
    "STILL_S",
    "Axis",
    "AxisDistance",
    "HingeFit",
    "PivotFit",
    "RestPose",
    "SharedHinge",
    "SlideFit",
    "WanderFit",
    "angle_sigma",
    "axis_distance",
    "expected_hinges",
    "expected_pivot_sigma",
    "fit_hinge",
    "fit_pivot",
    "fit_pivot_in_body",
    "fit_slide",
    "fit_wander",
    "likely_cause",
    "not_gross",
    "refine_hinges",
    "rest_pose",
    "rough_hinge",
    "still_start",
    "white_noise",
]
