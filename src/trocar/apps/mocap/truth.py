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


def geometry(arm: ArmDescription, base_cluster: Array, swing: Array | None) -> dict[str, Any]:
    """Return axis distances, angles and the remote centre, as `trocar calibrate` names them.

    A remote centre that wanders is the point that fits best, told with how far the link that
    carries the instrument misses it.

    Args:
        arm: as it is
        base_cluster: the marker cluster on the arm's root, T_root_cluster (4, 4)
        swing: joint positions about the remote centre, (n, n_joints); None where there is none
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
    if swing is not None:
        end = poses(mechanism, swing, arm.root)[mechanism.closures[-1].frame_b]
        centre, misses = _fixed_point(end)
        pitch = axes[next(iter(plan.axes))]
        seen = inverse(base_cluster) @ np.append(centre, 1.0)
        found["rcm"] = {
            "position_in_base_body_m": seen[:3].tolist(),
            "distance_to_pitch_axis_m": _distance(pitch, (centre, pitch[1])),
            "rms_m": float(np.sqrt((misses**2).sum(axis=1).mean())),
        }
    return found


def _fixed_point(poses: Array) -> tuple[Array, Array]:
    """Return the point that a body keeps stillest, (3,), and how far it misses it, (n, 3) [m].

    Source: closed-loop paper, equations 3 and 4.
    """
    R, p = poses[:, :3, :3], poses[:, :3, 3]
    rows = np.concatenate([R, np.broadcast_to(-np.eye(3), R.shape)], axis=2).reshape(-1, 6)
    both, *_ = np.linalg.lstsq(rows, -p.reshape(-1), rcond=None)
    tip, post = both[:3].astype(np.float64), both[3:].astype(np.float64)
    return post, R @ tip + p - post


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
