"""Which closed-form chain a mechanism is, and how far it is from being just that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.geometry.se3 import inverse, pose_difference
from trocar.kinematics.chains import Chain, JointAxes, gimbal_arm, rcm_arm, rcm_scope
from trocar.kinematics.forward import pose
from trocar.kinematics.jacobian import jacobian_spatial
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

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
    chain = build(_joint_axes(mechanism, len(kinds)))
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


def _joint_axes(mechanism: Mechanism, count: int) -> JointAxes:
    """Give the axes of the first joints at q = 0, from the tip's twists as each of them moves."""
    rest = np.zeros(len(mechanism.joints))
    twists = jacobian_spatial(mechanism, rest)[:, :count].T
    linear, angular = twists[:, :3], twists[:, 3:]
    turns = np.array([joint.kind == "revolute" for joint in mechanism.joints[:count]])[:, None]
    along = np.where(turns, angular, linear)
    directions = along / np.linalg.norm(along, axis=-1, keepdims=True)
    return JointAxes(np.cross(angular, linear), directions, pose(mechanism, rest)[:3, 3])
