"""The remote centre relative to an arm's pitch axis, as the closed-loop paper's Table 7 has it.

The frame: its origin is the point of the pitch axis nearest to the yaw axis, z points along the
pitch axis as the description has it, and one of x, y along the yaw axis, such that the nominal
centre is (0, -0.516, 0) m for a PSM and (0.340, 0, 0) m for an ECM, as in the paper. It turns
with the yaw link, in which the centre rests; spreads are told in it as it stands at the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import TOWARDS, axes_frame
from trocar.errors import InputError
from trocar.fitting import (
    LEAST_SPAN,
    HingeFit,
    PivotFit,
    fit_hinge,
    fit_pivot,
    not_gross,
    rest_pose,
)
from trocar.geometry import inverse, rotation_z, transform
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.calibration.axes import LEAST_SAMPLES, BaseAxis, Value, slopes
from trocar.robot.calibration.linkage import bodies_of, unskew
from trocar.robot.calibration.tracks import Tracks

Array = NDArray[np.float64]

# Source: our own choice; a start that is still for so long gives the zero of the angles. [s], [rad]
_STILL_S, _STILL_RAD = 0.5, 0.01


@dataclass(frozen=True, eq=False)
class CentreLinks:
    """Which bodies of an arm tell of its remote centre.

    Attributes:
        arm: whose
        base, body: where it rests, and what turns about it
        yaw, pitch: the bodies that the first two joints turn
        beside: bodies on hinges of the pitch body, which tell the sense of the pitch axis
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
    """Return which bodies tell of an arm's remote centre.

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
    """What the error of the frame itself, of its two axes, does; one standard deviation each.

    Attributes:
        origin: along the frame's axes, (3,) [m]
        turn: about the frame's axes, (3,) [rad]
        position: of the centre told in it, (3,) [m]
        spread: of the centre's spread told in it, (3,) [m]
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
    T = inverse(tracks.poses[links.yaw]) @ resting(tracks.poses[links.base])
    # A centre that is off the yaw axis goes round it as the body turns: back to where it was.
    axis = yaw.in_b
    turn = matrix_from_rotation_vector(np.outer(turned, axis.direction))
    T = transform(turn, axis.point - turn @ axis.point) @ T
    points = T[:, :3, :3] @ fit.post + T[:, :3, 3]
    used = not_gross(np.linalg.norm(points - np.nanmedian(points, axis=0), axis=1))
    centre = points[used].mean(axis=0)
    effect = fit.influence[:, 3:] @ T[used, :3, :3].mean(axis=0).T
    effect[used] += (points[used] - centre) / used.sum()
    return centre, effect


@dataclass(frozen=True, eq=False)
class OwnCentre:
    """Where a mechanism's remote centre is, in the frame of its first two joint axes.

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
    """Return by how much a mechanism misses its own remote centre at yaw 0, (n, 3) [m].

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
