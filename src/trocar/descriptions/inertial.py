"""Loads of masses on the motors, and the combined mass of bodies that move together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import ArmDescription, Body
from trocar.kinematics.forward import coordinates, pose
from trocar.kinematics.jacobian import jacobian_spatial
from trocar.kinematics.loops import coordinate_rates

Array = NDArray[np.float64]

STANDARD_GRAVITY = 9.81  # as in every model of ours [m/s^2]


def holding_efforts(arm: ArmDescription, q: ArrayLike, down: ArrayLike = (0, 0, -1)) -> Array:
    """Return the efforts that hold an arm still against gravity.

    By virtual work: effort_j = -sum_b m_b g . d com_b / d q_j, loops included.

    Args:
        arm: the arm with its tool
        q: joint positions, (..., n) [rad or m]
        down: unit direction of gravity in the arm's reference frame, (3,)

    Returns:
        (..., n) [N m or N]
    """
    positions = np.asarray(q, dtype=np.float64)
    gravity = STANDARD_GRAVITY * np.asarray(down, dtype=np.float64)
    total = np.zeros(positions.shape)
    for body in arm.bodies:
        at = pose(arm.mechanism, positions, body.frame)
        com = at[..., :3, :3] @ body.com + at[..., :3, 3]
        twist = jacobian_spatial(arm.mechanism, positions, body.frame)
        velocity = twist[..., :3, :] + _cross_columns(twist[..., 3:, :], com)
        total -= body.mass * np.einsum("i,...ij->...j", gravity, velocity)
    return total


def apparent_inertias(arm: ArmDescription, q: ArrayLike) -> Array:
    """Return the inertia at each motor when only its joint moves, (..., n).

    The diagonal of the joint-space inertia, loops and reflected rotors included
    [kg m^2 or kg].
    """
    positions = np.asarray(q, dtype=np.float64)
    total = np.zeros(positions.shape)
    for body in arm.bodies:
        at = pose(arm.mechanism, positions, body.frame)
        turn = at[..., :3, :3]
        com = turn @ body.com + at[..., :3, 3]
        twist = jacobian_spatial(arm.mechanism, positions, body.frame)
        rate = twist[..., 3:, :]
        velocity = twist[..., :3, :] + _cross_columns(rate, com)
        inertia = turn @ body.inertia @ np.swapaxes(turn, -1, -2)
        total += body.mass * np.sum(velocity**2, axis=-2)
        total += np.sum(rate * (inertia @ rate), axis=-2)
    rates = coordinate_rates(arm.mechanism, coordinates(arm.mechanism, positions))
    for frame, rotor in arm.rotor.items():
        total += rotor * rates[..., arm.mechanism.frame_index[frame], :] ** 2
    return total


def merged(bodies: Sequence[Body]) -> tuple[float, Array, Array]:
    """Merge bodies that move together.

    Returns:
        mass [kg], centre of mass (3,) [m], inertia about it (3, 3) [kg m^2]; zeros of no bodies
    """
    mass = sum(b.mass for b in bodies)
    if not bodies:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    com = sum((b.mass * b.com for b in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for b in bodies:
        offset = b.com - com
        inertia += b.inertia + b.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return mass, com, inertia


def _cross_columns(rates: Array, point: Array) -> Array:
    """Return rate x point for each column of rates, (..., 3, n)."""
    return np.swapaxes(np.cross(np.swapaxes(rates, -1, -2), point[..., None, :]), -1, -2)
