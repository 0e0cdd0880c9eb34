"""Errors of closed loops, from the coordinates that a simulation reached."""

from __future__ import annotations

import logging
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.kinematics.loops import (
    NEAR_FLAT_RAD,
    branch_determinants,
    closed_coordinates,
    coupled_coordinates,
    flattenings,
    gaps,
)
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.tree import frame_poses
from trocar.simulation.records import ArmHealth

Array = NDArray[np.float64]


log = logging.getLogger("trocar")

#: Multiples of their square roots spread samples over the joint range, no joint with another.
PRIMES = (2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0)
WANDER_SAMPLES = 256


def warn_near_singular(rig: RigDescription) -> None:
    """Warn of arms whose joint ranges come close to where a loop may change its branch."""
    for name, arm in {a.arm.mechanism: (a.name, a.arm) for a in rig.arms}.values():
        margin = flattening_margin(arm.mechanism)
        if margin < NEAR_FLAT_RAD:
            log.warning(
                "%s: a loop of %s is singular %.3f rad from the joint range;"
                " allowed: %g rad or more",
                name,
                arm.name,
                margin,
                NEAR_FLAT_RAD,
            )


def arm_health(arm: ArmDescription, coordinates: Array) -> ArmHealth:
    """Return the worst over samples of every frame's coordinate, (..., n_frames)."""
    mechanism = arm.mechanism
    gap = gaps(mechanism, coordinates)
    rcm = remote_centre_error(mechanism, coordinates)
    right = branch_determinants(mechanism, coordinates) * _built_branch(mechanism) > 0.0
    return ArmHealth(
        loop_gap_m=float(gap.max(initial=0.0)),
        rcm_error_m=float("nan") if rcm is None else float(rcm.max(initial=0.0)),
        branch_ok=bool(right.all()),
        flattening_margin_rad=flattening_margin(mechanism),
        rcm_wander_m=remote_centre_wander(mechanism),
    )


@lru_cache(maxsize=64)
def remote_centre_wander(mechanism: Mechanism) -> float:
    """Compute the largest distance of the shaft from its remote centre by the arm's geometry [m].

    A calibrated arm whose loops are no parallelograms, or whose axes are askew, has no fixed
    remote centre. Over the joint range, loops closed; 0 for an arm without a remote centre.
    """
    if "rcm" not in mechanism.frame_index:
        return 0.0
    spread = np.resize(np.sqrt(np.array(PRIMES)), len(mechanism.joints))
    share = np.outer(np.arange(WANDER_SAMPLES), spread) % 1.0
    q = mechanism.lower + share * (mechanism.upper - mechanism.lower)
    error = remote_centre_error(mechanism, closed_coordinates(mechanism, q))
    return 0.0 if error is None else float(error.max())


def remote_centre_error(mechanism: Mechanism, coordinates: Array) -> Array | None:
    """Return the distance of the instrument's shaft from the remote centre, (...) [m].

    The shaft is the z axis of the frame that the insertion moves. None when the arm has neither.
    """
    if "rcm" not in mechanism.frame_index or "insertion" not in mechanism.frame_index:
        return None
    frames = sorted({*mechanism.chain("rcm"), *mechanism.chain("insertion")})
    poses = frame_poses(mechanism, coordinates, frames)
    centre = poses[mechanism.frame_index["rcm"]][..., :3, 3]
    shaft = poses[mechanism.frame_index["insertion"]]
    return np.linalg.norm(np.cross(centre - shaft[..., :3, 3], shaft[..., :3, 2]), axis=-1)


@lru_cache(maxsize=64)
def flattening_margin(mechanism: Mechanism) -> float:
    """Return the distance of the joint range from a flat loop [rad], inf without loops."""
    return min((f.margin for f in flattenings(mechanism)), default=float("inf"))


@lru_cache(maxsize=64)
def _built_branch(mechanism: Mechanism) -> Array:
    """Return the sign of each loop's determinant at rest, (n_closures,)."""
    rest = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    return np.sign(branch_determinants(mechanism, coupled_coordinates(mechanism, rest)))
