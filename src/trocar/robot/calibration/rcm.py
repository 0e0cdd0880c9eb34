"""The remote centre of an arm from tracks, in the frame of its first two joint axes.

Pivot calibration by equations 3 to 5 of the closed-loop paper. The frame is that of the paper's
Table 7: its origin is the point of the pitch axis nearest to the yaw axis, z points along the
pitch axis as the description has it, and one of x, y along the yaw axis, such that the nominal
centre is (0, -0.516, 0) m for a PSM and (0.340, 0, 0) m for an ECM. It turns with the yaw link, in
which the centre rests; spreads are given in it as it stands at the start.

`split_centre` divides the difference of a measured centre from the description's: three mechanisms
go through the poses of the measured sweep, the description, the calibrated one, and between them
one whose links are as long as calibrated, and stand in the linkage's plane as measured, but whose
axes do not lean: those of its loops are parallel, and across the yaw axis. What each step changes
is the part of its cause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import TOWARDS, axes_frame
from trocar.errors import InputError
from trocar.fitting import (
    LEAST_SPAN,
    Axis,
    HingeFit,
    PivotFit,
    WanderFit,
    fit_hinge,
    fit_pivot,
    fit_pivot_in_body,
    fit_wander,
    likely_cause,
    not_gross,
    rest_pose,
    still_start,
    white_noise,
)
from trocar.fitting.adjust import slopes
from trocar.geometry import (
    inverse,
    matrix_from_rotation_vector,
    rotation_z,
    transform,
    unskew,
)
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.calibration.axes import (
    LEAST_SAMPLES,
    BaseAxis,
    Value,
)
from trocar.robot.calibration.linkage import bodies_of
from trocar.robot.calibration.tracks import Tracks, check_together, select_bodies

Array = NDArray[np.float64]

# Source: our own choice; a start that is still for so long gives the zero of the angles. [s], [rad]
_STILL_S, _STILL_RAD = 0.5, 0.01


@dataclass(frozen=True, eq=False)
class CentreLinks:
    """Bodies of an arm whose tracks determine its remote centre.

    Attributes:
        arm: the arm
        base, body: the body at rest, and the body that turns about the centre
        yaw, pitch: the bodies that the first two joints turn
        beside: bodies on hinges of the pitch body, which determine the sense of the pitch axis
    """

    arm: ArmDescription
    base: str
    body: str
    yaw: str
    pitch: str
    beside: tuple[str, ...]

    @property
    def all(self) -> tuple[str, ...]:
        """Every body, each once."""
        return tuple(dict.fromkeys((self.base, self.body, self.yaw, self.pitch, *self.beside)))

    def frame(self, body: str) -> str:
        """Return the frame that a body is named after."""
        return body.removeprefix(f"{self.arm.name}_")

    def base_in(self, tracks: Tracks) -> str:
        """Return the base where it is tracked, else the body itself."""
        return self.base if self.base in tracks.poses else self.body

    def selected(self, tracks: Tracks, names: Mapping[str, str]) -> Tracks:
        """Select these bodies; all but the one that turns about the centre may be missing.

        Args:
            tracks: as read from a file
            names: {body: its name in the file}, for those that are called otherwise

        Raises:
            TracksError: a body is missing, or tracked in no sample
        """
        optional = [name for name in self.all if name != self.body and name not in names]
        return select_bodies(tracks, {name: names.get(name, name) for name in self.all}, optional)


@dataclass(frozen=True, eq=False)
class HingesAbout:
    """The yaw and the pitch axis as tracked, and their angles.

    Attributes:
        yaw: base and yaw link; None where it, or the pitch hinge, was not seen to turn
        pitch: yaw link and pitch link
        senses: +1 or -1 by which the two directions are told along the description's
        q: yaw and pitch of each sample, (n, 2) [rad], NaN where not seen
        warnings: what is not known, and why
    """

    yaw: HingeFit | None
    pitch: HingeFit | None
    senses: tuple[float, float]
    q: Array
    warnings: tuple[str, ...]

    @property
    def base_axis(self) -> BaseAxis | None:
        """The axis of the base's joint in the markers of the body that it turns."""
        if self.yaw is None:
            return None
        axis, sense = self.yaw.in_b, self.senses[0]
        influence = axis.influence * np.repeat([1.0, sense], 3)
        return BaseAxis(axis.point, sense * axis.direction, influence.T @ influence)


