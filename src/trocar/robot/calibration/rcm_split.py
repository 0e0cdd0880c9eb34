"""What makes a measured remote centre differ from the description's: lengths, axes, frame, noise.

Three mechanisms go through the poses of the measured sweep: the description, the calibrated one,
and between them one whose links are as long as calibrated, and stand in the linkage's plane as
measured, but whose axes do not lean: those of its loops are parallel, and across the yaw axis.
What each step changes is the part of its cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay import apply_overlay
from trocar.errors import InputError
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.calibration.axes import BaseAxis
from trocar.robot.calibration.calibrate import Calibration
from trocar.robot.calibration.placement import calibrated, remote_centre_of
from trocar.robot.calibration.rcm import RcmReport, centre_samples
from trocar.robot.calibration.rcm_frame import OwnCentre, centre_links, own_centre

Array = NDArray[np.float64]

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


def split_centre(found: Calibration, seen: RcmReport, arm: ArmDescription) -> Split:
    """Split the remote centre of a calibration.

    Args:
        found: the calibration
        seen: its remote centre, with Table 7
        arm: the description that was calibrated
    """
    if seen.table7 is None:
        raise InputError(f"{arm.name}: requires the yaw and the pitch axis, one is unknown")
    links = centre_links(arm)
    q, points = (part[:: 1 + len(part) // MOST] for part in centre_samples(seen.hinges, seen.fit))
    drawn, lengths, own = (
        own_centre(mechanism, links, q)
        for mechanism in (
            arm.mechanism,
            lengths_only(found, arm, seen.hinges.base_axis),
            apply_overlay(arm, found.overlay).mechanism,
        )
    )
    return Split(
        q=q,
        position=seen.table7.position,
        cloud=(points - points.mean(axis=0)) @ seen.table7.axes,
        drawn=drawn,
        lengths=lengths,
        own=own,
        noise=seen.noise_rms / float(np.sqrt(3.0)),
    )


def lengths_only(found: Calibration, arm: ArmDescription, on: BaseAxis | None) -> Mechanism:
    """Return a calibrated arm none of whose axes leans out of the plane of its linkage.

    Args:
        found: the calibration
        arm: the description that was calibrated
        on: the axis that the calibrated linkage stands on, where it was measured
    """
    robot = replace(found.refined.robot, tilts={})
    linkage = robot.linkage
    centre = remote_centre_of(arm, linkage)
    if centre is not None and on is not None and found.closure == "general":
        markers = robot.markers[linkage.ground][:3, :3]
        up = markers.T @ linkage.plane[:, 2]
        flat = on.direction - (on.direction @ up) * up
        centre = replace(centre, axis=replace(on, direction=flat / np.linalg.norm(flat)))
    return calibrated(arm, robot, centre)
