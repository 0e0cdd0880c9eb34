"""Inverse kinematics as the dVRK's own software computes it: without limits, from where an arm is.

A PSM and an MTM take damped Newton steps on their serial chain until a step is nothing; where they
end is the robot's answer, for poses that no joint range allows, too. An ECM has a closed form. The
caller clips the joints.

Source: cisst robManipulator.cpp (damped least squares); sawIntuitiveResearchKit 9e535e6,
robManipulatorECM.cpp and `InverseKinematics` of mtsIntuitiveResearchKitPSM, MTM and ECM.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import asin, atan2, copysign, cos, floor, log, log1p, pi, remainder, sqrt

import numpy as np
from numpy.typing import NDArray

from trocar.errors import UnreachableError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.closed_form import JointAxes, fit_chain, joint_axes
from trocar.kinematics.forward import pose
from trocar.kinematics.inverse import (
    EXACT,
    NEWTON_STEPS,
    SETTLED,
    chain_ends,
    newton,
    polished,
)
from trocar.kinematics.inverse_gimbal_arm import PLATFORM
from trocar.kinematics.inverse_rcm import DIRECTION_TOLERANCE, shaft_axes
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

# Damping, the step that ends the search, and the most steps.
# Source: cisst robManipulator.h, default arguments of InverseKinematics.
DAMPING, SMALLEST_STEP, MOST_STEPS = 1e-3, 1e-12, 1000
#: A PSM's wrist stays this far outside the remote centre; an ECM is inserted at least so far [m].
#: Source: mtsIntuitiveResearchKit.h, SafeDistanceFromRCM; mtsIntuitiveResearchKitECM.cpp.
SAFE_DEPTH_M, SCOPE_INSERTION_M = 0.045, 0.040
# A tip nearer to the remote centre is not solved [m]. Source: the PSM's and the ECM's files above.
TIP_AT_CENTRE, SCOPE_AT_CENTRE = 1e-3, 1e-4
# An ECM's joint that is beyond its limit by more is an error [rad]. Source: robManipulatorECM.cpp.
SCOPE_TOLERANCE = 1e-5

# The closed form's solution this near to where an arm is [rad, m] is the one that the damped steps
# end on, with the wrist pitch [rad] below this. Source: measured, none of 600 random ones differs.
NEAR, NEAR_M, WRIST_PITCH_MOST = 0.25, 0.03, 1.4
# A damped step leaves DAMPING / (DAMPING + s^2) of a miss, s the Jacobian's smallest singular
# value. The robot's DH table, rounded to 1e-4 deg, makes a miss at least this [m or rad].
LEAST_MISS = 4e-6
# A wrist nearer to the remote centre takes damped steps, which may not end there [m].
WRIST_AT_CENTRE = 0.01
# A half turn about the tool is as near as this, as a fraction of a turn. Source: our choice: the
# robot's DH table is rounded by as much, and an arm at its limit is measured so near to it.
HALF_TURN = 3e-4
# The robot's DH tables have 1.5708 for pi/2: at half a turn a PSM's angles are by so much [rad]
# farther on the side of a sign, whose other side they are wound to; roll has no offset.
# Source: sawIntuitiveResearchKit 9e535e6, PSM.json and LARGE_NEEDLE_DRIVER_400006.json.
ROUNDED, SIDES = 1.5708 - pi / 2.0, (-1.0, 1.0, 0.0, 0.0, 1.0, 1.0)
# A miss [m or rad] from which Newton's method needs no damping.
CLOSE = 1e-4

INSERTION, ROLL, WRIST_PITCH, WRIST_ROLL = 2, 3, 4, 6


#: Improves joints (n,) that nearly bring the tip to a pose; None where it does not get there.
Refine = Callable[[Array], "Array | None"]


def robot_solution(
    mechanism: Mechanism,
    structure: str,
    T: Array,
    start: Array,
    measured: Array,
    refine: Refine | None = None,
) -> tuple[Array, bool]:
    """Compute the joint positions that the robot's software takes for a pose, whatever the limits.

    The last joint about the tool (a PSM's and ECM's roll, an MTM's wrist roll) is at the turn
    nearest to the measured one. A PSM's wrist within `SAFE_DEPTH_M` of the remote centre is
    projected outside, or kept from coming nearer; an ECM is inserted by `SCOPE_INSERTION_M`.

    Args:
        mechanism: the arm
        structure: its type: "rcm_arm", "rcm_scope" or "gimbal_arm"
        T: pose of the tip in the mechanism's reference frame, (4, 4), not checked
        start: joints where the search starts, (n,) [rad or m]
        measured: joints as they are now, (n,)
        refine: for a mechanism that is only nearly the structure's chain; default: Newton's method
            on its forward kinematics

    Returns:
        (n,) [rad or m], and whether they bring the tip to the pose

    Raises:
        UnreachableError: the search does not end, or an ECM's joint is beyond its limit
        InputError: a mechanism of another structure
    """
    q, exact = _solved(mechanism, structure, T, start)
    fit = fit_chain(mechanism, structure)
    if fit.deviation > EXACT:
        better = _refined(mechanism, structure, T, q) if refine is None else refine(q)
        exact = better is not None
        q = q if better is None else better
    last = WRIST_ROLL if structure == "gimbal_arm" else ROLL
    q[last] += _turns(float(measured[last]) - float(q[last]))
    if structure == "rcm_arm":
        depth = abs(q[INSERTION] + fit.chain.depth)
        if depth < SAFE_DEPTH_M:
            least = q[INSERTION] + SAFE_DEPTH_M - depth
            here = start[INSERTION]
            q[INSERTION] = max(here, q[INSERTION]) if here <= least else least
            return q, False
    elif structure == "rcm_scope" and q[INSERTION] < SCOPE_INSERTION_M:
        q[INSERTION] = SCOPE_INSERTION_M
        return q, False
    return q, exact


def kept_depth(mechanism: Mechanism, structure: str, q: Array) -> float:
    """Return the depth at which `robot_solution` keeps joints that miss a pose, 0 elsewhere [m].

    Args:
        mechanism, structure: as for `robot_solution`
        q: its result, (n,) [rad or m]
    """
    if structure == "rcm_arm":
        depth = abs(q[INSERTION] + fit_chain(mechanism, structure).chain.depth)
        return SAFE_DEPTH_M if depth < SAFE_DEPTH_M + EXACT else 0.0
    if structure == "rcm_scope" and q[INSERTION] == SCOPE_INSERTION_M:
        return SCOPE_INSERTION_M
    return 0.0


def _turns(way: float) -> float:
    """Return the whole turns nearest to a way; half a turn, rounded, is made a whole one."""
    return copysign(2.0 * pi * floor(abs(way) / (2.0 * pi) + 0.5 + HALF_TURN), way)


def _solved(mechanism: Mechanism, structure: str, T: Array, start: Array) -> tuple[Array, bool]:
    """Solve the chain of a structure, and say whether the pose is reached, limits aside."""
    if structure == "rcm_scope":
        return _scope(mechanism, T)
    if structure == "gimbal_arm":
        q = start.copy()
        lower, upper = mechanism.lower[PLATFORM], mechanism.upper[PLATFORM]
        q[PLATFORM] = min(max(q[PLATFORM] + q[5] * cos(q[4]), lower), upper)
        return _converged(mechanism, T, q)
    if T[:3, 3].dot(T[:3, 3]) < TIP_AT_CENTRE**2:
        raise _unsolved("the tip is within 1 mm of the remote centre")
    near = _nearby(mechanism, structure, T, start)
    return _converged(mechanism, T, start) if near is None else (near, True)


def _refined(mechanism: Mechanism, structure: str, T: Array, q: Array) -> Array | None:
    moving = np.ones(len(q), dtype=bool)
    if structure == "gimbal_arm":
        moving[PLATFORM] = False
    try:
        return polished(mechanism, T, q[None], moving)[0]
    except UnreachableError:
        return None


def _nearby(mechanism: Mechanism, structure: str, T: Array, start: Array) -> Array | None:
    """Return the closed form's solution nearest to a start where it is the robot's, (6,)."""
    chain, ends = fit_chain(mechanism, structure).chain, chain_ends(mechanism, structure)
    if chain.nearest is None:
        return None
    seed: list[float] = start.tolist()
    limits = [(a - NEAR, a + NEAR) for a in seed]
    limits[INSERTION] = seed[INSERTION] - NEAR_M, seed[INSERTION] + NEAR_M
    low, high = limits[WRIST_PITCH]
    limits[WRIST_PITCH] = max(low, -WRIST_PITCH_MOST), min(high, WRIST_PITCH_MOST)
    nearest = chain.nearest(ends.before.dot(T).dot(ends.after), limits, seed)
    if not nearest or abs(nearest[INSERTION] + chain.depth) < WRIST_AT_CENTRE:
        return None
    return np.array(nearest)


def _converged(mechanism: Mechanism, T: Array, start: Array) -> tuple[Array, bool]:
    """Take damped Newton steps to a pose, and bring angles beyond their limits within half a turn.

    Raises:
        UnreachableError: they do not end
    """
    chain = screw_chain(mechanism, len(start))
    q, at, axes, damping = start.copy(), T[:3, 3], T[:3, :3], DAMPING * np.eye(6)
    miss = np.empty(6)
    for done in range(MOST_STEPS):
        tip, J = chain.at(q)
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = axes.dot(tip[:3, :3].T).tolist()
        np.subtract(at, tip[:3, 3], out=miss[:3])
        miss[3:] = 0.5 * (r21 - r12), 0.5 * (r02 - r20), 0.5 * (r10 - r01)
        square = J.dot(J.T)
        far = max(map(abs, miss.tolist()))
        if far < CLOSE and r00 + r11 + r22 > 1.0:
            least = max(float(np.linalg.eigvalsh(square)[0]), 1e-12)
            more = log(max(far, LEAST_MISS) / SMALLEST_STEP) / log1p(least / DAMPING)
            if done + more > MOST_STEPS:
                break
            _finish(chain, q, T)
            return _within_half_a_turn(mechanism, q), True
        step: Array = np.matmul(J.T, np.linalg.solve(square + damping, miss))
        q += step
        if step.dot(step) <= SMALLEST_STEP**2:
            return _within_half_a_turn(mechanism, q), False
    raise _unsolved(f"no convergence in {MOST_STEPS} steps")


def _finish(chain: ScrewChain, q: Array, T: Array) -> None:
    """Bring joints that are close to a pose onto it, in place, by Newton's method."""

    def step(longest: float) -> Array | None:
        if longest < SETTLED:
            return None
        tip, J = chain.at(q)
        v, w = T[:3, 3] - tip[:3, 3], T[:3, :3] @ tip[:3, :3].T
        turn = 0.5 * np.array([w[2, 1] - w[1, 2], w[0, 2] - w[2, 0], w[1, 0] - w[0, 1]])
        twist = np.empty(6)
        twist[:3], twist[3:] = v + np.cross(tip[:3, 3], turn), turn
        square: Array = np.matmul(J, J.T)
        change: Array = np.matmul(J.T, np.linalg.solve(square, twist))
        return change

    newton(q, step, NEWTON_STEPS)


def _within_half_a_turn(mechanism: Mechanism, q: Array) -> Array:
    """Wind angles beyond their limits to [-pi, pi], in place; the robot winds all of them.

    Winding those inside their limits would throw an MTM's platform from its lower limit, beyond
    half a turn, to its upper one. A PSM's half turns go to the side that the robot's table has.
    """
    sides = SIDES if len(q) == len(SIDES) else (0.0,) * len(q)
    for k, joint in enumerate(mechanism.joints[: len(q)]):
        if joint.kind == "revolute" and not mechanism.lower[k] <= q[k] <= mechanism.upper[k]:
            q[k] = remainder(q[k], 2.0 * pi)
            if q[k] * sides[k] > pi - ROUNDED:
                q[k] -= 2.0 * pi * sides[k]
    return q


def _scope(mechanism: Mechanism, T: Array) -> tuple[Array, bool]:
    """Solve an ECM: the tip's position, then the roll after turning the pose along the scope.

    Raises:
        UnreachableError: yaw, pitch, roll or a long insertion beyond its limit
    """
    chain, ends = fit_chain(mechanism, "rcm_scope").chain, chain_ends(mechanism, "rcm_scope")
    in_chain = ends.before.dot(T).dot(ends.after)
    tip = in_chain[:3, 3]
    depth = sqrt(tip.dot(tip))
    if depth < SCOPE_AT_CENTRE:
        raise _unsolved("the tip is at the remote centre")
    along = tip / depth
    x, y, z = along.tolist()
    if z > 0.0:
        raise _unsolved("the tip is behind the remote centre")
    q = np.array([atan2(x, -z), asin(-y), depth - chain.depth, 0.0])
    across = np.cross(in_chain[:3, 2], along)
    sine = sqrt(across.dot(across))
    turn = (
        across * (atan2(sine, float(in_chain[:3, 2].dot(along))) / sine) if sine > 0.0 else across
    )
    x4 = matrix_from_rotation_vector(turn) @ in_chain[:3, 0]
    x3, y3, _ = shaft_axes(q[0], q[1])
    q[ROLL] = atan2(y3.dot(x4), x3.dot(x4))
    for k in range(len(q)):
        low = -np.inf if k == INSERTION else mechanism.lower[k] - SCOPE_TOLERANCE
        if not low <= q[k] <= mechanism.upper[k] + SCOPE_TOLERANCE:
            name, unit = mechanism.joints[k].name, "m" if k == INSERTION else "rad"
            raise _unsolved(
                f"{name} {q[k]:.4g} {unit} is beyond its limits {mechanism.lower[k]:.4g} to "
                f"{mechanism.upper[k]:.4g}"
            )
    return q, sine < DIRECTION_TOLERANCE


def _unsolved(why: str) -> UnreachableError:
    return UnreachableError(f"unable to solve inverse kinematics: {why}", {})


class ScrewChain:
    """A serial chain of screws: the pose of its tip and its spatial Jacobian, quickly.

    Args:
        axes: of the joints and the tip at rest, in the reference frame
        slides: which joints slide, (n,)
        rest: pose of the tip at rest, (4, 4)
    """

    def __init__(self, axes: JointAxes, slides: NDArray[np.bool_], rest: Array) -> None:
        n = len(slides)
        frames = np.stack([_frame(p, z) for p, z in zip(axes.points, axes.directions, strict=True)])
        before = np.concatenate([frames[:1], inverse(frames[:-1]) @ frames[1:]])
        parts = np.zeros((n, 4, 4, 4))  # of 1, cos, sin and the slide
        parts[:, 0, :, 2:] = before[:, :, 2:]
        parts[:, 1, :, :2] = before[:, :, :2]
        parts[:, 2, :, 0], parts[:, 2, :, 1] = before[:, :, 1], -before[:, :, 0]
        parts[:, 3, :, 3] = before[:, :, 2]
        self._parts = parts.reshape(n, 4, 16)
        self._end = inverse(frames[-1]) @ rest
        self._slides, self._turns = slides, ~slides
        self._factors = np.ones((n, 1, 4))

    def at(self, q: Array) -> tuple[Array, Array]:
        """Return the pose of the tip (4, 4) and J_s (6, n) at joint positions, (n,)."""
        factors, turn = self._factors[:, 0], q * self._turns
        factors[:, 1], factors[:, 2], factors[:, 3] = np.cos(turn), np.sin(turn), q - turn
        frames = np.matmul(self._factors, self._parts).reshape(-1, 4, 4)
        for k in range(1, len(frames)):
            frames[k - 1].dot(frames[k].copy(), out=frames[k])
        p, z = frames[:, :3, 3].T, frames[:, :3, 2].T
        J = np.empty((6, len(q)))
        J[0] = p[1] * z[2] - p[2] * z[1]
        J[1] = p[2] * z[0] - p[0] * z[2]
        J[2] = p[0] * z[1] - p[1] * z[0]
        J[3:] = z
        J[:3, self._slides], J[3:, self._slides] = z[:, self._slides], 0.0
        return frames[-1].dot(self._end), J


def _frame(point: Array, z: Array) -> Array:
    """Return a frame at a point whose z axis is a direction, (4, 4)."""
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x = x / np.linalg.norm(x)
    return transform(np.stack([x, np.cross(z, x), z], axis=-1), point)


@lru_cache(maxsize=64)
def screw_chain(mechanism: Mechanism, count: int) -> ScrewChain:
    """Return the chain of a mechanism's first joints, of which loops are left out."""
    slides = np.array([joint.kind == "prismatic" for joint in mechanism.joints[:count]])
    rest = pose(mechanism, np.zeros(len(mechanism.joints)))
    return ScrewChain(joint_axes(mechanism, count), slides, rest)
