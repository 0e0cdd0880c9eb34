"""Motion of mechanisms: trees with loops, forward and inverse kinematics, couplings."""

from trocar.geometry.screws import RemoteCentre, remote_centre
from trocar.kinematics.coupling import (
    Coupling,
    actuator_effort_from_joint,
    actuator_from_joint,
    joint_effort_from_actuator,
    joint_from_actuator,
)
from trocar.kinematics.forward import coordinates, pose, poses
from trocar.kinematics.inverse import inverse_kinematics
from trocar.kinematics.jacobian import jacobian_body, jacobian_spatial
from trocar.kinematics.loops import Flattening, branch_determinants, flattenings, gaps
from trocar.kinematics.mechanism import Closure, Frame, Joint, Mechanism

__all__ = [
    "Closure",
    "Coupling",
    "Flattening",
    "Frame",
    "Joint",
    "Mechanism",
    "RemoteCentre",
    "actuator_effort_from_joint",
    "actuator_from_joint",
    "branch_determinants",
    "coordinates",
    "flattenings",
    "gaps",
    "inverse_kinematics",
    "jacobian_body",
    "jacobian_spatial",
    "joint_effort_from_actuator",
    "joint_from_actuator",
    "pose",
    "poses",
    "remote_centre",
]
