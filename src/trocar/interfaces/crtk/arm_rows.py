"""The rows of arms: (direction and marks, name, type, unit, help), names relative to the arm.

Marks: "state": published every period, else when something happens; "latched": a late subscriber
gets the last one; "1": of a stream of commands only the newest counts.
"""

from __future__ import annotations

from trocar.descriptions.records import ArmDescription

Row = tuple[str, str, str, str, str]

JOINTS = "sensor_msgs/JointState"
POSE = "geometry_msgs/PoseStamped"
TWIST = "geometry_msgs/TwistStamped"
WRENCH = "geometry_msgs/WrenchStamped"
MATRIX = "std_msgs/Float64MultiArray"
STRING, BOOL, FLOAT, EMPTY = (f"std_msgs/{name}" for name in ("String", "Bool", "Float64", "Empty"))
JOY = "sensor_msgs/Joy"
STATE = "crtk_msgs/OperatingState"
COMMAND = "crtk_msgs/StringStamped"
SI = "rad, m, N m, N"
PLACE = "m, quaternion xyzw"
SPEED = "m/s, rad/s"
FORCE = "N, N m"

#: What every arm tells of its state, setup joints included.
STATES: tuple[Row, ...] = (
    ("pub latched", "operating_state", STATE, "", "state, is_homed, is_busy; again every second"),
    ("pub latched", "desired_state", STRING, "", "the state that was asked for last"),
    ("pub", "goal_reached", BOOL, "", "whether a move that ended came to its goal"),
    ("pub", "error", STRING, "", "why the arm is in FAULT"),
    ("pub", "warning", STRING, "", "what was refused or clipped, and why"),
    ("pub", "status", STRING, "", "what else happened"),
    ("sub", "state_command", COMMAND, "", "enable, disable, home, unhome, pause, resume"),
)

#: Where every arm is, setup joints included.
PLACES: tuple[Row, ...] = (
    ("pub state", "measured_js", JOINTS, SI, "measured joints, jaw or gripper not included"),
    ("pub state", "measured_cp", POSE, PLACE, "the tip, in the frame that the header names"),
    ("pub state", "local/measured_cp", POSE, PLACE, "the tip in the arm's own base frame"),
    ("sub 1", "servo_jp", JOINTS, "rad, m", "set-points now; may carry velocities"),
    ("sub", "move_jp", JOINTS, "rad, m", "a goal, reached within the arm's limits"),
)

#: What only arms with motors of their own have: PSM, ECM, MTM.
MOVERS: tuple[Row, ...] = (
    ("pub state", "setpoint_js", JOINTS, SI, "what the joints' servos are told"),
    (
        "pub state",
        "gravity_compensation/setpoint_js",
        JOINTS,
        "N m, N",
        "efforts that carry the links' weight; zero while switched off",
    ),
    ("pub state", "setpoint_cp", POSE, PLACE, "the tip at the set-points, as measured_cp"),
    ("pub state", "local/setpoint_cp", POSE, PLACE, "the same in the arm's own base frame"),
    ("pub state", "measured_cv", TWIST, SPEED, "of the tip, in axes of measured_cp's frame"),
    ("pub state", "local/measured_cv", TWIST, SPEED, "of the tip, in axes of its own base frame"),
    ("pub state", "body/measured_cf", WRENCH, FORCE, "what the motors exert at the tip, its axes"),
    (
        "pub state",
        "spatial/measured_cf",
        WRENCH,
        FORCE,
        "the same about the base frame's origin, in its axes",
    ),
    ("pub state", "body/jacobian", MATRIX, "", "6 x n, (linear; angular), tip and its axes"),
    ("pub state", "spatial/jacobian", MATRIX, "", "6 x n, about the base frame's origin"),
    ("pub latched", "trajectory_j/ratio", FLOAT, "", "share of both limits that moves keep to"),
    ("pub latched", "trajectory_j/ratio_v", FLOAT, "", "share of the velocity limits"),
    ("pub latched", "trajectory_j/ratio_a", FLOAT, "", "share of the acceleration limits"),
    ("sub", "servo_jr", JOINTS, "rad, m", "add to the set-points now"),
    ("sub", "move_jr", JOINTS, "rad, m", "move on from the goal"),
    ("sub 1", "servo_jf", JOINTS, "N m, N", "efforts, in the field effort"),
    ("sub 1", "servo_cp", POSE, PLACE, "a pose of the tip now, as measured_cp"),
    ("sub", "servo_cr", POSE, PLACE, "a step from the pose that was set"),
    ("sub", "move_cp", POSE, PLACE, "a goal of the tip, as measured_cp"),
    ("sub 1", "servo_cs", "crtk_msgs/CartesianState", SI, "pose, velocity and force, by its mask"),
    ("sub 1", "body/servo_cf", WRENCH, FORCE, "a wrench at the tip, in its axes"),
    ("sub 1", "spatial/servo_cf", WRENCH, FORCE, "a wrench about the base frame's origin"),
    ("sub 1", "servo_ci", "crtk_msgs/CartesianImpedance", SI, "a spring and damper about a pose"),
    ("sub", "hold", EMPTY, "", "end every move and stay"),
    ("sub", "free", EMPTY, "", "exert nothing but gravity compensation"),
    ("sub", "use_gravity_compensation", BOOL, "", "switch gravity compensation"),
    (
        "sub",
        "body/set_cf_orientation_absolute",
        BOOL,
        "",
        "wrenches in axes of measured_cp's frame",
    ),
    (
        "sub",
        "trajectory_j/set_ratio",
        FLOAT,
        "0.002 to 1",
        "slow down moves that begin from now on",
    ),
    ("sub", "trajectory_j/set_ratio_v", FLOAT, "0.002 to 1", "their velocities alone"),
    ("sub", "trajectory_j/set_ratio_a", FLOAT, "0.002 to 1", "their accelerations alone"),
    ("sub", "set_base_frame", POSE, PLACE, "where the arm's base stands in measured_cp's frame"),
)

