"""Joints that recordings have on the motor side of a coupling."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError
from trocar.kinematics.coupling import Coupling, joint_effort_from_actuator, joint_from_actuator

Array = NDArray[np.float64]
Wrist = Literal["motor", "joint"]

#: Joints that recordings have as motor positions; the roll of a PSM is a joint position.
#: Source: dvrk_dynamics_identification, its recording script.
MOTOR_SIDE = {
    "PSM": ("wrist_pitch", "wrist_yaw", "jaw"),
    "MTM": ("shoulder_pitch", "elbow_pitch", "wrist_platform"),
}
#: Joints 2 to 4 of a master from its motors. Source: SAW share/kinematic/MTML.json.
MTM_COUPLING = Coupling(np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.6697, -0.6697, 1.0]]))


def recorded_joints(arm: ArmDescription) -> tuple[str, ...]:
    """Return the joints that a row holds: all but the gripper of an MTM, which has no motor."""
    names = arm.mechanism.joint_names
    return names[: arm.own_joints] if arm.type == "MTM" else names


def joints_from_motors(rows: Array, arm: ArmDescription) -> Array:
    """Convert rows (k, 3, n) whose coupled joints are motors to the public joints.

    Raises:
        InputError: the PSM's tool has no such coupling
    """
    if arm.type not in MOTOR_SIDE:
        return rows
    which, coupling = actuators_of_recording(arm)
    joints = rows.copy()
    joints[:, :2, which] = joint_from_actuator(coupling, joints[:, :2, which])
    joints[:, 2, which] = joint_effort_from_actuator(coupling, joints[:, 2, which])
    return joints


def actuators_of_recording(arm: ArmDescription) -> tuple[list[int], Coupling]:
    """Select the joints that a recording has on the motor side, and the coupling of these alone.

    Raises:
        InputError: the PSM's tool has no such coupling
    """
    names, sides = arm.mechanism.joint_names, MOTOR_SIDE[arm.type]
    which = [names.index(name) for name in sides if name in names]
    if arm.type == "MTM":
        return which, MTM_COUPLING
    coupled = arm.coupling.joints if arm.coupling else ()
    if arm.coupling is None or not set(sides) <= set(coupled):
        raise InputError(
            f"{arm.name}: the tool has no coupling of {', '.join(sides)}, required for a motor-side"
            " recording needs; allowed: wrist joint"
        )
    inner = [coupled.index(name) for name in sides]
    outer = [k for k in range(len(coupled)) if k not in inner]
    matrix = arm.coupling.actuator_to_joint
    if matrix[np.ix_(inner, outer)].any() or matrix[np.ix_(outer, inner)].any():
        raise InputError(
            f"{arm.name}: the coupling mixes {', '.join(sides)} with other joints; allowed:"
            " wrist joint"
        )
    return which, Coupling(matrix[np.ix_(inner, inner)])
