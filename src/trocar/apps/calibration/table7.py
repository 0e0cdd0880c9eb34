"""The remote centre in the frame of the first two joint axes, with what its error comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.rcm_frame import TOWARDS, CentreLinks, HingesAbout, axes_frame, resting
from trocar.apps.calibration.tracks import Tracks
from trocar.errors import InputError
from trocar.fitting import PivotFit, not_gross
from trocar.geometry import inverse, rotation_z, transform
from trocar.geometry.rotations import matrix_from_rotation_vector

Array = NDArray[np.float64]

# Source: our own choice; everything here is smooth on this scale. [m, rad]
_STEP = 1e-6


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
    """

    position: Array
    sigma: Array
    rms_axes: Array
    axes: Array
    frame: FrameError
    centre_sigma: Array

    def as_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "position_m": self.position, "sigma": self.sigma, "rms_xyz_m": self.rms_axes,
        }  # fmt: skip


def table7(
    tracks: Tracks, links: CentreLinks, hinges: HingesAbout, fit: PivotFit
) -> tuple[Table7, tuple[float, float]]:
    """Tell the centre from the pitch axis in the frame of the first two joint axes.

    Args:
        tracks: of base and yaw link
        links: which bodies they are
        hinges: with both axes
        fit: of the centre in the base body

    Returns:
        the centre in that frame, and its distance from the pitch axis with its 1-sigma [m]
    """
    if hinges.yaw is None or hinges.pitch is None:
        raise InputError(f"{links.arm.name}: yaw and pitch axis wanted, one is not known")
    up, along = hinges.yaw.in_b, hinges.pitch.in_a
    centre, effect = _in_yaw_body(tracks, links, hinges, fit)
    towards = np.array(TOWARDS.get(links.arm.type, TOWARDS["ECM"]))
    sense, at_start = hinges.senses[1], _at_start(hinges)
    away = (fit.points[fit.used] - fit.post) @ at_start
    x = np.concatenate([centre, along.point, along.direction, up.point, up.direction])
    frame = axes_frame(x, sense, towards)
    # Told of the scatter matrix, the spread is as quickly found for each of the steps below.
    scatter = away.T @ away / len(away)

    def told(x: Array) -> Array:
        """Return position, distance, the frame's origin and turn, and the spread, (13,)."""
        new = axes_frame(x, sense, towards)
        turn = frame[:3, :3].T @ new[:3, :3]
        across = x[:3] - x[3:6] - (x[:3] - x[3:6]) @ x[6:9] * x[6:9]
        parts = np.concatenate(
            [
                new[:3, :3].T @ (x[:3] - new[:3, 3]),
                [np.linalg.norm(across)],
                frame[:3, :3].T @ (new[:3, 3] - frame[:3, 3]),
                0.5 * np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
                - 0.5 * np.array([turn[1, 2], turn[2, 0], turn[0, 1]]),
                np.sqrt(np.einsum("ij,jk,ki->i", new[:3, :3].T, scatter, new[:3, :3])),
            ]
        )
        return np.asarray(parts, dtype=np.float64)

    slope = _slope(told, x).T
    of_centre, of_frame = effect @ slope[:3], along.influence @ slope[3:9]
    of_frame = of_frame + up.influence @ slope[9:]
    sigma, centre_sigma, frame_sigma = (
        np.sqrt(np.sum(part**2, axis=0)) for part in (of_centre + of_frame, of_centre, of_frame)
    )
    value = told(x)
    error = FrameError(frame_sigma[4:7], frame_sigma[7:10], frame_sigma[:3], frame_sigma[10:])
    axes = at_start @ frame[:3, :3]
    found = Table7(value[:3], sigma[:3], value[10:], axes, error, centre_sigma[:3])
    return found, (float(value[3]), float(sigma[3]))


def _in_yaw_body(
    tracks: Tracks, links: CentreLinks, hinges: HingesAbout, fit: PivotFit
) -> tuple[Array, Array]:
    """Return the centre in the yaw body at yaw 0, (3,), and each sample's effect on it, (n, 3)."""
    T = inverse(tracks.poses[links.yaw]) @ resting(tracks.poses[links.base])
    if hinges.yaw is not None:
        # A centre that is off the yaw axis goes round it as the body turns: back to where it was.
        axis = hinges.yaw.in_b
        turn = matrix_from_rotation_vector(
            np.outer(hinges.senses[0] * hinges.q[:, 0], axis.direction)
        )
        T = transform(turn, axis.point - turn @ axis.point) @ T
    points = T[:, :3, :3] @ fit.post + T[:, :3, 3]
    away = np.linalg.norm(points - np.nanmedian(points, axis=0), axis=1)
    used = not_gross(away)
    centre = points[used].mean(axis=0)
    effect = fit.influence[:, 3:] @ T[used, :3, :3].mean(axis=0).T
    effect[used] += (points[used] - centre) / used.sum()
    return centre, effect


def _at_start(hinges: HingesAbout) -> Array:
    """Return the rotation of the yaw body in the base where its angle is 0, (3, 3)."""
    fit = hinges.yaw
    if fit is None:
        return np.eye(3)
    zero = np.nanmedian(fit.angles - hinges.senses[0] * hinges.q[:, 0])
    return fit.before[:3, :3] @ rotation_z(zero) @ fit.after[:3, :3]


def _slope(of: Callable[[Array], Array], x: Array) -> Array:
    """Return the derivative of a function of x, (m, n), by central differences."""
    steps = _STEP * np.eye(len(x))
    return np.stack([(of(x + s) - of(x - s)) / (2.0 * _STEP) for s in steps], axis=1)