def centre_links(arm: ArmDescription) -> CentreLinks:
    """Return the bodies that show an arm's remote centre.

    Raises:
        InputError: the arm has none
    """
    mechanism = arm.mechanism
    chain = [mechanism.frames[i] for i in mechanism.chain(mechanism.tip)]
    slide = next((f for f in chain if f.motion == "prismatic" and f.parent), None)
    if "rcm" not in mechanism.frame_index or slide is None or len(mechanism.joints) < 2:
        raise InputError(f"{arm.name}: has no remote centre; allowed: an arm with a frame rcm")
    name = bodies_of(arm)
    yaw, pitch = (joint.drive[0][0] for joint in mechanism.joints[:2])
    beside = [
        name[f.name]
        for f in mechanism.frames
        if f.motion == "revolute" and f.parent and name[f.parent] == name[pitch]
    ]
    return CentreLinks(
        arm, name[arm.root], name[str(slide.parent)], name[yaw], name[pitch], tuple(beside)
    )


def about_hinges(tracks: Tracks, links: CentreLinks) -> HingesAbout:
    """Find the yaw and the pitch axis, as far as they are tracked and turn."""
    nothing = np.full((len(tracks.times), 2), np.nan)
    fits: list[HingeFit] = []
    for what, a, b in (("yaw", links.base, links.yaw), ("pitch", links.yaw, links.pitch)):
        lost = [name for name in (a, b) if name not in tracks.poses]
        fit = None if lost else _fit_hinge(tracks, a, b)
        if fit is None or fit.span < LEAST_SPAN:
            why = (
                f"{', '.join(lost)} not tracked" if lost
                else f"{a} and {b} are not tracked together" if fit is None
                else f"{b} rotates by {fit.span:.3f} rad in {a}, required: {LEAST_SPAN} rad"
            )  # fmt: skip
            words = f"no {what} axis ({why}): no cloud over the joints, and no Table 7"
            return HingesAbout(None, None, (1.0, 1.0), nothing, (words,))
        fits.append(fit)
    yaw, pitch = fits
    senses, warnings = _senses(tracks, links, yaw, pitch)
    angles = [_zeroed(tracks, s * fit.angles) for fit, s in zip(fits, senses, strict=True)]
    if _first_way(angles[0]) < 0.0:
        # A mirrored arm has the same distances: only the way that it turns shows the mirror.
        warnings += (
            "yaw turns to negative joint positions first: if it was moved to positive ones, the"
            " tracking volume is mirrored (the shape of an arm cannot show it)",
        )
    return HingesAbout(yaw, pitch, senses, np.stack(angles, axis=1), warnings)


def _first_way(angles: Array) -> float:
    """Return the sign of the first large swing."""
    known = angles[np.isfinite(angles)]
    return float(np.sign(known[np.argmax(np.abs(known) > 0.5 * np.abs(known).max())]))


def _fit_hinge(tracks: Tracks, a: str, b: str) -> HingeFit | None:
    if tracks.together(a, b).sum() < LEAST_SAMPLES:
        return None
    return fit_hinge(inverse(resting(tracks.poses[a])) @ tracks.poses[b])


def resting(T: Array) -> Array:
    """Return the mean pose of a body where it rests, else its poses."""
    rest = rest_pose(T) if np.isfinite(T[:, 0, 0]).sum() > LEAST_SAMPLES else None
    return T if rest is None else rest.pose


def _zeroed(tracks: Tracks, angles: Array) -> Array:
    """Count angles from a still start, or else from the middle of their range."""
    seen = np.flatnonzero(np.isfinite(angles))
    start = seen[tracks.times[seen] - tracks.times[seen[0]] <= _STILL_S]
    if np.ptp(angles[start]) < _STILL_RAD:
        return angles - angles[start].mean()
    return angles - 0.5 * (np.nanmin(angles) + np.nanmax(angles))


