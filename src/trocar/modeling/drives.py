"""Identified drivetrains in a model: forces on hinges, and on tendons along several of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco

from trocar.descriptions.frames import pin_name
from trocar.descriptions.overlay_records import Drivetrain
from trocar.descriptions.records import ArmDescription
from trocar.modeling import naming
from trocar.modeling.options import STIFF_IMPEDANCE, STOP_STEPS


@dataclass(frozen=True)
class Drive:
    """Drivetrains that act along the same combination of hinges.

    Attributes:
        name: of the hinge, or of the tendon
        hinges: {frame: weight}, the first weight is 1; x = sum(weight * hinge coordinate)
        trains: (scale, drivetrain), whose coordinate is scale * x
    """

    name: str
    hinges: Mapping[str, float]
    trains: tuple[tuple[float, Drivetrain], ...]

    @property
    def armature(self) -> float:
        """Reflected rotor inertia [kg m^2 or kg]."""
        return sum(scale**2 * train.one("rotor") for scale, train in self.trains)

    @property
    def damping(self) -> float:
        """Viscous friction [N m s/rad or N s/m]."""
        return sum(scale**2 * train.one("viscous") for scale, train in self.trains)

    @property
    def frictionloss(self) -> float:
        """Coulomb friction without stop elements [N m or N]."""
        return sum(abs(scale) * train.one("coulomb") for scale, train in self.trains)


def arm_drives(arm: ArmDescription, friction: str) -> tuple[Drive, ...]:
    """Return the drives of an arm's identified dynamics, none without.

    Args:
        arm: the description with its overlay
        friction: as of `ModelOptions`; "paper" has none
    """
    overlay = arm.overlay
    if friction != "identified" or overlay is None or overlay.dynamics is None:
        return ()
    found: dict[tuple[tuple[str, float], ...], list[tuple[str, float, Drivetrain]]] = {}
    for label, train in overlay.dynamics.drivetrains.items():
        if not all(joint in arm.mechanism.joint_index for joint in train.along):
            continue  # of an instrument that is not mounted
        weights: dict[str, float] = {}
        for joint, weight in train.along.items():
            ((frame, share),) = arm.joint(joint).drive
            weights[frame] = weights.get(frame, 0.0) + weight * share
        scale = next(iter(weights.values()))
        key = tuple((frame, round(weight / scale, 12)) for frame, weight in weights.items())
        found.setdefault(key, []).append((label, scale, train))
    return tuple(
        Drive(
            key[0][0] if len(key) == 1 else f"drive/{rows[0][0]}",
            dict(key),
            tuple((scale, train) for _, scale, train in rows),
        )
        for key, rows in found.items()
    )


def frames_of_drives(arm: ArmDescription, drives: tuple[Drive, ...]) -> set[str]:
    """Return the frames whose friction and rotors are the drivetrains' alone, not pins."""
    covered = {joint for drive in drives for _, train in drive.trains for joint in train.along}
    pins = {pin_name(closure.name) for closure in arm.mechanism.closures}
    return {
        frame.name
        for frame in arm.mechanism.frames
        if frame.couplings
        and {joint for joint, _ in frame.couplings} <= covered
        and frame.name not in pins
    }


def add_tendons(spec: mujoco.MjSpec, arm: str, drives: tuple[Drive, ...], dt: float) -> None:
    """Add a tendon for each drive along several hinges; its length is the drive's coordinate.

    Args:
        spec: of the rig, with the arm's hinges
        arm: name of the arm
        drives: its drives
        dt: physics step [s]
    """
    for drive in drives:
        if len(drive.hinges) == 1:
            continue
        tendon = spec.add_tendon(name=naming.scoped(arm, drive.name))
        for frame, weight in drive.hinges.items():
            tendon.wrap_joint(naming.scoped(arm, frame), weight)
        tendon.armature = drive.armature
        tendon.damping = [drive.damping, 0.0, 0.0]
        tendon.frictionloss = drive.frictionloss
        tendon.solref_friction = [STOP_STEPS * dt, 1.0]
        tendon.solimp_friction = STIFF_IMPEDANCE
        tendon.springlength = [0.0, 0.0]
