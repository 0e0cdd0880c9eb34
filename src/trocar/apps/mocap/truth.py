"""What a calibration should find: the geometry of the arm that was before the cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.axis_lines import Line, home_lines, line_angle, line_distance
from trocar.descriptions.calibration_plan import default_plan, hinge_side
from trocar.descriptions.records import ArmDescription
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import poses

Array = NDArray[np.float64]


def geometry(arm: ArmDescription, base_cluster: Array, swing: Array | None) -> dict[str, Any]:
    """Return axis distances, angles and the remote centre, as `trocar calibrate` names them.

    A remote centre that wanders is the point that fits best, told with how far the link that
    carries the instrument misses it.

    Distances and angles of axes are told in the plane across them through the origin of the first
    axis' frame (see `descriptions.axis_lines`).

    Args:
        arm: as it is
        base_cluster: the marker cluster on the arm's root, T_root_cluster (4, 4)
        swing: joint positions about the remote centre, (n, n_joints); None where there is none
    """
    mechanism = arm.mechanism
    plan = arm.calibration or default_plan(mechanism)
    axes = home_lines(mechanism, plan.axes)
    pitch = next(iter(axes.values()))
    found: dict[str, Any] = {
        "axis_distances_m": {
            f"{a}-{b}": line_distance(axes[a], axes[b], pitch.point) for a, b in plan.distances
        }
    }
    if plan.betas:
        found["beta_rad"] = {
            name: line_angle(
                (axes[to[0]], axes[to[1]]), (axes[start[0]], axes[start[1]]), pitch.point
            )
            - 0.5 * np.pi
            for name, (to, start) in plan.betas.items()
        }
    if swing is not None:
        body, _ = hinge_side(mechanism, mechanism.closures[-1])
        end = poses(mechanism, swing, arm.root)[body]
        centre, misses = _fixed_point(end)
        seen = inverse(base_cluster) @ np.append(centre, 1.0)
        found["rcm"] = {
            "position_in_base_body_m": seen[:3].tolist(),
            "distance_to_pitch_axis_m": line_distance(pitch, Line(centre, pitch.direction), centre),
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
