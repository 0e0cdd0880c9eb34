"""Inverse dynamics of a closed-loop mechanism, linear in the inertial parameters of its bodies.

The ten parameters of a body are mass m, first moments h = m c and second moments
S = integral of x x^T dm, all about and along its frame: (m, hx, hy, hz, Sxx, Syy, Szz, Sxy, Sxz,
Syz). Its inertia about the frame's origin is tr(S) 1 - S, and the body is possible when the
pseudo-inertia [[S, h], [h^T, m]] is positive semidefinite.
Source: Wensing, Kim, Slotine 2018, Linear Matrix Inequalities for Physically Consistent Inertial
Parameter Identification.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import STANDARD_GRAVITY
from trocar.descriptions.records import ArmDescription, Body
from trocar.geometry.rotations import skew
from trocar.kinematics.forward import coordinates, pose
from trocar.kinematics.loops import coordinate_rates, loops_are_parallelograms
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.tree import local_pose

Array = NDArray[np.float64]

#: Direction against gravity of an arm whose reference frame stands upright.
UPRIGHT: Array = np.array([0.0, 0.0, 1.0])
UPRIGHT.setflags(write=False)
#: Rows and columns of the six second moments.
MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
#: Step of the differences that differentiate the rates of a loop that is no parallelogram, as a
#: part of a second. Source: our own choice; the error of the fourth order is 1e-10 at 1 rad/s.
RATE_STEP_S = 1e-3


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joint positions, velocities and accelerations, (k, n) each [rad or m, per s, per s^2].

    Stop elements deflect along `unfiltered` positions where there are some: hysteresis of filtered
    positions is not the filtered hysteresis. Gravity is against `up`, a unit vector in the arm's
    reference frame, (3,).
    """

    q: Array
    qd: Array
    qdd: Array
    unfiltered: Array | None = None
    up: Array = field(default_factory=lambda: UPRIGHT)


@dataclass(frozen=True, eq=False)
class FrameMotion:
    """Motion of one frame in its own axes.

    Attributes:
        jacobian: (k, 6, n), twist (linear; angular) at its origin by joint velocity
        turn: angular velocity, (k, 3) [rad/s]
        turn_rate: angular acceleration, (k, 3) [rad/s^2]
        lift: acceleration of its origin less gravity, (k, 3) [m/s^2]
        coordinate: its own coordinate and two derivatives, (k, 3) [rad or m, per s, per s^2]
        rates: d coordinate / d q, (k, n)
    """

    jacobian: Array
    turn: Array
    turn_rate: Array
    lift: Array
    coordinate: Array
    rates: Array


def frame_motions(
    mechanism: Mechanism, motion: JointMotion, only: Sequence[str]
) -> dict[str, FrameMotion]:
    """Return the motion of frames, loops closed, with gravity against the motion's `up`.

    Args:
        mechanism: the arm with its tool
        motion: of all its joints
        only: names of the frames
    """
    where = coordinates(mechanism, motion.q)
    rates = coordinate_rates(mechanism, where)
    speed = np.einsum("kfj,kj->kf", rates, motion.qd)
    growth = np.einsum("kfj,kj->kf", rates, motion.qdd)
    if not loops_are_parallelograms(mechanism):
        growth += np.einsum("kfj,kj->kf", _rate_derivative(mechanism, motion), motion.qd)
    wanted = sorted({i for name in only for i in mechanism.chain(name)})
    count, joints = motion.q.shape
    root = mechanism.frames[0].name
    up = pose(mechanism, motion.q[:1], mechanism.reference, root)[0, :3, :3] @ motion.up
    rest = np.zeros((count, 3))
    lifts: dict[int, tuple[Array, Array, Array, Array]] = {}
    found: dict[str, FrameMotion] = {}
    for i in wanted:
        frame = mechanism.frames[i]
        local = np.broadcast_to(local_pose(frame, where[:, i]), (count, 4, 4))
        back, arm = np.swapaxes(local[:, :3, :3], -1, -2), local[:, :3, 3]
        if frame.parent is None:
            jacobian = np.zeros((count, 6, joints))
            turn, turn_rate = rest, rest
            lift = np.einsum("kab,b->ka", back, STANDARD_GRAVITY * up)
        else:
            jac, turn, turn_rate, lift = lifts[mechanism.frame_index[frame.parent]]
            lift = lift + np.cross(turn_rate, arm) + np.cross(turn, np.cross(turn, arm))
            shifted = jac[:, :3] - skew(arm) @ jac[:, 3:]
            jacobian = np.concatenate([back @ shifted, back @ jac[:, 3:]], axis=1)
            turn, turn_rate, lift = (
                np.einsum("kab,kb->ka", back, v) for v in (turn, turn_rate, lift)
            )
        if frame.motion != "fixed":
            axis, at = frame.after[:3, :3].T[:, 2], -frame.after[:3, :3].T @ frame.after[:3, 3]
            speed_i, growth_i = speed[:, i, None], growth[:, i, None]
            if frame.motion == "prismatic":
                screw = np.concatenate([axis, np.zeros(3)])
                lift = lift + axis * growth_i + 2.0 * np.cross(turn, axis) * speed_i
            else:
                screw = np.concatenate([np.cross(at, axis), axis])
                # about the point of the axis, which the parent carries, at `at` in this frame
                before = turn
                turn = turn + axis * speed_i
                rate_before = turn_rate
                turn_rate = turn_rate + axis * growth_i + np.cross(before, axis) * speed_i
                fixed = lift + np.cross(rate_before, at) + np.cross(before, np.cross(before, at))
                lift = fixed - np.cross(turn_rate, at) - np.cross(turn, np.cross(turn, at))
            jacobian = jacobian + screw[:, None] * rates[:, None, i, :]
        lifts[i] = (jacobian, turn, turn_rate, lift)
        found[frame.name] = FrameMotion(
            jacobian,
            turn,
            turn_rate,
            lift,
            np.stack([where[:, i], speed[:, i], growth[:, i]], axis=1),
            rates[:, i],
        )
    return {name: found[name] for name in only}


