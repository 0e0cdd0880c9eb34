"""Where the shaft of a remote-centre arm points, and which yaw and pitch point it there.

Frame 0 is the remote centre; frame 3 moves with the insertion, its z axis along the shaft. Its axes
in frame 0 follow from the modified DH rows (alpha, theta) = (pi/2, q1 + pi/2), (-pi/2, q2 - pi/2)
and (pi/2, 0).

Source: the dVRK's kinematics of PSM and ECM (sawIntuitiveResearchKit, PSM.json and ECM.json).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def shaft_axes(q1: Array, q2: Array) -> tuple[Array, Array, Array]:
    """Give the axes of frame 3 in frame 0.

    Args:
        q1: yaw, (...) [rad]
        q2: pitch, (...) [rad]

    Returns:
        x, y and z of frame 3, (..., 3) each; z is along the shaft, towards the tip
    """
    s1, c1, s2, c2 = np.sin(q1), np.cos(q1), np.sin(q2), np.cos(q2)
    x = np.stack([-s1 * s2, -c2, c1 * s2], axis=-1)
    y = np.stack([-c1, np.zeros_like(c1), -s1], axis=-1)
    z = np.stack([s1 * c2, -s2, -c1 * c2], axis=-1)
    return x, y, z


def shaft_angles(direction: Array) -> tuple[Array, Array, Array]:
    """Give both pairs of yaw and pitch that point the shaft along a direction.

    Args:
        direction: unit vectors in frame 0, (..., 3)

    Returns:
        yaw (..., 2) [rad]; pitch (..., 2) [rad], the first with |pitch| <= pi/2, the second over
        the top; and the cosine of the pitch (...), where 0 means that any yaw would do
    """
    level = np.hypot(direction[..., 0], direction[..., 2])
    yaw = np.arctan2(direction[..., 0], -direction[..., 2])
    pitch = np.arctan2(-direction[..., 1], level)
    yaws = np.stack([yaw, yaw + np.pi], axis=-1)
    return yaws, np.stack([pitch, np.pi - pitch], axis=-1), level