def _senses(
    tracks: Tracks, links: CentreLinks, yaw: HingeFit, pitch: HingeFit
) -> tuple[tuple[float, float], tuple[str, ...]]:
    """Tell whether the two directions found are those of the description, or their opposites."""
    arm = links.arm
    mechanism = arm.mechanism
    rest = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    at = poses(mechanism, rest, arm.root)
    origin, along, up = (
        at[links.frame(links.pitch)][:3, 3],
        at[links.frame(links.pitch)][:3, 2],
        at[links.frame(links.yaw)][:3, 2],
    )
    # Seen in the yaw body. The centre is where the yaw axis leaves the linkage.
    body = inverse(tracks.poses[links.yaw]) @ tracks.poses[links.body]
    away = np.nanmedian(body[:, :3, 3], axis=0) - pitch.point_a
    drawn = at[links.frame(links.body)][:3, 3] - origin
    first = float(np.sign((drawn @ up) * (away @ yaw.direction_b)))
    for name in links.beside:
        if name not in tracks.poses or (fit := _fit_hinge(tracks, links.pitch, name)) is None:
            continue
        poses_of = inverse(tracks.poses[links.yaw]) @ tracks.poses[links.pitch]
        points = poses_of[:, :3, :3] @ fit.point_a + poses_of[:, :3, 3] - pitch.point_a
        to_hinge = np.nanmedian(points, axis=0)
        nominal = np.cross(up, at[links.frame(name)][:3, 3] - origin) @ along
        found = np.cross(first * yaw.direction_b, to_hinge) @ pitch.direction_a
        return (first, float(np.sign(nominal * found))), ()
    words = (
        f"the direction of the pitch axis is undetermined without {' or '.join(links.beside)}: the"
        " signs of the pitch angle and of the axes across the yaw axis may be reversed"
    )
    return (first, 1.0), (words,)


@dataclass(frozen=True, eq=False)
class FrameError:
    """Effects of the error of the frame itself, of its two axes; one standard deviation each.

    Attributes:
        origin: along the frame's axes, (3,) [m]
        turn: about the frame's axes, (3,) [rad]
        position: of the centre in this frame, (3,) [m]
        spread: of the centre's spread in this frame, (3,) [m]
    """

    origin: Array
    turn: Array
    position: Array
    spread: Array


@dataclass(frozen=True, eq=False)
class Table7:
    """The centre in the frame of the first two joint axes, from the pitch axis.

    Attributes:
        position, sigma: (3,) [m]
        rms_axes: spread of the centre along each axis, (3,) [m]
        axes: the frame's axes as columns, in the base body at the start, (3, 3)
        frame: the part of the error that the frame brings
        centre_sigma: the part of `sigma` that the noise of the centre brings, (3,) [m]. The two
            have samples in common, so they make up `sigma` as squares only roughly
        distance: of the centre from the pitch axis [m]
    """

    position: Array
    sigma: Array
    rms_axes: Array
    axes: Array
    frame: FrameError
    centre_sigma: Array
    distance: Value

    def as_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "position_m": self.position.tolist(),
            "sigma": self.sigma.tolist(),
            "rms_xyz_m": self.rms_axes.tolist(),
        }


