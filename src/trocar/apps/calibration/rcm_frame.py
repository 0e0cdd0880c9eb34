"""The remote centre relative to an arm's pitch axis, as the closed-loop paper's Table 7 has it.

The frame: its origin is the point of the pitch axis nearest to the yaw axis, z points along the
pitch axis as the description has it, and one of x, y along the yaw axis, such that the nominal
centre is (0, -0.516, 0) m for a PSM and (0.340, 0, 0) m for an ECM, as in the paper. It turns
with the yaw link, in which the centre rests; spreads are told in it as it stands at the start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.axes import LEAST_SAMPLES
from trocar.apps.calibration.tracks import Tracks
from trocar.descriptions import ArmDescription
from trocar.errors import InputError
from trocar.fitting import (
    LEAST_SPAN,
    HingeFit,
    fit_hinge,
    rest_pose,
)
from trocar.geometry import inverse, transform
from trocar.kinematics.forward import poses

Array = NDArray[np.float64]

#: Where the direction from the pitch axis to the centre points in the paper's frame.
#: Source: closed-loop paper, Table 7. The sense of the axis across both is not told; it is ours.
TOWARDS: dict[str, tuple[float, float, float]] = {"PSM": (0.0, -1.0, 0.0), "ECM": (1.0, 0.0, 0.0)}
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
    name = {f.name: f"{arm.name}_{_body(arm, f.name)}" for f in mechanism.frames}
    yaw, pitch = (joint.drive[0][0] for joint in mechanism.joints[:2])
    beside = [
        name[f.name]
        for f in mechanism.frames
        if f.motion == "revolute" and f.parent and name[f.parent] == name[pitch]
    ]
    return CentreLinks(
        arm, name[arm.root], name[str(slide.parent)], name[yaw], name[pitch], tuple(beside)
    )


def _body(arm: ArmDescription, name: str) -> str:
    frame = arm.mechanism.frame(name)
    while frame.motion == "fixed" and frame.parent is not None:
        frame = arm.mechanism.frame(frame.parent)
    return frame.name


def about_hinges(tracks: Tracks, links: CentreLinks) -> HingesAbout:
    """Find the yaw and the pitch axis, as far as they are tracked and turn."""
    nothing = np.full((len(tracks.times), 2), np.nan)
    fits: list[HingeFit] = []
    for what, a, b in (("yaw", links.base, links.yaw), ("pitch", links.yaw, links.pitch)):
        lost = [name for name in (a, b) if name not in tracks.poses]
        fit = None if lost else _fit(tracks, a, b)
        if fit is None or fit.span < LEAST_SPAN:
            why = (
                f"{', '.join(lost)} not tracked" if lost
                else f"{a} and {b} are not seen together" if fit is None
                else f"{b} turns by {fit.span:.3f} rad in {a}, {LEAST_SPAN} rad wanted"
            )  # fmt: skip
            words = f"no {what} axis ({why}): no cloud over the joints, and no Table 7"
            return HingesAbout(None, None, (1.0, 1.0), nothing, (words,))
        fits.append(fit)
    yaw, pitch = fits
    senses, warnings = _senses(tracks, links, yaw, pitch)
    angles = [_zeroed(tracks, s * fit.angles) for fit, s in zip(fits, senses, strict=True)]
    return HingesAbout(yaw, pitch, senses, np.stack(angles, axis=1), warnings)


def _fit(tracks: Tracks, a: str, b: str) -> HingeFit | None:
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
        if name not in tracks.poses or (fit := _fit(tracks, links.pitch, name)) is None:
            continue
        poses_of = inverse(tracks.poses[links.yaw]) @ tracks.poses[links.pitch]
        points = poses_of[:, :3, :3] @ fit.point_a + poses_of[:, :3, 3] - pitch.point_a
        to_hinge = np.nanmedian(points, axis=0)
        nominal = np.cross(up, at[links.frame(name)][:3, 3] - origin) @ along
        found = np.cross(first * yaw.direction_b, to_hinge) @ pitch.direction_a
        return (first, float(np.sign(nominal * found))), ()
    words = (
        f"which way the pitch axis points is not known without {' or '.join(links.beside)}: the"
        " signs of the pitch angle and of the axes across the yaw axis may be reversed"
    )
    return (first, 1.0), (words,)


def axes_frame(x: Array, sense: float, towards: Array) -> Array:
    """Return the frame of the first two joint axes, (4, 4).

    Args:
        x: the centre, then point and direction of the pitch axis, then of the yaw axis, (15,)
        sense: +1 or -1, by which the pitch axis is told along the description's
        towards: where in the paper's frame the centre lies, (3,)
    """
    centre, g, h, y, k = x.reshape(5, 3)
    z = sense * h
    # The point of the pitch axis nearest to the yaw axis.
    across = np.cross(k, np.cross(h, k))
    origin = g + h * float((y - g) @ across / (h @ across))
    up = k - (k @ z) * z
    up *= np.sign(up @ (centre - origin)) / np.linalg.norm(up)
    side = np.cross(z, up)
    across_axes = np.column_stack([up, side, z])
    drawn = np.column_stack([towards, np.cross([0.0, 0.0, 1.0], towards), [0.0, 0.0, 1.0]])
    return transform(across_axes @ drawn.T, origin)