def body_regressor(motion: FrameMotion) -> Array:
    """Return d effort / d parameters of a body on a frame, (k, n, 10)."""
    count = len(motion.turn)
    spin, twist = skew(motion.turn), skew(motion.turn_rate)
    force = np.zeros((count, 3, 10))
    force[..., 0] = motion.lift
    force[..., 1:4] = twist + spin @ spin
    moment = np.zeros((count, 3, 10))
    moment[..., 1:4] = -skew(motion.lift)
    for column, (row, other) in enumerate(MOMENTS):
        second = np.zeros((3, 3))
        second[row, other] = second[other, row] = 1.0
        inertia = np.trace(second) * np.eye(3) - second
        moment[..., 4 + column] = motion.turn_rate @ inertia + np.cross(
            motion.turn, motion.turn @ inertia
        )
    wrench = np.concatenate([force, moment], axis=1)
    return np.swapaxes(motion.jacobian, -1, -2) @ wrench


def parameters(body: Body) -> Array:
    """Return the ten parameters of a body, (10,) [kg, kg m, kg m^2]."""
    inertia = body.inertia
    about_com = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    second = about_com + body.mass * np.outer(body.com, body.com)
    return np.array(
        [body.mass, *(body.mass * body.com), *(second[row, other] for row, other in MOMENTS)]
    )


def pseudo_inertia(values: Array) -> Array:
    """Return [[S, h], [h^T, m]] of ten parameters, (4, 4)."""
    matrix = np.zeros((4, 4))
    matrix[3, 3] = values[0]
    matrix[:3, 3] = matrix[3, :3] = values[1:4]
    for (row, other), value in zip(MOMENTS, values[4:], strict=True):
        matrix[row, other] = matrix[other, row] = value
    return matrix


def mass_com_inertia(values: Array) -> tuple[float, Array, Array]:
    """Return mass [kg], centre (3,) [m] and inertia about it (3, 3) [kg m^2] of ten parameters."""
    matrix = pseudo_inertia(values)
    com = matrix[:3, 3] / matrix[3, 3]
    second = matrix[:3, :3] - matrix[3, 3] * np.outer(com, com)
    return float(values[0]), com, np.trace(second) * np.eye(3) - second


def rigid_efforts(arm: ArmDescription, motion: JointMotion) -> Array:
    """Return the efforts that move an arm's bodies and reflected rotors, (k, n) [N m or N].

    Args:
        arm: the arm with its tool
        motion: of all its joints
    """
    frames = list(dict.fromkeys([*(b.frame for b in arm.bodies), *arm.rotor]))
    motions = frame_motions(arm.mechanism, motion, frames)
    total = np.zeros(motion.q.shape)
    for frame, values in grouped(arm.bodies).items():
        total += body_regressor(motions[frame]) @ values
    for frame, rotor in arm.rotor.items():
        total += rotor * motions[frame].coordinate[:, 2:] * motions[frame].rates
    return total


def grouped(bodies: Sequence[Body]) -> Mapping[str, Array]:
    """Return the summed parameters of the bodies on each frame, {frame: (10,)}."""
    found: dict[str, Array] = {}
    for body in bodies:
        found[body.frame] = found.get(body.frame, np.zeros(10)) + parameters(body)
    return found


def _rate_derivative(mechanism: Mechanism, motion: JointMotion) -> Array:
    """Return the time derivative of the rates, (k, n_frames, n), by differences."""
    ahead = {
        step: coordinate_rates(
            mechanism, coordinates(mechanism, motion.q + step * RATE_STEP_S * motion.qd)
        )
        for step in (-2, -1, 1, 2)
    }
    return (8.0 * (ahead[1] - ahead[-1]) - (ahead[2] - ahead[-2])) / (12.0 * RATE_STEP_S)
