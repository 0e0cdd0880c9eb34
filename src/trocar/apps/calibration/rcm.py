"""The remote centre of an arm from tracks: pivot calibration, equations 3 to 5 of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import LEAST_SAMPLES
from trocar.apps.calibration.home import still_start
from trocar.apps.calibration.rcm_cloud import CloudPoint, centre_samples, over_cells
from trocar.apps.calibration.rcm_frame import (
    CentreLinks,
    HingesAbout,
    about_hinges,
    centre_links,
    resting,
)
from trocar.apps.calibration.table7 import Table7, table7
from trocar.apps.calibration.tracks import Tracks, check_together, select_bodies
from trocar.descriptions import ArmDescription
from trocar.errors import InputError
from trocar.fitting import (
    PivotFit,
    fit_pivot_in_body,
    likely_cause,
    rest_pose,
    white_noise,
)
from trocar.geometry import inverse

Array = NDArray[np.float64]

# Source: our own choice; a centre whose spread exceeds the noise's by this wanders.
_WANDERS = 1.3
# Source: our own choice; a file with six decimals has this much rounding. [m]
_ROUNDING = 3e-6


@dataclass(frozen=True, eq=False)
class RcmReport:
    """The remote centre as tracks show it.

    Attributes:
        arm: name of the arm
        body: which body turns about it
        base: the body in whose frame it rests, or "camera"
        fit: the pivot: `tip` in the body (b_tip), `post` in the base (b_post)
        noise_rms: what the cameras' noise alone would make of `fit.rms` [m]
        cloud: the centre at each pose; empty where the joints are not seen
        table7: relative to the pitch axis as in the paper's Table 7, where that axis is seen
        distance: from the pitch axis and its 1-sigma [m], where that is seen
        warnings: what a user should know
        hinges: the first two joint axes
    """

    arm: str
    body: str
    base: str
    fit: PivotFit
    noise_rms: float
    cloud: tuple[CloudPoint, ...]
    table7: Table7 | None
    distance: tuple[float, float] | None
    warnings: tuple[str, ...]
    hinges: HingesAbout

    @property
    def wander_rms(self) -> float:
        """How far the centre itself wanders, noise taken off [m]."""
        return float(np.sqrt(max(self.fit.rms**2 - self.noise_rms**2, 0.0)))

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain data, as `trocar rcm --json` prints it."""
        fit = self.fit
        centre: dict[str, Any] = {
            "body": self.body,
            "base": self.base,
            "b_tip_m": {"value": fit.tip, "sigma": fit.sigma_tip},
            "b_post_m": {"value": fit.post, "sigma": fit.sigma_post},
            "position_in_base_body_m": {"value": fit.post, "sigma": fit.sigma_post},
            "rms_xyz_m": fit.rms_axes,
            "rms_m": fit.rms,
            "noise_rms_m": self.noise_rms,
            "wander_rms_m": self.wander_rms,
            "condition": fit.condition,
            "samples": int(fit.used.sum()),
            "outliers": fit.outliers,
        }
        if self.base == "camera":
            del centre["position_in_base_body_m"]
        if self.distance is not None:
            value, sigma = self.distance
            centre["distance_to_pitch_axis_m"] = {"value": value, "sigma": sigma}
        turned, _ = centre_samples(self.hinges, fit)
        if len(turned):
            low, high = turned.min(axis=0), turned.max(axis=0)
            centre["sweep_rad"] = {"yaw": [low[0], high[0]], "pitch": [low[1], high[1]]}
        if self.table7 is not None:
            centre["table7"] = self.table7.as_dict()
        cloud = [
            {"q_rad": point.q, "position_m": point.position, "samples": point.samples}
            for point in self.cloud
        ]
        return {
            "arm": self.arm,
            "rcm": centre,
            "cloud": cloud,
            "warnings": list(self.warnings),
        }