def table7(tracks: Tracks, links: CentreLinks, hinges: HingesAbout, fit: PivotFit) -> Table7:
    """Find the centre, from the pitch axis, in the frame of the first two joint axes.

    Args:
        tracks: of base and yaw link
        links: which bodies they are
        hinges: with both axes
        fit: of the centre in the base body
    """
    if hinges.yaw is None or hinges.pitch is None:
        raise InputError(f"{links.arm.name}: requires the yaw and the pitch axis, one is unknown")
    yaw, up, along = hinges.yaw, hinges.yaw.in_b, hinges.pitch.in_a
    turned = hinges.senses[0] * hinges.q[:, 0]
    centre, effect = _in_yaw_body(tracks, links, yaw, turned, fit)
    towards = np.array(TOWARDS.get(links.arm.type, TOWARDS["ECM"]))
    sense = hinges.senses[1]
    zero = np.nanmedian(yaw.angles - turned)
    at_start = yaw.before[:3, :3] @ rotation_z(zero) @ yaw.after[:3, :3]  # yaw body in the base
    away = (fit.points[fit.used] - fit.post) @ at_start
    x = np.concatenate([centre, along.point, along.direction, up.point, up.direction])
    frame = axes_frame(x, sense, towards)
    scatter = away.T @ away / len(away)

    def figures(x: Array) -> Array:
        """Return position, distance, the frame's origin and turn, and the spread, (13,)."""
        new = axes_frame(x, sense, towards)
        across = x[:3] - x[3:6] - (x[:3] - x[3:6]) @ x[6:9] * x[6:9]
        parts = (
            new[:3, :3].T @ (x[:3] - new[:3, 3]),
            [np.linalg.norm(across)],
            frame[:3, :3].T @ (new[:3, 3] - frame[:3, 3]),
            unskew(frame[:3, :3].T @ new[:3, :3]),
            np.sqrt(np.einsum("ij,jk,ki->i", new[:3, :3].T, scatter, new[:3, :3])),
        )
        return np.concatenate(parts, dtype=np.float64)

    slope = slopes(figures, x).T
    of_centre, of_frame = effect @ slope[:3], along.influence @ slope[3:9]
    of_frame = of_frame + up.influence @ slope[9:]
    sigma, centre_sigma, frame_sigma = (
        np.sqrt(np.sum(part**2, axis=0)) for part in (of_centre + of_frame, of_centre, of_frame)
    )
    value = figures(x)
    error = FrameError(frame_sigma[4:7], frame_sigma[7:10], frame_sigma[:3], frame_sigma[10:])
    axes = at_start @ frame[:3, :3]
    distance = Value(float(value[3]), float(sigma[3]))
    return Table7(value[:3], sigma[:3], value[10:], axes, error, centre_sigma[:3], distance)


def _in_yaw_body(
    tracks: Tracks, links: CentreLinks, yaw: HingeFit, turned: Array, fit: PivotFit
) -> tuple[Array, Array]:
    """Return the centre in the yaw body at yaw 0, (3,), and each sample's effect on it, (n, 3)."""
    at = inverse(tracks.poses[links.yaw]) @ resting(tracks.poses[links.base])
    # A centre that is off the yaw axis goes round it as the body turns: back to where it was.
    axis = yaw.in_b
    turn = matrix_from_rotation_vector(np.outer(turned, axis.direction))
    T = transform(turn, axis.point - turn @ axis.point) @ at
    points = T[:, :3, :3] @ fit.post + T[:, :3, 3]
    used = not_gross(np.linalg.norm(points - np.nanmedian(points, axis=0), axis=1))
    centre = points[used].mean(axis=0)
    effect = fit.influence[:, 3:] @ T[used, :3, :3].mean(axis=0).T
    effect[used] += (points[used] - centre) / used.sum()
    return centre, effect


@dataclass(frozen=True, eq=False)
class OwnCentre:
    """Position of a mechanism's remote centre, in the frame of its first two joint axes.

    Attributes:
        position: from the pitch axis, (3,) [m]
        cloud: the centre at each pose, about its mean, (n, 3) [m]
    """

    position: Array
    cloud: Array

    @property
    def rms_axes(self) -> Array:
        """Spread along each axis, (3,) [m]."""
        return np.asarray(np.sqrt(np.mean(self.cloud**2, axis=0)), dtype=np.float64)


def own_centre(mechanism: Mechanism, links: CentreLinks, q: Array) -> OwnCentre:
    """Find the remote centre of a mechanism by the same pivot calibration.

    Args:
        mechanism: whose
        links: of the same arm
        q: yaw and pitch of each pose, (n, 2) [rad]
    """
    turn, position, _, points = _own(mechanism, links, q)
    return OwnCentre(position, (points - points.mean(axis=0)) @ turn)


def own_wander(mechanism: Mechanism, links: CentreLinks, q: Array, pitch: Array) -> Array:
    """Return the displacement of a mechanism's own remote centre at yaw 0, (n, 3) [m].

    Args:
        mechanism: whose
        links: of the same arm
        q: yaw and pitch over which the centre is the point of smallest error, (k, 2) [rad]
        pitch: where it is missed, (n,) [rad]
    """
    turn, _, fit, _ = _own(mechanism, links, q)
    body = _body_poses(mechanism, links, np.stack([np.zeros(len(pitch)), pitch], axis=1))[1][1:]
    return (body[:, :3, :3] @ fit.tip + body[:, :3, 3] - fit.post) @ turn


