"""Closed-form chains: their joint axes, which chain a mechanism is, and how far it is from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.screws import nearest_point_to_lines
from trocar.geometry.se3 import inverse, pose_difference, transform
from trocar.kinematics.forward import pose
from trocar.kinematics.inverse_gimbal_arm import GimbalArmGeometry, inverse_gimbal_arm
from trocar.kinematics.inverse_rcm import (
    RcmArmGeometry,
    RcmScopeGeometry,
    inverse_rcm_arm,
    inverse_rcm_scope,
    nearest_rcm_arm,
    nearest_rcm_arms,
    nearest_rcm_scope,
)
from trocar.kinematics.jacobian import jacobian_spatial
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.solutions import Limits

Array = NDArray[np.float64]

HALF = 0.5 * np.pi


@dataclass(frozen=True, eq=False)
class JointAxes:
    """Axes of the joints, in the frame that poses are given in.

    Attributes:
        points: a point on each axis, (n, 3) [m]; means nothing for a joint that slides
        directions: unit vectors, (n, 3)
        tip: the tip's position, (3,) [m]
    """

    points: Array
    directions: Array
    tip: Array


#: A closed-form inverse: T_0_last (4, 4), limits (n,) twice, seed (n,) or None to (k, n); that of a
#: gimbal arm takes `platform_angle`, too.
Solver = Callable[..., Array]
#: From T_0_last (4, 4), limits and a seed to the nearest solution, () without one; None where only
#: a `Solver` can decide.
Nearest = Callable[[Array, Limits, Sequence[float]], tuple[float, ...] | None]
#: The same of many poses (n, 4, 4) with as many seeds, and which are undetermined.
NearestMany = Callable[[Array, Limits, Array], tuple[Array, NDArray[np.bool_]]]


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain with a closed-form inverse.

    Attributes:
        base: T_reference_0, where its frame 0 stands (4, 4)
        forward: from joint positions (..., n) to T_0_last (..., 4, 4)
        solve: from T_0_last to joint positions
        nearest: the same for the solution nearest to a seed alone, quickly; None where there is no
            quicker way
        nearest_many: `nearest` of many poses at once, or None
        depth: of an instrument's wrist, a scope's tip, past the remote centre at insertion 0 [m]
    """

    base: Array
    forward: Callable[[Array], Array]
    solve: Solver
    nearest: Nearest | None = None
    depth: float = 0.0
    nearest_many: NearestMany | None = None


def rcm_arm(axes: JointAxes) -> Chain:
    """Fit yaw, pitch, insertion, roll, wrist pitch and wrist yaw about a remote centre."""
    base = _remote_centre_frame(axes)
    wrist, yaw = _depth(axes, base, 4), _depth(axes, base, 5)
    # Only the difference of tool length and insertion offset makes itself felt.
    geometry = RcmArmGeometry(0.0, wrist, yaw - wrist, np.eye(3))

    def forward(q: Array) -> Array:
        wrist_pitch = modified_dh(0.0, -HALF, 0.0, q[..., 4] - HALF)
        wrist_yaw = modified_dh(geometry.wrist_length, -HALF, 0.0, q[..., 5] - HALF)
        return _shaft(q, wrist) @ wrist_pitch @ wrist_yaw

    solvers = partial(inverse_rcm_arm, geometry), partial(nearest_rcm_arm, geometry)
    return Chain(base, forward, *solvers, wrist, partial(nearest_rcm_arms, geometry))


def rcm_scope(axes: JointAxes) -> Chain:
    """Fit yaw, pitch, insertion and roll about a remote centre."""
    base = _remote_centre_frame(axes)
    length = float((axes.tip - base[:3, 3]) @ -base[:3, 2])
    geometry = RcmScopeGeometry(0.0, length)

    solvers = partial(inverse_rcm_scope, geometry), partial(nearest_rcm_scope, geometry)
    return Chain(base, lambda q: _shaft(q, length), *solvers, length)


def gimbal_arm(axes: JointAxes) -> Chain:
    """Fit outer yaw, shoulder, elbow and the four axes of a gimbal, which meet in one point."""
    points, directions = axes.points, axes.directions
    shoulder, _ = nearest_point_to_lines(points[:2], directions[:2])
    wrist, _ = nearest_point_to_lines(points[3:], directions[3:])
    base = transform(_triad(directions[0], -directions[1]), shoulder)
    along = directions[2]
    elbow = points[2] + ((shoulder - points[2]) @ along) * along
    _, back, up = (wrist - elbow) @ base[:3, :3]
    geometry = GimbalArmGeometry(float(np.linalg.norm(elbow - shoulder)), float(-back), float(up))

    def forward(q: Array) -> Array:
        return (
            standard_dh(0.0, HALF, 0.0, q[..., 0] - HALF)
            @ standard_dh(geometry.upper_arm, 0.0, 0.0, q[..., 1] - HALF)
            @ standard_dh(geometry.forearm, -HALF, 0.0, q[..., 2] + HALF)
            @ standard_dh(0.0, HALF, geometry.wrist_height, q[..., 3])
            @ standard_dh(0.0, -HALF, 0.0, q[..., 4])
            @ standard_dh(0.0, HALF, 0.0, q[..., 5] - HALF)
            @ standard_dh(0.0, 0.0, 0.0, q[..., 6] + HALF)
        )

    return Chain(base, forward, partial(inverse_gimbal_arm, geometry))


