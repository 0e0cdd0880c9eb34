"""What a calibration should find: the geometry of the arm that was before the cameras."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import Pair, default_plan
from trocar.descriptions.records import ArmDescription
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]


def geometry(
    arm: ArmDescription, bodies: Mapping[str, str], clusters: Mapping[str, Array]
) -> dict[str, Any]:
    """Return axis distances, angles and the remote centre, as `trocar calibrate` names them.

    Args:
        arm: as it is
        bodies: {body: frame} of the marker clusters
        clusters: {body: T_link_cluster (4, 4)}
    """
    mechanism = arm.mechanism
    zero = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    at = poses(mechanism, zero, arm.root)
    plan = arm.calibration or default_plan(mechanism)
    axes = {label: _axis(mechanism, at, name) for label, name in plan.axes.items()}
    found: dict[str, Any] = {
        "axis_distances_m": {f"{a}-{b}": _distance(axes[a], axes[b]) for a, b in plan.distances}
    }
    if plan.betas:
        found["beta_rad"] = {
            name: _angle(_line(axes, one), _line(axes, two), axes[two[0]][1]) - 0.5 * np.pi
            for name, (one, two) in plan.betas.items()
        }
    if "rcm" in mechanism.frame_index:
        centre, root = at["rcm"], f"{arm.name}_{arm.root}"
        pitch = axes[next(iter(plan.axes))]
        body = at[bodies[root]] @ clusters[root]
        found["rcm"] = {
            "position_in_base_body_m": (inverse(body) @ centre)[:3, 3].tolist(),
            "distance_to_pitch_axis_m": _distance(pitch, (centre[:3, 3], pitch[1])),
        }
    return found


def _axis(mechanism: Mechanism, at: Mapping[str, Array], name: str) -> tuple[Array, Array]:
    """Return point and direction of the axis that a frame moves about, or of a closing hinge."""
    if name in mechanism.frame_index and mechanism.frame(name).parent is not None:
        frame = mechanism.frame(name)  # a standard DH row puts its frame off its axis
        axis = at[frame.parent or ""] @ frame.before
        return axis[:3, 3], axis[:3, 2]
    return at[name][:3, 3], at[name][:3, 2]


def _line(axes: Mapping[str, tuple[Array, Array]], pair: Pair) -> Array:
    """Return what leads from the first axis of a pair to the second, (3,) [m]."""
    return axes[pair[1]][0] - axes[pair[0]][0]


def _distance(one: tuple[Array, Array], two: tuple[Array, Array]) -> float:
    """Return the distance of two axes across their mean direction [m]."""
    along = one[1] + two[1]
    along = along / np.linalg.norm(along)
    between = two[0] - one[0]
    return float(np.linalg.norm(between - (between @ along) * along))


def _angle(one: Array, two: Array, normal: Array) -> float:
    """Return the angle of two vectors as seen along a normal [rad]."""
    one, two = (v - (v @ normal) * normal for v in (one, two))
    return float(np.arctan2(np.linalg.norm(np.cross(one, two)), one @ two))
