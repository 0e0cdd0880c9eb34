"""The interface that is expected of an arm: topics, services and joints, each with a source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from trocar.ros.topic import (
    BOOL,
    COMMAND,
    EMPTY,
    FLOAT,
    JOINTS,
    JOY,
    MATRIX,
    POSE,
    STATE,
    STRING,
    TWIST,
    WRENCH,
)

CRTK = "CRTK, Robot API (collaborative-robotics/documentation wiki)"
#: The dVRK's own software, recorded in KINEMATIC simulation on 2026-11-27.
SOFTWARE = "sawIntuitiveResearchKit 9e535e6"
LISTED = f"recorded: rostopic list -v and rosservice list of {SOFTWARE}"
SNAPSHOT = f"recorded: messages at home of {SOFTWARE}"
STATES_TABLE = f"recorded: state commands A1 to A34 of {SOFTWARE}"
MOVES_TABLE = f"recorded: moves B1 to B18 of {SOFTWARE}"
CARTESIAN_TABLE = f"recorded: Cartesian commands of {SOFTWARE}"
JAW_TABLE = f"recorded: jaw commands E1 to E12 of {SOFTWARE}"
RATES = "dVRK 2.4: dvrk_system.cpp, 10 ms between states by default"
BRIDGE = "cisst-ros, mtsROSBridge.h: publishers of events are latched"
JOINT_STATE = "sensor_msgs/JointState"
REP = "ROS REP 103; std_msgs/Header"

#: States of an arm, and what `desired_state` may hold beside them.
STATES = ("DISABLED", "ENABLED", "PAUSED", "FAULT")
DESIRED = (*STATES, "HOMED")

#: Types of streams: published every period.
STREAMS: Mapping[str, str] = {
    "measured_js": JOINTS,
    "setpoint_js": JOINTS,
    "gravity_compensation/setpoint_js": JOINTS,
    "measured_cp": POSE,
    "setpoint_cp": POSE,
    "local/measured_cp": POSE,
    "local/setpoint_cp": POSE,
    "measured_cv": TWIST,
    "local/measured_cv": TWIST,
    "body/measured_cf": WRENCH,
    "spatial/measured_cf": WRENCH,
    "body/jacobian": MATRIX,
    "spatial/jacobian": MATRIX,
}
#: Types of events: published on change, and latched.
EVENTS: Mapping[str, str] = {
    "operating_state": STATE,
    "desired_state": STRING,
    "error": STRING,
    "warning": STRING,
    "status": STRING,
    "goal_reached": BOOL,
    "trajectory_j/ratio": FLOAT,
    "trajectory_j/ratio_v": FLOAT,
    "trajectory_j/ratio_a": FLOAT,
}
COMMANDS: Mapping[str, str] = {
    "state_command": COMMAND,
    "servo_jp": JOINTS,
    "servo_jr": JOINTS,
    "servo_jf": JOINTS,
    "move_jp": JOINTS,
    "move_jr": JOINTS,
    "servo_cp": POSE,
    "move_cp": POSE,
    "servo_cs": "crtk_msgs/CartesianState",
    "servo_ci": "crtk_msgs/CartesianImpedance",
    "body/servo_cf": WRENCH,
    "spatial/servo_cf": WRENCH,
    "hold": EMPTY,
    "free": EMPTY,
    "use_gravity_compensation": BOOL,
    "body/set_cf_orientation_absolute": BOOL,
    "trajectory_j/set_ratio": FLOAT,
    "trajectory_j/set_ratio_v": FLOAT,
    "trajectory_j/set_ratio_a": FLOAT,
    "set_base_frame": POSE,
}
FORWARD, INVERSE = "crtk_msgs/QueryForwardKinematics", "crtk_msgs/QueryInverseKinematics"
SERVICES: Mapping[str, str] = {
    "forward_kinematics": FORWARD,
    "local/forward_kinematics": FORWARD,
    "inverse_kinematics": INVERSE,
    "operating_state": "crtk_msgs/TriggerOperatingState",
    "crtk_version": "std_srvs/Trigger",
    "actuator_to_joint_position": "cisst_msgs/ConvertFloat64Array",
}
#: Without these an arm is no arm of CRTK.
CORE = ("measured_js", "operating_state", "state_command")
#: Latched events that always have a value: a late subscriber gets it.
VALUED = ("operating_state", "trajectory_j/ratio", "trajectory_j/ratio_v", "trajectory_j/ratio_a")


@dataclass(frozen=True)
class ArmExpectation:
    """The interface of one kind of arm.

    Attributes:
        kind: "PSM", "ECM", "MTM", or "CRTK" for an arm that is not the dVRK's
        streams, events, commands, services: {name without the arm: type}
        required: names that must be there; types of others are compared where they are
        joints: names in order, () where they are the arm's own
        part: name of the jaw or gripper, with topics of its own; "" without
        middle: places that small moves lead towards [rad or m], () zero
        acceleration: of moves at a ratio of 1 [rad or m, per s2], () unknown
    """

    kind: str
    streams: Mapping[str, str] = field(default_factory=lambda: dict(STREAMS))
    events: Mapping[str, str] = field(default_factory=lambda: dict(EVENTS))
    commands: Mapping[str, str] = field(default_factory=lambda: dict(COMMANDS))
    services: Mapping[str, str] = field(default_factory=lambda: dict(SERVICES))
    required: frozenset[str] = frozenset(CORE)
    joints: tuple[str, ...] = ()
    part: str = ""
    middle: tuple[float, ...] = ()
    acceleration: tuple[float, ...] = ()


def _all(*tables: Mapping[str, str]) -> frozenset[str]:
    return frozenset(name for table in tables for name in table)


def _dvrk(
    kind: str,
    joints: tuple[str, ...],
    *,
    streams: Mapping[str, str] | None = None,
    events: Mapping[str, str] | None = None,
    commands: Mapping[str, str] | None = None,
    part: str = "",
    middle: tuple[float, ...] = (),
    acceleration: tuple[float, ...] = (),
) -> ArmExpectation:
    whole = (
        {**STREAMS, **(streams or {})},
        {**EVENTS, **(events or {})},
        {**COMMANDS, **(commands or {})},
        SERVICES,
    )
    return ArmExpectation(kind, *whole, _all(*whole), joints, part, middle, acceleration)


PSM = _dvrk(
    "PSM",
    ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"),
    streams={"jaw/measured_js": JOINTS, "jaw/setpoint_js": JOINTS},
    events={"arm_clutch": JOY, "tool_type": STRING, "tool_type_request": EMPTY},
    commands={
        "jaw/servo_jp": JOINTS,
        "jaw/move_jp": JOINTS,
        "jaw/servo_jf": JOINTS,
        "set_tool_type": STRING,
        "emulate_adapter_present": BOOL,
        "emulate_tool_present": BOOL,
    },
    part="jaw",
    middle=(0.0, 0.0, 0.12, 0.0, 0.0, 0.0),
    # Source: phase plane of the moves B1.
    acceleration=(1.5708, 1.5708, 0.2, 12.5664, 12.5664, 12.5664),
)
ECM = _dvrk(
    "ECM",
    ("yaw", "pitch", "insertion", "roll"),
    events={"arm_clutch": JOY, "endoscope_type": STRING},
    commands={"set_endoscope_type": STRING},
    middle=(0.0, 0.0, 0.12, 0.0),
)
MTM = _dvrk(
    "MTM",
    (),
    streams={"gripper/measured_js": JOINTS},
    events={"orientation_locked": BOOL, "gripper/pinch": EMPTY, "gripper/closed": BOOL},
    commands={"lock_orientation": "geometry_msgs/Quaternion", "unlock_orientation": EMPTY},
    part="gripper",
)
ARM_OF_CRTK = ArmExpectation("CRTK")


def expectation(arm: str) -> ArmExpectation:
    """Return the interface of an arm by its name: that of the dVRK for PSM1, MTMR, ..."""
    kinds = {"PSM": PSM, "ECM": ECM, "MTM": MTM}
    return kinds.get(arm.rpartition("/")[2][:3], ARM_OF_CRTK)
