"""Passive properties of hinges and compound inertia of bodies, the same in every format."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription, Friction, JointDescription
from trocar.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hinge:
    """The passive side of a frame's own motion; units of its coordinate, rad or m.

    Attributes:
        joint: the public joint whose motor sits on it, None of a passive one
        weight: position of that joint = weight * coordinate
        armature: rotor inertia reflected to the coordinate [kg m^2 or kg]
        damping: [N m s/rad or N s/m]
        frictionloss: dry friction [N m or N]
        stiffness: of a spring [N m/rad], 0 without one
        rest: position at which the spring exerts nothing [rad]
        lower, upper: mechanical stops of the coordinate, infinite without [rad or m]
    """

    joint: JointDescription | None
    weight: float
    armature: float
    damping: float
    frictionloss: float
    stiffness: float
    rest: float
    lower: float
    upper: float


def hinge_of(arm: ArmDescription, frame: str, friction: str) -> Hinge:
    """Return the passive properties of a frame's hinge or slide.

    Friction of a joint is turned into its hinge's by the weight w of the drive: q = w * coordinate.

    Args:
        arm: the description
        frame: a frame that moves
        friction: "identified" or "paper"
    """
    joint = next((j for j in arm.joints if j.drive[0][0] == frame), None)
    weight = joint.drive[0][1] if joint else 1.0
    table = arm.friction.get(friction, {})
    loss = table.get(frame, Friction(0.0, 0.0))
    if joint is not None and joint.name in table:
        own = table[joint.name]
        loss = Friction(own.coulomb * abs(weight), own.viscous * weight**2)
    stiffness, rest = 0.0, 0.0
    if joint is not None and joint.spring is not None:
        stiffness, rest = joint.spring.stiffness * weight**2, joint.spring.rest / weight
    lower, upper = -np.inf, np.inf
    if joint is not None and np.isfinite([joint.stop_lower, joint.stop_upper]).all():
        lower, upper = sorted([joint.stop_lower / weight, joint.stop_upper / weight])
    rotor = arm.rotor.get(frame, 0.0)
    return Hinge(
        joint,
        weight,
        rotor,
        loss.viscous,
        loss.coulomb,
        stiffness,
        rest,
        float(lower),
        float(upper),
    )


def followers(arm: ArmDescription) -> tuple[tuple[str, str, float], ...]:
    """Return the frames that neither a motor nor a loop moves: (frame, frame it follows, ratio).

    Raises:
        InputError: one follows more than one joint
    """
    found: list[tuple[str, str, float]] = []
    driven = {frame for joint in arm.joints for frame, _ in joint.drive}
    passive = {frame for closure in arm.mechanism.closures for frame in closure.passive}
    for frame in arm.mechanism.frames:
        if frame.motion == "fixed" or frame.name in driven | passive:
            continue
        if len(frame.couplings) != 1:
            raise InputError(
                f"{arm.name}: frame {frame.name!r} follows more than one joint, which"
                " only frames inside a loop may do"
            )
        follows, ratio = frame.couplings[0]
        lead, weight = arm.joint(follows).drive[0]
        found.append((frame.name, lead, ratio * weight))
    return tuple(found)
