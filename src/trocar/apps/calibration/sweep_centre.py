"""The remote centre in the tracks: the point of the last link that stays still before the base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import LEAST_SAMPLES, Axes, Value
from trocar.apps.calibration.placement import Centre
from trocar.apps.calibration.tracks import Tracks, check_together
from trocar.geometry import inverse
from trocar.kinematics.estimation import PivotFit, fit_pivot

Array = NDArray[np.float64]

# Source: our own choice; samples farther than this many times the median are gross outliers.
FAR = 6.0


@dataclass(frozen=True, eq=False)
class CentreFound:
    """The remote centre as the tracks show it.

    Attributes:
        position, sigma: in the base body's markers, (3,) [m]
        rms: root of the mean squared distance of the body's point from there [m]
        distance: from the first axis [m]; None where that axis is not tracked
        condition: condition number of the pivot's normal matrix
    """

    position: Array
    sigma: Array
    rms: float
    distance: Value | None
    condition: float


def find_centre(tracks: Tracks, axes: Axes, centre: Centre) -> CentreFound:
    """Find the remote centre by pivot calibration (the paper's equations 3 and 4).

    Args:
        tracks: a sweep that turns the base's joint and the loops'
        axes: from the sweep of the loops
        centre: which body turns about it, and before which

    Raises:
        TracksError: the two bodies are never seen together
        UndeterminedError: all turns share one axis
    """
    check_together(tracks, centre.base, centre.body, LEAST_SAMPLES)
    poses = inverse(tracks.poses[centre.base]) @ tracks.poses[centre.body]
    fit = fit_pivot(poses[:, :3, :3], poses[:, :3, 3])
    distance = _from_axis(tracks, axes, centre, fit)
    return CentreFound(fit.post, fit.sigma_post, fit.rms, distance, fit.condition)


def _from_axis(tracks: Tracks, axes: Axes, centre: Centre, fit: PivotFit) -> Value | None:
    """Measure how far the centre is from the first axis, in a body that carries both."""
    hinge = axes.linkage.hinges[0]
    body = next((b for b in (hinge.body_a, hinge.body_b) if b in tracks.poses), None)
    if hinge.name not in axes.fits or body is None:
        return None
    poses = (inverse(tracks.poses[body]) @ tracks.poses[centre.body])[fit.used]
    points = poses[:, :3, :3] @ fit.tip + poses[:, :3, 3]
    seen = np.isfinite(points[:, 0])
    if not seen.any():
        return None
    away = np.linalg.norm(points - np.median(points[seen], axis=0), axis=1)
    kept = seen & (away <= FAR * np.median(away[seen]) + 1e-9)
    axis = axes.axis(hinge.name, body)
    between = points[kept] - axis.point
    along = between @ axis.direction
    across = between - along[:, None] * axis.direction
    distances = np.linalg.norm(across, axis=1)
    radial = across.mean(axis=0)
    radial /= np.linalg.norm(radial)
    of_tip = fit.influence[:, :3] @ np.mean(poses[kept, :3, :3].transpose(0, 2, 1) @ radial, axis=0)
    shifted = axis.influence[:, :3] + float(along.mean()) * axis.influence[:, 3:]
    of_axis = shifted @ radial
    of_mean = distances.var() / len(distances)
    sigma = float(np.sqrt(of_tip @ of_tip + of_axis @ of_axis + of_mean))
    return Value(float(np.linalg.norm(across.mean(axis=0))), sigma)
