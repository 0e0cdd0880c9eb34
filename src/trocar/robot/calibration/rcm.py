"""The remote centre of an arm from tracks: pivot calibration, equations 3 to 5 of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError
from trocar.fitting import (
    LEAST_SPAN,
    PivotFit,
    WanderFit,
    fit_pivot_in_body,
    fit_wander,
    likely_cause,
    not_gross,
    rest_pose,
    white_noise,
)
from trocar.geometry import inverse, matrix_from_rotation_vector, transform
from trocar.robot.calibration.axes import LEAST_SAMPLES, Axes, Value
from trocar.robot.calibration.placement import Centre
from trocar.robot.calibration.rcm_frame import (
    CentreLinks,
    HingesAbout,
    Table7,
    about_hinges,
    centre_links,
    resting,
    table7,
)
from trocar.robot.calibration.tracks import Tracks, check_together, select_bodies
from trocar.robot.calibration.zero_pose import still_start

Array = NDArray[np.float64]

# Source: our own choice; a centre whose spread exceeds the noise's by this wanders.
_WANDERS = 1.3
# Source: our own choice; what the pitch explains takes so much off the correlation in time.
_EXPLAINED = 0.5
# Source: our own choice; a file with six decimals has this much rounding. [m], of angles [rad]
_ROUNDING, _ROUNDED_RAD = 3e-6, 4e-6

# Source: our own choice; the cloud is averaged over so many cells of each joint's sweep, of those
# that have a few samples.
_CELLS, _LEAST_IN_CELL = 6, 5
# Source: our own choice; joint positions at which a wander is reported.
_PLACES = 13


@dataclass(frozen=True, eq=False)
class CloudPoint:
    """The remote centre about one pose of the arm, as in the closed-loop paper's Figure 9.

    Attributes:
        q: of yaw and pitch, (2,) [rad], 0 at the start or, if the arm did not stand still
            there, in the middle of the sweep
        position: mean of R tip + p in the base body, (3,) [m]
        samples: that it is the mean of
    """

    q: Array
    position: Array
    samples: int


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
        distance: from the pitch axis [m], where that is seen
        warnings: for the user
        hinges: the first two joint axes
        wander: how the centre wanders over the swept range of the pitch, None where it stays
    """

    arm: str
    body: str
    base: str
    fit: PivotFit
    noise_rms: float
    cloud: tuple[CloudPoint, ...]
    table7: Table7 | None
    distance: Value | None
    warnings: tuple[str, ...]
    hinges: HingesAbout
    wander: WanderFit | None = None

    @property
    def wander_rms(self) -> float:
        """How far the centre itself wanders, noise taken off [m]."""
        return float(np.sqrt(max(self.fit.rms**2 - self.noise_rms**2, 0.0)))

    def centre_dict(self) -> dict[str, Any]:
        """Return the centre as plain data, in SI units."""
        fit = self.fit
        post = {"value": fit.post.tolist(), "sigma": fit.sigma_post.tolist()}
        centre: dict[str, Any] = {
            "body": self.body,
            "base": self.base,
            "b_tip_m": {"value": fit.tip.tolist(), "sigma": fit.sigma_tip.tolist()},
            "b_post_m": post,
            "position_in_base_body_m": post,
            "rms_xyz_m": fit.rms_axes.tolist(),
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
            centre["distance_to_pitch_axis_m"] = self.distance.as_dict()
        turned, _ = centre_samples(self.hinges, fit)
        if len(turned):
            yaw, pitch = np.stack([turned.min(axis=0), turned.max(axis=0)], axis=1).tolist()
            centre["sweep_rad"] = {"yaw": yaw, "pitch": pitch}
        if self.table7 is not None:
            centre["table7"] = self.table7.as_dict()
        if self.wander is not None:
            centre["wander"] = {
                "pitch_rad": self.wander.q.tolist(),
                "displacement_m": self.wander.curve.tolist(),
                "sigma": self.wander.sigma.tolist(),
            }
        return centre

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain data, as `trocar rcm --json` prints it."""
        cloud = [
            {"q_rad": p.q.tolist(), "position_m": p.position.tolist(), "samples": p.samples}
            for p in self.cloud
        ]
        warnings = list(self.warnings)
        return {"arm": self.arm, "rcm": self.centre_dict(), "cloud": cloud, "warnings": warnings}


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
    names, links = bodies or {}, centre_links(arm)
    chosen, warnings = _chosen(tracks, links, names)
    base, body = chosen.poses[links.base], chosen.poses[links.body]
    check_together(chosen, links.base, links.body, LEAST_SAMPLES)
    fit = _fit_pivot(chosen.times, base, body)
    noise_rms = _noise_rms(base, body, fit)
    hinges, wander = about_hinges(chosen, links), None
    moves = fit.rms > max(_WANDERS * noise_rms, _ROUNDING)
    pitch = _swept_pitch(chosen.times, hinges) if moves or fit.widened > 1.0 else None
    if pitch is not None and fit.rms > _ROUNDING:
        places = np.linspace(np.nanmin(pitch), np.nanmax(pitch), _PLACES)
        curve = fit_wander(base, body, _turned(hinges), pitch, fit, places)
        # Noise that is correlated in time looks like a wander, but the pitch does not explain it.
        if fit.rms > _WANDERS * curve.noise_rms or curve.pivot.widened < _EXPLAINED * fit.widened:
            wander, fit, moves = curve, curve.pivot, True
            noise_rms = max(noise_rms, curve.noise_rms)
    if moves:
        which = "the point with the smallest error over the sweep of yaw and pitch is reported"
        if pitch is not None and wander is None:
            which = "the pitch does not explain it: slow noise, or a loose cluster"
        warnings.append(
            f"the remote centre is not fixed: it moves by {1e3 * fit.rms:.3g} mm (RMS), noise"
            f" alone would cause {1e3 * noise_rms:.3g} mm; {which}"
        )
        warnings += _slips(chosen, links)
    if fit.widened > 1.0 and noise_rms > _ROUNDING:
        warnings.append(
            "the residuals of the remote centre are correlated in time: noise is not white, and"
            f" standard deviations are widened {fit.widened:.1f} times"
        )
    found = None if hinges.yaw is None else table7(chosen, links, hinges, fit)
    return RcmReport(
        arm=arm.name,
        body=links.body,
        base=links.base if links.base in tracks.poses or links.base in names else "camera",
        fit=fit,
        noise_rms=noise_rms,
        cloud=over_cells(*centre_samples(hinges, fit)),
        table7=found,
        distance=None if found is None else found.distance,
        warnings=(*tracks.warnings, *warnings, *hinges.warnings),
        hinges=hinges,
        wander=wander,
    )


def _swept_pitch(times: Array, hinges: HingesAbout) -> Array | None:
    """Return the pitch of each sample, without a sweep before yaw moves, (n,) [rad].

    NaN where it does not count; None where yaw or pitch are unknown.
    """
    known = np.isfinite(hinges.q).all(axis=1)
    if known.sum() < LEAST_SAMPLES:
        return None
    before, pitch = still_start(times, {"yaw": hinges.q[:, 0]}), hinges.q[:, 1]
    if before is not None and np.ptp(np.append(pitch[known & before], 0.0)) > LEAST_SPAN:
        known &= ~before
    return np.where(known, pitch, np.nan) if known.sum() >= LEAST_SAMPLES else None


def _turned(hinges: HingesAbout) -> Array:
    """Return how yaw has turned what it carries, in the base body from yaw 0, (n, 4, 4)."""
    if hinges.yaw is None:
        raise InputError("the yaw axis is unknown")
    axis, sense = hinges.yaw.in_a, hinges.senses[0]
    turn = matrix_from_rotation_vector(
        sense * np.nan_to_num(hinges.q[:, :1]) * axis.direction[None]
    )
    return transform(turn, axis.point - turn @ axis.point)


def centre_samples(hinges: HingesAbout, fit: PivotFit) -> tuple[Array, Array]:
    """Return joint positions (k, 2) [rad] and centres (k, 3) [m] of samples that have both."""
    seen = fit.used & np.isfinite(hinges.q).all(axis=1)
    return hinges.q[seen], fit.points[seen]


def over_cells(q: Array, points: Array) -> tuple[CloudPoint, ...]:
    """Average points over cells of yaw and pitch.

    Args:
        q: of each point, (n, 2) [rad]
        points: (n, 3) [m]
    """
    if len(q) < _LEAST_IN_CELL:
        return ()
    low, width = q.min(axis=0), np.maximum(np.ptp(q, axis=0), 1e-9) / _CELLS
    # A joint that rests amid its sweep is on the edge of a cell.
    cells = np.minimum((q - low + _ROUNDED_RAD) // width, _CELLS - 1).astype(int)
    number = cells[:, 0] * _CELLS + cells[:, 1]
    return tuple(
        CloudPoint(q[inside].mean(axis=0), points[inside].mean(axis=0), int(inside.sum()))
        for inside in (number == cell for cell in np.unique(number))
        if inside.sum() >= _LEAST_IN_CELL
    )


def _chosen(
    tracks: Tracks, links: CentreLinks, bodies: Mapping[str, str]
) -> tuple[Tracks, list[str]]:
    """Return the tracks of the bodies that count, and warnings."""
    known = links.all
    for name in bodies:
        if name not in known:
            raise InputError(f"bodies: got {name!r}; known: {', '.join(known)}")
    optional = [name for name in known if name != links.body and name not in bodies]
    chosen = select_bodies(tracks, {name: bodies.get(name, name) for name in known}, optional)
    if links.base in chosen.poses:
        return chosen, []
    rest = np.broadcast_to(np.eye(4), (len(tracks.times), 4, 4))
    words = f"{links.base} is not tracked: assuming a base fixed in the camera frame"
    return replace(chosen, poses={**chosen.poses, links.base: rest}), [words]


def _fit_pivot(times: Array, base: Array, body: Array) -> PivotFit:
    """Fit the pivot to the sweep, without a still start.

    A single pose that is held for long would count as many, and a centre that wanders would look
    as if it did so less.
    """
    fit = fit_pivot_in_body(base, body)
    moved = np.where(fit.used[:, None, None], inverse(resting(base)) @ body, np.nan)
    entries = moved[:, :3].reshape(-1, 12)
    still = still_start(times, {str(i): entry for i, entry in enumerate(entries.T)})
    if still is None or np.count_nonzero(fit.used & ~still) < LEAST_SAMPLES:
        return fit
    return fit_pivot_in_body(base, np.where(still[:, None, None], np.nan, body))


def _noise_rms(base: Array, body: Array, fit: PivotFit) -> float:
    """Return what noise from sample to sample makes of the distance R tip + p - post [m]."""
    position, rotation = white_noise(body)
    square = 3.0 * position**2 + 2.0 * rotation**2 * float(fit.tip @ fit.tip)
    if rest_pose(base) is None:
        position, rotation = white_noise(base)
        square += 3.0 * position**2 + 2.0 * rotation**2 * float(fit.post @ fit.post)
    return float(np.sqrt(square))


def _slips(tracks: Tracks, links: CentreLinks) -> list[str]:
    """Name the slip of convention that would explain a centre that seems to wander."""
    for a, b in ((links.yaw, links.pitch), (links.base, links.yaw)):
        if a in tracks.poses and b in tracks.poses and tracks.together(a, b).any():
            cause = likely_cause(tracks.poses[a], tracks.poses[b])
            if cause is not None:
                return [f"{a} and {b} do not turn about one axis either; likely {cause}"]
    return []


def find_centre(
    tracks: Tracks, arm: ArmDescription, axes: Axes, centre: Centre, names: Mapping[str, str]
) -> RcmReport:
    """Find the remote centre (the paper's equations 3 and 4), and how far it is from the loops.

    Args:
        tracks: a sweep that turns the base's joint and the loops'
        arm: whose
        axes: from the sweep of the loops
        centre: which body turns about it, and before which
        names: {body: its name in the tracks} of those that are called otherwise

    Returns:
        the centre, its distance from the first axis as the sweep of the loops has that; where it
        is not tracked along with the centre, as the pivot's own sweep has it

    Raises:
        TracksError: the two bodies are never seen together
        UndeterminedError: all turns share one axis
    """
    known = centre_links(arm).all
    report = find_rcm(tracks, arm, {b: name for b, name in names.items() if b in known})
    called = {body: names.get(body, body) for body in axes.linkage.bodies}
    poses = {b: tracks.poses[name] for b, name in called.items() if name in tracks.poses}
    distance = _from_axis(poses, axes, centre, report.fit)
    return report if distance is None else replace(report, distance=distance)


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
    of_mean = fit.widened**2 * distances.var() / len(distances)
    sigma = float(np.sqrt(of_tip @ of_tip + of_axis @ of_axis + of_mean))
    return Value(float(np.linalg.norm(across.mean(axis=0))), sigma)