def find_rcm(
    tracks: Tracks, arm: ArmDescription, bodies: Mapping[str, str] | None = None
) -> RcmReport:
    """Find the remote centre of an arm in tracks that turn its first two joints.

    The body that carries the instrument is needed; the base (else the cameras' frame is taken for
    it), and the bodies that show the first two joints are used where they are tracked.

    Args:
        tracks: as read from a file
        arm: whose bodies they are
        bodies: {body: its name in the file}, for those that are called otherwise

    Raises:
        InputError: an arm without a remote centre, or a body that it does not have
        TracksError: the body is missing, or not seen together with the base
        UndeterminedError: all turns share one axis
    """
    links = centre_links(arm)
    chosen, warnings = _chosen(tracks, links, bodies or {})
    base, body = chosen.poses[links.base], chosen.poses[links.body]
    check_together(chosen, links.base, links.body, LEAST_SAMPLES)
    fit = _fit(chosen.times, base, body)
    noise_rms = _noise_rms(base, body, fit)
    if fit.rms > max(_WANDERS * noise_rms, _ROUNDING):
        warnings.append(
            f"there is no fixed remote centre: it wanders by {1e3 * fit.rms:.3g} mm (RMS), noise"
            f" alone would give {1e3 * noise_rms:.3g} mm; its standard deviations hold for the"
            " mean over this sweep"
        )
        warnings += _slips(chosen, links)
    hinges = about_hinges(chosen, links)
    warnings += hinges.warnings
    found = None if hinges.yaw is None else table7(chosen, links, hinges, fit)
    at_base = links.base in tracks.poses or links.base in (bodies or {})
    return RcmReport(
        arm=arm.name,
        body=links.body,
        base=links.base if at_base else "camera",
        fit=fit,
        noise_rms=noise_rms,
        cloud=over_cells(*centre_samples(hinges, fit)),
        table7=None if found is None else found[0],
        distance=None if found is None else found[1],
        warnings=(*tracks.warnings, *warnings),
        hinges=hinges,
    )


def _fit(times: Array, base: Array, body: Array) -> PivotFit:
    """Fit the pivot to the sweep, without a still start.

    A single pose that is held for long would count as many, and a centre that wanders would look
    as if it did so less.
    """
    fit = fit_pivot_in_body(base, body)
    moved = np.where(fit.used[:, None, None], inverse(resting(base)) @ body, np.nan)[:, :3].reshape(
        -1, 12
    )
    still = still_start(times, {str(i): moved[:, i] for i in range(12)})
    if still is None or np.count_nonzero(fit.used & ~still) < LEAST_SAMPLES:
        return fit
    return fit_pivot_in_body(base, np.where(still[:, None, None], np.nan, body))


def _slips(tracks: Tracks, links: CentreLinks) -> list[str]:
    """Name the slip of convention that would explain a centre that seems to wander."""
    for a, b in ((links.yaw, links.pitch), (links.base, links.yaw)):
        if a in tracks.poses and b in tracks.poses and tracks.together(a, b).any():
            cause = likely_cause(tracks.poses[a], tracks.poses[b])
            if cause is not None:
                return [f"{a} and {b} do not turn about one axis either; likely {cause}"]
    return []


def _chosen(
    tracks: Tracks, links: CentreLinks, bodies: Mapping[str, str]
) -> tuple[Tracks, list[str]]:
    """Return the tracks of the bodies that count, and what there is to say about them."""
    known = links.all
    for name in bodies:
        if name not in known:
            raise InputError(
                f"bodies: got {name!r}; known to the remote centre: {', '.join(known)}"
            )
    wanted = {name: bodies.get(name, name) for name in known}
    optional = [name for name in known if name != links.body and name not in bodies]
    chosen = select_bodies(tracks, wanted, optional)
    if links.base in chosen.poses:
        return chosen, []
    rest = np.broadcast_to(np.eye(4), (len(tracks.times), 4, 4))
    words = f"{links.base} is not tracked: the cameras' frame is taken for the base, as if it rests"
    return replace(chosen, poses={**chosen.poses, links.base: rest}), [words]


def _noise_rms(base: Array, body: Array, fit: PivotFit) -> float:
    """Return what noise from sample to sample makes of the distance R tip + p - post [m]."""
    position, rotation = white_noise(body)
    square = 3.0 * position**2 + 2.0 * rotation**2 * float(fit.tip @ fit.tip)
    if rest_pose(base) is None:
        position, rotation = white_noise(base)
        square += 3.0 * position**2 + 2.0 * rotation**2 * float(fit.post @ fit.post)
    return float(np.sqrt(square))