PSM: tuple[Row, ...] = (
    ("pub state", "jaw/measured_js", JOINTS, "rad, N m", "the measured opening"),
    ("pub state", "jaw/setpoint_js", JOINTS, "rad, N m", "the opening that its servo is told"),
    ("sub 1", "jaw/servo_jp", JOINTS, "rad", "an opening now"),
    ("sub", "jaw/move_jp", JOINTS, "rad", "an opening to go to; below 0 it grips"),
    ("sub 1", "jaw/servo_jf", JOINTS, "N m", "the jaw's effort"),
    ("sub", "set_tool_type", STRING, "", "mount a tool, NAME:CODE[VERSION]"),
    ("pub latched", "tool_type", STRING, "", "the mounted tool"),
    ("pub", "tool_type_request", EMPTY, "", "a tool was put on whose kind is not known"),
    ("sub", "emulate_adapter_present", BOOL, "", "as if the sterile adapter were put on"),
    ("sub", "emulate_tool_present", BOOL, "", "as if a tool were put on or taken off"),
    ("pub latched", "arm_clutch", JOY, "", "the button on the arm"),
    ("pub latched", "IO/arm_clutch", JOY, "", "the button on the arm"),
    ("pub latched", "IO/SUJ_clutch", JOY, "", "the button of its setup joints"),
    ("pub latched", "IO/adapter", JOY, "", "whether a sterile adapter is on"),
    ("pub latched", "IO/tool", JOY, "", "whether a tool is on"),
)

ECM: tuple[Row, ...] = (
    ("sub", "set_endoscope_type", STRING, "", "which endoscope is on"),
    ("pub latched", "endoscope_type", STRING, "", "which endoscope is on"),
    ("pub latched", "arm_clutch", JOY, "", "the button on the arm"),
    ("pub latched", "IO/arm_clutch", JOY, "", "the button on the arm"),
    ("pub latched", "IO/SUJ_clutch", JOY, "", "the button of its setup joints"),
)

MTM: tuple[Row, ...] = (
    ("pub state", "gripper/measured_js", JOINTS, "rad, N m", "the measured opening"),
    ("sub 1", "gripper/servo_jp", JOINTS, "rad", "fingers that hold an opening; wide open: none"),
    ("pub", "gripper/pinch", EMPTY, "", "the gripper was shut"),
    ("pub latched", "gripper/closed", BOOL, "", "whether it is shut"),
    ("sub", "lock_orientation", "geometry_msgs/Quaternion", "xyzw", "let the gimbal hold one"),
    ("sub", "unlock_orientation", EMPTY, "", "let the gimbal go"),
    ("pub latched", "orientation_locked", BOOL, "", "whether the gimbal holds one"),
)

#: Setup joints; potentiometers and brakes are this simulator's own.
SUJ: tuple[Row, ...] = (
    ("pub state", "potentiometers/measured_js", JOINTS, "rad, m", "what the potentiometers read"),
    ("sub", "lock_brakes", BOOL, "", "lock or release all brakes"),
    ("pub latched", "brakes_locked", BOOL, "", "whether every brake is locked"),
)

EXTRA = {"PSM": PSM, "ECM": ECM, "MTM": MTM, "SUJ": SUJ}

FORWARD = "crtk_msgs/QueryForwardKinematics"
SERVICES = (
    ("forward_kinematics", FORWARD, "the pose of the tip at joint positions, as measured_cp"),
    ("local/forward_kinematics", FORWARD, "the same in the arm's own base frame"),
    ("inverse_kinematics", "crtk_msgs/QueryInverseKinematics", "joint positions for a pose"),
    ("operating_state", "crtk_msgs/TriggerOperatingState", "the operating state now"),
    ("crtk_version", "std_srvs/Trigger", "the version of CRTK"),
    (
        "actuator_to_joint_position",
        "cisst_msgs/ConvertFloat64Array",
        "joint positions of actuators' positions",
    ),
)


def topics_of(arm: ArmDescription) -> tuple[Row, ...]:
    """Return the rows of an arm."""
    own = () if arm.type == "SUJ" else MOVERS
    return STATES + PLACES + own + EXTRA[arm.type]


def services_of(arm: ArmDescription) -> tuple[tuple[str, str, str], ...]:
    """Return (name, type, help) of an arm's services."""
    return SERVICES[3:5] if arm.type == "SUJ" else SERVICES
