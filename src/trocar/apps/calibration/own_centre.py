"""The remote centre that a mechanism has by itself, told as the tracks tell a real one's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.calibration.rcm_frame import TOWARDS, CentreLinks, axes_frame
from trocar.fitting import fit_pivot
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]


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
    rest = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    every = np.tile(rest, (len(q) + 1, 1))
    every[1:, :2] = q
    root = mechanism.frames[0].name
    at = poses(mechanism, every, root)
    body = at[links.frame(links.body)][1:]
    # Computed poses have no noise: plain least squares.
    fit = fit_pivot(body[:, :3, :3], body[:, :3, 3], rotation_sigma=1e-9)
    up, yaw = at[links.frame(links.yaw)][0, :3, 2], at[links.frame(links.yaw)][0, :3, 3]
    pitch = at[links.frame(links.pitch)][0]
    towards = np.array(TOWARDS.get(links.arm.type, TOWARDS["ECM"]))
    x = np.concatenate([fit.post, pitch[:3, 3], pitch[:3, 2], yaw, up])
    frame = axes_frame(x, 1.0, towards)
    turn, origin = frame[:3, :3], frame[:3, 3]
    points = body[:, :3, :3] @ fit.tip + body[:, :3, 3]
    return OwnCentre(turn.T @ (fit.post - origin), (points - points.mean(axis=0)) @ turn)
