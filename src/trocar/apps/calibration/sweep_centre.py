"""The remote centre in the tracks, and how far it is from the first axis of the loops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import Axes, Value
from trocar.apps.calibration.placement import BaseAxis, Centre
from trocar.apps.calibration.rcm import RcmReport, find_rcm
from trocar.apps.calibration.rcm_frame import centre_links
from trocar.apps.calibration.tracks import Tracks
from trocar.descriptions import ArmDescription
from trocar.fitting import PivotFit, not_gross
from trocar.geometry import inverse

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CentreFound:
    """The remote centre as the tracks show it.

    Attributes:
        report: the pivot calibration
        distance: from the first axis as the axes' sweep has it [m]; where that axis is not
            tracked along with the centre, what the pivot's own sweep tells, or None
    """

    report: RcmReport
    distance: Value | None

    def as_dict(self) -> dict[str, Any]:
        """Return the remote centre as plain data."""
        found = _plain(self.report.as_dict()["rcm"])
        if self.distance is not None:
            told = {"value": self.distance.value, "sigma": self.distance.sigma}
            found["distance_to_pitch_axis_m"] = told
        return found


def find_centre(
    tracks: Tracks, arm: ArmDescription, axes: Axes, centre: Centre, names: Mapping[str, str]
) -> CentreFound:
    """Find the remote centre by pivot calibration (the paper's equations 3 and 4).

    Args:
        tracks: a sweep that turns the base's joint and the loops'
        arm: whose
        axes: from the sweep of the loops
        centre: which body turns about it, and before which
        names: {body: its name in the tracks} of those that are called otherwise

    Raises:
        TracksError: the two bodies are never seen together
        UndeterminedError: all turns share one axis
    """
    known = centre_links(arm).all
    report = find_rcm(tracks, arm, {b: name for b, name in names.items() if b in known})
    called = {body: names.get(body, body) for body in axes.linkage.bodies}
    poses = {b: tracks.poses[name] for b, name in called.items() if name in tracks.poses}
    distance = _from_axis(poses, axes, centre, report.fit)
    if distance is None and report.distance is not None:
        distance = Value(*report.distance)
    return CentreFound(report, distance)


def base_axis(report: RcmReport) -> BaseAxis | None:
    """Return the axis of the base's joint in the markers of the body that it turns."""
    fit = report.hinges.yaw
    if fit is None:
        return None
    axis, sense = fit.in_b, report.hinges.senses[0]
    influence = axis.influence * np.repeat([1.0, sense], 3)
    return BaseAxis(axis.point, sense * axis.direction, influence.T @ influence)


def _plain(value: Any) -> Any:
    """Return arrays as lists, all the way down."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _from_axis(
    seen_poses: Mapping[str, Array], axes: Axes, centre: Centre, fit: PivotFit
) -> Value | None:
    """Measure how far the centre is from the first axis, in a body that carries both."""
    hinge = axes.linkage.hinges[0]
    body = next((b for b in (hinge.body_a, hinge.body_b) if b in seen_poses), None)
    if hinge.name not in axes.fits or body is None:
        return None
    poses = (inverse(seen_poses[body]) @ seen_poses[centre.body])[fit.used]
    points = poses[:, :3, :3] @ fit.tip + poses[:, :3, 3]
    seen = np.isfinite(points[:, 0])
    if not seen.any():
        return None
    away = np.linalg.norm(points - np.median(points[seen], axis=0), axis=1)
    kept = not_gross(away)
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