def _body_poses(
    mechanism: Mechanism, links: CentreLinks, q: Array
) -> tuple[dict[str, Array], Array]:
    """Return the poses of all frames and of the body, at rest and then at yaw and pitch."""
    rest = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    every = np.tile(rest, (len(q) + 1, 1))
    every[1:, :2] = q
    at = poses(mechanism, every, mechanism.frames[0].name)
    return at, at[links.frame(links.body)]


def _own(
    mechanism: Mechanism, links: CentreLinks, q: Array
) -> tuple[Array, Array, PivotFit, Array]:
    """Return the frame's axes, the centre in it, its fit, and where each pose has it."""
    at, body = _body_poses(mechanism, links, q)
    body = body[1:]
    # Computed poses have no noise: plain least squares.
    fit = fit_pivot(body[:, :3, :3], body[:, :3, 3], rotation_sigma=1e-9)
    up, yaw = at[links.frame(links.yaw)][0, :3, 2], at[links.frame(links.yaw)][0, :3, 3]
    pitch = at[links.frame(links.pitch)][0]
    towards = np.array(TOWARDS.get(links.arm.type, TOWARDS["ECM"]))
    x = np.concatenate([fit.post, pitch[:3, 3], pitch[:3, 2], yaw, up])
    frame = axes_frame(x, 1.0, towards)
    turn, origin = frame[:3, :3], frame[:3, 3]
    points = body[:, :3, :3] @ fit.tip + body[:, :3, 3]
    return turn, turn.T @ (fit.post - origin), fit, points


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
        """Return the RMS wander of the centre itself, without noise [m]."""
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
    for name in names:
        if name not in links.all:
            raise InputError(f"bodies: got {name!r}; known: {', '.join(links.all)}")
    chosen = links.selected(tracks, names)
    check_together(chosen, links.base_in(chosen), links.body, LEAST_SAMPLES)
    return fit_rcm(chosen, links)


