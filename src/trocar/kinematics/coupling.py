"""Linear couplings between actuators and joints: position, velocity and effort, both ways.

q_joint = A q_actuator, hence v_joint = A v_actuator; and as power is the same on both sides,
tau_actuator = A^T tau_joint.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError

Array = NDArray[np.float64]

# Source: our choice; above it a coupling loses more than four of the sixteen digits.
_WORST_CONDITION = 1e4


@dataclass(frozen=True, eq=False)
class Coupling:
    """Matrix of actuators that drive joints together.

    Attributes:
        actuator_to_joint: A, (n, n); kept as a read-only copy
        joints: names of the joints, where they have some
        joint_to_actuator: its inverse, (n, n), read-only

    Raises:
        InputError: A is not square, not finite, or cannot be inverted
    """

    actuator_to_joint: Array
    joints: tuple[str, ...] = ()
    joint_to_actuator: Array = field(init=False)

    def __post_init__(self) -> None:
        """Check and keep the matrix, and invert it."""
        matrix = np.array(self.actuator_to_joint, dtype=np.float64)
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.size == 0:
            raise InputError(f"coupling: expected a square matrix, got shape {matrix.shape}")
        if not np.isfinite(matrix).all():
            raise InputError(f"coupling: expected finite numbers, got {matrix.tolist()}")
        condition = float(np.linalg.cond(matrix))
        if not condition < _WORST_CONDITION:
            raise InputError(
                f"coupling: expected an invertible matrix, got condition {condition:.3g} "
                f"(allowed {_WORST_CONDITION:g})"
            )
        inverse = np.linalg.inv(matrix)
        for name, value in (("actuator_to_joint", matrix), ("joint_to_actuator", inverse)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)


def joint_from_actuator(coupling: Coupling, actuator: ArrayLike) -> Array:
    """Return joint positions from actuator positions, or joint velocities from actuator velocities.

    Args:
        coupling: n actuators to n joints
        actuator: (..., n) [rad or m, or per s]

    Returns:
        (..., n) [rad or m, or per s]
    """
    return _checked(coupling, actuator) @ coupling.actuator_to_joint.T


def actuator_from_joint(coupling: Coupling, joint: ArrayLike) -> Array:
    """Compute actuator positions (velocities) from joint positions (velocities).

    Args:
        coupling: n actuators to n joints
        joint: (..., n) [rad or m, or per s]

    Returns:
        (..., n) [rad or m, or per s]
    """
    return _checked(coupling, joint) @ coupling.joint_to_actuator.T


def joint_effort_from_actuator(coupling: Coupling, effort: ArrayLike) -> Array:
    """Compute joint efforts from actuator efforts: tau_joint = A^-T tau_actuator.

    Args:
        coupling: n actuators to n joints
        effort: (..., n) [N m or N]

    Returns:
        (..., n) [N m or N]
    """
    return _checked(coupling, effort) @ coupling.joint_to_actuator


def actuator_effort_from_joint(coupling: Coupling, effort: ArrayLike) -> Array:
    """Compute actuator efforts from joint efforts: tau_actuator = A^T tau_joint.

    Args:
        coupling: n actuators to n joints
        effort: (..., n) [N m or N]

    Returns:
        (..., n) [N m or N]
    """
    return _checked(coupling, effort) @ coupling.actuator_to_joint


def _checked(coupling: Coupling, values: ArrayLike) -> Array:
    array, n = np.asarray(values, dtype=np.float64), len(coupling.actuator_to_joint)
    if array.ndim == 0 or array.shape[-1] != n:
        raise InputError(f"coupling: expected {n} values along the last axis, got {array.shape}")
    return array
