"""What a calibration found, and how it is told to programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from trocar.apps.calibration.axes import Axes, Value
from trocar.apps.calibration.home import Home
from trocar.apps.calibration.refine import Refined
from trocar.apps.calibration.sweep_centre import CentreFound
from trocar.descriptions.overlay import Overlay
from trocar.kinematics.mechanism import Mechanism

ClosureKind = Literal["parallelogram", "general"]


@dataclass(frozen=True, eq=False)
class Calibration:
    """One robot, measured.

    Attributes:
        arm: name of the description
        closure: how its loops close
        axis_distances: {label: as measured, each by itself [m]}
        closed_distances: {label: in the closed geometry [m]}
        nominal_distances: {label: in the description [m]}
        betas: {name: angle at home [rad]}, empty without a still start
        centre: the remote centre, None where no sweep shows it
        wander: root of the mean squared distance of the closed geometry's own remote centre from
            its middle [m]; None where the arm has none
        axes, home, refined: how it was found
        mechanism: the whole arm's, calibrated
        overlay: what is to be laid over the description
        warnings: what a user should know
    """

    arm: str
    closure: ClosureKind
    axis_distances: Mapping[str, Value]
    closed_distances: Mapping[str, float]
    nominal_distances: Mapping[str, float]
    betas: Mapping[str, Value]
    centre: CentreFound | None
    wander: float | None
    axes: Axes
    home: Home
    refined: Refined
    mechanism: Mechanism
    overlay: Overlay
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return everything as one JSON document, in SI units; what cannot be had is absent."""
        document: dict[str, Any] = {
            "arm": self.arm,
            "axis_distances_m": {k: _pair(v) for k, v in self.axis_distances.items()},
            "beta_rad": {k: _pair(v) for k, v in self.betas.items()},
        }
        if self.centre is not None:
            document["rcm"] = self.centre.as_dict()
        document["closure"] = closure_dict(self)
        document["residuals"] = residuals_dict(self)
        document["warnings"] = list(self.warnings)
        return document


def _pair(value: Value) -> dict[str, float]:
    return {"value": value.value, "sigma": value.sigma}


def closure_dict(found: Calibration) -> dict[str, Any]:
    """Return the closed geometry as JSON has it."""
    differences = {
        label: found.closed_distances[label] - value.value
        for label, value in found.axis_distances.items()
    }
    told: dict[str, Any] = {
        "kind": found.closure,
        "axis_distances_m": dict(found.closed_distances),
        "absorbed_m": differences,
        "misfit_m": found.refined.misfit_m,
        "chi_squared_per_freedom": found.refined.misfit,
    }
    if found.wander is not None:
        told["remote_centre_wanders_m"] = found.wander
    return told


def residuals_dict(found: Calibration) -> dict[str, Any]:
    """Return what is left of the poses as JSON has it."""
    return {
        "position_rms_m": found.refined.position_rms,
        "rotation_rms_rad": found.refined.rotation_rms,
        "samples": found.refined.samples,
        "axes": {
            found.axes.linkage.hinge(name).label: {
                "position_rms_m": fit.residual_position,
                "rotation_rms_rad": fit.residual_rotation,
                "span_rad": fit.span,
                "condition": fit.condition,
                "samples": int(fit.used.sum()),
                "outliers": fit.outliers,
            }
            for name, fit in found.axes.fits.items()
        },
    }