def _remote_centre_frame(axes: JointAxes) -> Array:
    """Compute T_reference_0: where yaw, pitch and shaft meet, y along -yaw and z along -shaft."""
    meeting = [0, 1, 3]
    centre, _ = nearest_point_to_lines(axes.points[meeting], axes.directions[meeting])
    yaw, shaft = axes.directions[0], axes.directions[3]
    x = np.cross(yaw, shaft)
    x = x / np.linalg.norm(x)
    return transform(np.stack([x, -yaw, -np.cross(x, yaw)], axis=-1), centre)


def _triad(z: Array, x: Array) -> Array:
    """Compute axes with z as it is and x as near as can be to the requested one, (3, 3)."""
    y = np.cross(z, x)
    y = y / np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _depth(axes: JointAxes, base: Array, joint: int) -> float:
    """Return the depth past the remote centre of the shaft's nearest point to an axis [m]."""
    shaft, axis = -base[:3, 2], axes.directions[joint]
    offset, slant = axes.points[joint] - base[:3, 3], shaft @ axis
    return float((offset @ shaft - (offset @ axis) * slant) / (1.0 - slant * slant))


def _shaft(q: Array, depth: float) -> Array:
    """Compute T_04 after yaw, pitch, insertion and roll, (..., 4, 4)."""
    return (
        modified_dh(0.0, HALF, 0.0, q[..., 0] + HALF)
        @ modified_dh(0.0, -HALF, 0.0, q[..., 1] - HALF)
        @ modified_dh(0.0, HALF, q[..., 2] + depth, 0.0)
        @ modified_dh(0.0, 0.0, 0.0, q[..., 3])
    )


#: Each structure's chain, and its joints: R turns, S slides.
STRUCTURES = {
    "rcm_arm": (rcm_arm, "RRSRRR"),
    "rcm_scope": (rcm_scope, "RRSR"),
    "gimbal_arm": (gimbal_arm, "RRRRRRR"),
}

# Source: our choice. A mechanism this far [m or rad] from its structure's chain is another
# structure (or its joints have other zeros or signs); a calibrated arm differs by 1e-2 at most.
SAME_STRUCTURE = 0.1
SAMPLES = 32


@dataclass(frozen=True, eq=False)
class Fit:
    """A closed-form chain as it fits a mechanism: T_reference_tip = base @ forward(q) @ tip.

    Attributes:
        chain: read off the mechanism's forward kinematics at q = 0
        count: number of joints that it has; the mechanism may have more (a jaw)
        tip: T_last_tip, what follows the chain's last frame (4, 4)
        deviation: how far the mechanism's tip is from the chain's at most, over samples of the
            joints' range [m or rad]; not 0 where axes miss each other
    """

    chain: Chain
    count: int
    tip: Array
    deviation: float


@lru_cache(maxsize=64)
def fit_chain(mechanism: Mechanism, structure: str) -> Fit:
    """Fit a structure's chain to a mechanism.

    Raises:
        InputError: no such structure, or the mechanism has other joints or is built otherwise
    """
    build, kinds = _structure(mechanism, structure)
    chain = build(joint_axes(mechanism, len(kinds)))
    rest = np.zeros(len(mechanism.joints))
    tip = inverse(chain.base @ chain.forward(rest)) @ pose(mechanism, rest)
    # Multiples of square roots of primes: every joint is all over its range, none with another.
    spread = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0]))[: len(rest)]
    share = np.outer(np.arange(SAMPLES), spread) % 1.0
    q = mechanism.lower + share * (mechanism.upper - mechanism.lower)
    apart = pose_difference(pose(mechanism, q), chain.base @ chain.forward(q) @ tip)
    deviation = float(np.max(apart))
    if not deviation <= SAME_STRUCTURE:
        raise InputError(
            f"{mechanism.name}: not built as {structure!r}: over its joints' range its tip is up "
            f"to {deviation:.3g} (m or rad) off; allowed {SAME_STRUCTURE:g}"
        )
    return Fit(chain, len(kinds), tip, deviation)


def _structure(mechanism: Mechanism, name: str) -> tuple[Callable[[JointAxes], Chain], str]:
    if name not in STRUCTURES:
        raise InputError(
            f"{mechanism.name}: no inverse kinematics: got "
            + (f"structure {name!r}" if name else "a description that names no structure")
            + f"; those with a closed form are {', '.join(STRUCTURES)}"
        )
    build, kinds = STRUCTURES[name]
    got = "".join("S" if joint.kind == "prismatic" else "R" for joint in mechanism.joints)
    if not got.startswith(kinds):
        hint = "; is its tool mounted?" if kinds.startswith(got) else ""
        raise InputError(
            f"{mechanism.name}: not built as {name!r}, whose joints are {kinds} (R turns, S "
            f"slides): got {got or 'none'} ({', '.join(mechanism.joint_names)}){hint}"
        )
    return build, kinds


def joint_axes(mechanism: Mechanism, count: int) -> JointAxes:
    """Return the axes of the first joints at q = 0, from the tip's twists as each of them moves."""
    rest = np.zeros(len(mechanism.joints))
    twists = jacobian_spatial(mechanism, rest)[:, :count].T
    linear, angular = twists[:, :3], twists[:, 3:]
    turns = np.array([joint.kind == "revolute" for joint in mechanism.joints[:count]])[:, None]
    along = np.where(turns, angular, linear)
    directions = along / np.linalg.norm(along, axis=-1, keepdims=True)
    return JointAxes(np.cross(angular, linear), directions, pose(mechanism, rest)[:3, 3])
