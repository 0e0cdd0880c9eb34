"""Efforts along logs, linear in the parameters of an arm's bodies and drivetrains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay_records import Drivetrain
from trocar.descriptions.records import Body
from trocar.errors import InputError, UnknownNameError
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import coordinate_rates
from trocar.robot.identification.drivetrains import (
    basis,
    coefficients,
    labels,
    train_efforts,
    weights,
)
from trocar.robot.identification.logs import FilteredLog
from trocar.robot.identification.rigid_body import (
    JointMotion,
    body_regressor,
    frame_motions,
    parameters,
    rigid_efforts,
)

Array = NDArray[np.float64]

#: Frames of own bodies that stay as described. Source: the handle of a master is symmetric about
#: its axis, and what a fit finds of it beside the axis explains held-out samples worse.
KNOWN_BODIES = {"MTM": ("wrist_roll",)}
#: Mass below which an own body stays as described [kg]. Source: our own choice; a placeholder of
#: next to nothing, which the stages of an Si's telescope are, has no bounds that mean anything.
LEAST_MASS = 1e-3
#: Names of a body's parameters.
BODY_PARAMETERS = ("m", "hx", "hy", "hz", "Sxx", "Syy", "Szz", "Sxy", "Sxz", "Syz")


@dataclass(frozen=True)
class Weight:
    """A known mass strapped to an arm: a point mass.

    Attributes:
        mass: [kg]
        frame: that it moves with
        point: in the frame (x, y, z) [m]
    """

    mass: float
    frame: str
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def body(self, arm: ArmDescription) -> Body:
        """Return it as a body of an arm.

        Raises:
            UnknownNameError: no such frame
            InputError: a negative mass
        """
        mechanism = arm.mechanism
        if self.frame not in mechanism.frame_index:
            names = [frame.name for frame in mechanism.frames]
            raise UnknownNameError("frame", self.frame, names, "weight")
        if not self.mass >= 0.0:
            raise InputError(f"weight: got {self.mass:g} kg; allowed: 0 or more")
        com, none = np.array(self.point, float), np.zeros((3, 3))
        return Body(self.frame, self.mass, com, none, (), "source", "known weight", "weight")


@dataclass(frozen=True, eq=False)
class EffortModel:
    """Parameters to identify: ten of each body, then the coefficients of each drivetrain.

    Attributes:
        arm: the arm whose other bodies are known
        frames: of the bodies to identify, the arm's own
        trains: drivetrains to identify
    """

    arm: ArmDescription
    frames: tuple[str, ...]
    trains: Mapping[str, Drivetrain]

    @property
    def names(self) -> list[str]:
        """Names of the parameters: "yaw.m", "motor_5.stops[1]"."""
        bodies = [f"{frame}.{name}" for frame in self.frames for name in BODY_PARAMETERS]
        coefficient = [
            f"{name}.{term}[{k}]" if len(train.terms[term]) > 1 else f"{name}.{term}"
            for name, train in self.trains.items()
            for term, k in labels(train)
        ]
        return bodies + coefficient

    @property
    def values(self) -> Array:
        """The parameters as the arm and the drivetrains have them, (p,)."""
        own = [
            sum((parameters(b) for b in self._own(frame)), np.zeros(10)) for frame in self.frames
        ]
        return np.concatenate([*own, *(coefficients(t) for t in self.trains.values())])

    def regressor(self, motion: JointMotion) -> tuple[Array, Array]:
        """Return d effort / d parameters, (k, n, p), and efforts of the known bodies, (k, n)."""
        motions = frame_motions(self.arm.mechanism, motion, self.frames)
        blocks = [body_regressor(motions[frame]) for frame in self.frames]
        for train in self.trains.values():
            weight = weights(train, self.arm)
            blocks.append(weight[:, None] * basis(train, weight, motion)[:, None, :])
        known = tuple(b for b in self.arm.bodies if b not in self._identified)
        rest = rigid_efforts(replace(self.arm, bodies=known, rotor={}), motion)
        return np.concatenate(blocks, axis=-1), rest

    @property
    def _identified(self) -> list[Body]:
        return [body for frame in self.frames for body in self._own(frame)]

    def _own(self, frame: str) -> list[Body]:
        return [b for b in self.arm.bodies if b.frame == frame and b.part == self.arm.name]


def moving_bodies(arm: ArmDescription, joints: Sequence[str]) -> tuple[str, ...]:
    """Return the frames of the arm's own bodies to identify: those that only these joints move.

    Raises:
        InputError: the arm has no masses
    """
    mechanism = arm.mechanism
    rest = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    rates = coordinate_rates(mechanism, coordinates(mechanism, rest[None]))[0]
    logged = [mechanism.joint_index[name] for name in joints]
    others = [k for k in range(len(mechanism.joints)) if k not in logged]

    def moved(frame: str) -> bool:
        chain = rates[list(mechanism.chain(frame))]
        return bool(chain[:, logged].any()) and not chain[:, others].any()

    known = KNOWN_BODIES.get(arm.type, ())
    own = [
        b.frame
        for b in arm.bodies
        if b.part == arm.name and b.mass > LEAST_MASS and b.frame not in known and moved(b.frame)
    ]
    if not own:
        raise InputError(
            f"{arm.name}: has no bodies with masses; allowed: an arm whose TOML has [[body]] tables"
        )
    return tuple(dict.fromkeys(own))


def loaded(arm: ArmDescription, known: Sequence[Weight]) -> ArmDescription:
    """Return an arm with known weights strapped to it."""
    return replace(arm, bodies=(*arm.bodies, *(weight.body(arm) for weight in known)))


def filtered_regressor(
    model: EffortModel, log: FilteredLog, counted: Array | None = None
) -> tuple[Array, Array]:
    """Return the regressor and the efforts of a log without its known terms, filtered and cut.

    Args:
        model: the parameters
        log: of efforts
        counted: weight of each sample before the filters, (k, n), which a sample of weight 0 does
            not reach then; 1 when omitted

    Returns:
        (k, n, p) and (k, n), n columns of the log: the regressor, and efforts less the known ones
    """
    matrix, rest = model.regressor(log.motion)
    count = log.log.q.shape[1]
    to_columns = log.log.joint_from_column
    turned = np.einsum("kjp,jc->kcp", matrix[:, :count], to_columns)
    rest = rest[:, :count] @ to_columns
    if counted is None:
        return log.smooth(turned), log.cut(log.effort) - log.smooth(rest)
    effort = log.log.effort @ to_columns
    return log.smooth(turned * counted[..., None]), log.smooth((effort - rest) * counted)


def predicted_efforts(
    arm: ArmDescription, trains: Mapping[str, Drivetrain], motion: JointMotion
) -> Array:
    """Return the joint efforts along a motion by inverse dynamics, (k, n) [N m or N].

    Args:
        arm: with its bodies; its own friction and rotors are left out
        trains: the forces of its drivetrains, rotors included
        motion: of all its joints, at even times
    """
    return rigid_efforts(replace(arm, rotor={}), motion) + train_efforts(trains, arm, motion)