def fit_rcm(tracks: Tracks, links: CentreLinks) -> RcmReport:
    """Find the remote centre in tracks of the bodies that count.

    Args:
        tracks: under the description's names; without a base, the cameras' frame is taken for it
        links: which bodies they are

    Raises:
        UndeterminedError: all turns share one axis
    """
    warnings: list[str] = []
    based = links.base in tracks.poses
    if not based:
        warnings.append(f"{links.base} is not tracked: assuming a base fixed in the camera frame")
        rest = np.broadcast_to(np.eye(4), (len(tracks.times), 4, 4))
        tracks = replace(tracks, poses={**tracks.poses, links.base: rest})
    base, body = tracks.poses[links.base], tracks.poses[links.body]
    fit = _fit_pivot(tracks.times, base, body)
    noise_rms = _noise_rms(base, body, fit)
    hinges, wander = about_hinges(tracks, links), None
    moves = fit.rms > max(_WANDERS * noise_rms, _ROUNDING)
    pitch = _swept_pitch(tracks.times, hinges) if moves or fit.widened > 1.0 else None
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
        warnings += _slips(tracks, links)
    if fit.widened > 1.0 and noise_rms > _ROUNDING:
        warnings.append(
            "the residuals of the remote centre are correlated in time: noise is not white, and"
            f" standard deviations are widened {fit.widened:.1f} times"
        )
    cloud = over_cells(*centre_samples(hinges, fit))
    found = None if hinges.yaw is None else table7(tracks, links, hinges, fit)
    return RcmReport(
        arm=links.arm.name,
        body=links.body,
        base=links.base if based else "camera",
        fit=fit,
        noise_rms=noise_rms,
        cloud=cloud,
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
    """Return the turns by yaw in the base body, from yaw 0, (n, 4, 4)."""
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
    """Return the RMS of the distance R tip + p - post by noise from sample to sample [m]."""
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


def find_centre(tracks: Tracks, links: CentreLinks, first: Mapping[str, Axis]) -> RcmReport:
    """Find the remote centre (the paper's equations 3 and 4), and how far it is from the loops.

    Args:
        tracks: a sweep that turns the base's joint and the loops', under the description's names
        links: which bodies they are
        first: the first axis of the loops in the markers of each of its bodies, from their sweep

    Returns:
        the centre, its distance from the first axis as the sweep of the loops has that; where it
        is not tracked along with the centre, as the pivot's own sweep has it

    Raises:
        UndeterminedError: all turns share one axis
    """
    report = fit_rcm(tracks, links)
    body = next((b for b in first if b in tracks.poses), None)
    if body is None:
        return report
    poses = inverse(tracks.poses[body]) @ tracks.poses[links.body]
    distance = _from_axis(poses, first[body], report.fit)
    return report if distance is None else replace(report, distance=distance)


def _from_axis(poses: Array, axis: Axis, fit: PivotFit) -> Value | None:
    """Measure how far the centre is from an axis.

    Args:
        poses: of the body that turns about the centre, in the axis' body, (n, 4, 4)
        axis: in the markers of its body
        fit: the centre
    """
    poses = poses[fit.used]
    points = poses[:, :3, :3] @ fit.tip + poses[:, :3, 3]
    seen = np.isfinite(points[:, 0])
    if not seen.any():
        return None
    away = np.linalg.norm(points - np.median(points[seen], axis=0), axis=1)
    kept = not_gross(away)
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


#: Samples of a sweep that the mechanisms are computed at. Source: our own choice.
MOST = 2000


@dataclass(frozen=True, eq=False)
class Split:
    """A remote centre's place and cloud, in the frame of the first two joint axes, and its parts.

    Attributes:
        q: yaw and pitch of the samples that are compared, (n, 2) [rad]
        position: as measured, (3,) [m]
        cloud: as measured, about its mean, (n, 3) [m]
        drawn: the description's
        lengths: with the calibrated lengths, no axis leaning
        own: of the calibrated mechanism
        noise: what the cameras' noise makes of the spread along each axis [m]
    """

    q: Array
    position: Array
    cloud: Array
    drawn: OwnCentre
    lengths: OwnCentre
    own: OwnCentre
    noise: float

    @property
    def place(self) -> dict[str, Array]:
        """The parts of `position`, (3,) each [m]; their sum is `position`."""
        return {
            "description": self.drawn.position,
            "lengths": self.lengths.position - self.drawn.position,
            "axes": self.own.position - self.lengths.position,
            "left": self.position - self.own.position,
        }

    @property
    def clouds(self) -> dict[str, Array]:
        """The parts of `cloud`, (n, 3) each [m]; their sum, sample by sample, is `cloud`."""
        return {
            "lengths": self.lengths.cloud,
            "axes": self.own.cloud - self.lengths.cloud,
            "left": self.cloud - self.own.cloud,
        }

    @property
    def unexplained(self) -> Array:
        """Spread that is left along each axis with the noise taken off as squares, (3,) [m]."""
        left = np.mean(self.clouds["left"] ** 2, axis=0)
        return np.asarray(np.sqrt(np.maximum(left - self.noise**2, 0.0)), dtype=np.float64)


def split_centre(seen: RcmReport, arm: ArmDescription, lengths: Mechanism, own: Mechanism) -> Split:
    """Split the remote centre of a calibration.

    Args:
        seen: the remote centre, with Table 7
        arm: the description that was calibrated
        lengths: calibrated, without axes that lean (`lengths_only`)
        own: calibrated
    """
    if seen.table7 is None:
        raise InputError(f"{arm.name}: requires the yaw and the pitch axis, one is unknown")
    links = centre_links(arm)
    q, points = (part[:: 1 + len(part) // MOST] for part in centre_samples(seen.hinges, seen.fit))
    of_drawn, of_lengths, of_own = (
        own_centre(mechanism, links, q) for mechanism in (arm.mechanism, lengths, own)
    )
    return Split(
        q=q,
        position=seen.table7.position,
        cloud=(points - points.mean(axis=0)) @ seen.table7.axes,
        drawn=of_drawn,
        lengths=of_lengths,
        own=of_own,
        noise=seen.noise_rms / float(np.sqrt(3.0)),
    )
