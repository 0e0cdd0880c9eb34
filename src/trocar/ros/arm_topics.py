"""Topics and services of arms: what they publish, and which verb each command calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.endoscopes import ENDOSCOPES
from trocar.descriptions.mounting import fitting_tools
from trocar.descriptions.records import ArmDescription, RigArm
from trocar.descriptions.tool_versions import full_name, tool_of_version
from trocar.errors import InputError
from trocar.live.inbox import Command
from trocar.ros import message_builders as build
from trocar.ros.clock import Stamp
from trocar.ros.message_fields import (
    DoubtfulError,
    RefusedError,
    flag,
    joints,
    joints_or_none,
    number,
    point,
    pose,
    rotation,
    text,
    vector,
    wrench,
)
from trocar.ros.topic import (
    BOOL,
    COMMAND,
    EMPTY,
    FLOAT,
    FORCE,
    JOINTS,
    JOY,
    MATRIX,
    PLACE,
    POSE,
    SI,
    SPEED,
    STATE,
    STRING,
    TWIST,
    WRENCH,
    Make,
    Topic,
    command,
    latched,
    prefix,
    state,
)
from trocar.simulation.arm import STATE_COMMANDS
from trocar.simulation.controllers import CartesianImpedance, HalfPlaneGains
from trocar.simulation.readout import ArmReadout, turned
from trocar.simulation.records import ArmStatus

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]
Message = Mapping[str, Any]
#: A verb of the arm and its arguments.
Verb = tuple[str, Mapping[str, Any]]
#: The same, which may have a warning about its message.
NotedVerb = Verb | tuple[str, Mapping[str, Any], str]
#: Reads a message for an arm with its tool, as it is now.
Reader = Callable[[Message, ArmDescription], NotedVerb]
#: Does a verb of an arm in place of the arm: (its name, the arguments, the world).
Act = Callable[[str, Mapping[str, Any], "World"], object]

NO_TOOL = ("", "none", "NONE")

# ---------------------------------------------------------------------- messages from readings


NOTHING = np.zeros(0)


def _joints(prefix: str) -> Callable[[ArmReadout, Stamp], Any]:
    """Return the maker of a JointState: prefix "" for measured, "setpoint_" for set-points."""
    q, qd, effort = f"{prefix}q", f"{prefix}qd", f"{prefix}effort"

    def make(arm: ArmReadout, stamp: Stamp) -> Any:
        s, own = arm.sample, arm.own
        names = _setup_names(arm.name, own.stop) if arm.arm.type == "SUJ" else arm.names[own]
        return build.joints(
            stamp, names, getattr(s, q)[own], getattr(s, qd)[own], getattr(s, effort)[own]
        )

    return make


def _end(prefix: str, *parts: str) -> Callable[[ArmReadout, Stamp], Any]:
    """Return the maker of a jaw's or gripper's JointState.

    Args:
        prefix: "" for measured, "setpoint_" for set-points
        parts: "q", "qd", "effort": which fields have numbers. Source: recorded answers of the
            dVRK's software, and SAW 9e535e6, mtsIntuitiveResearchKitMTM.cpp:104
    """

    def make(arm: ArmReadout, stamp: Stamp) -> Any:
        if arm.own.stop == len(arm.names):
            return None
        s = arm.sample
        found = (getattr(s, f"{prefix}{p}")[-1:] if p in parts else NOTHING for p in FIELDS)
        return build.joints(stamp, arm.names[-1:], *found)

    return make


FIELDS = ("q", "qd", "effort")


@lru_cache(maxsize=64)
def _setup_names(arm: str, count: int) -> tuple[str, ...]:
    """Return the names of setup joints in messages. Source: SAW 9e535e6, SUJ.cpp:105."""
    return tuple(f"{arm}_J{k}" for k in range(count))


def _gravity(arm: ArmReadout, stamp: Stamp) -> Any:
    s, own = arm.sample, arm.own
    load = s.load[own] if s.status.balanced else np.zeros(own.stop)
    return build.joints(stamp, arm.names[own], NOTHING, NOTHING, load)


def _tip(setpoint: bool, local: bool) -> Callable[[ArmReadout, Stamp], Any]:
    def make(arm: ArmReadout, stamp: Stamp) -> Any:
        frame = arm.own_frame if local else arm.base_frame
        return build.pose_stamped(stamp, frame, arm.tip(setpoint=setpoint, local=local))

    return make


def measured_cv(arm: ArmReadout, stamp: Stamp) -> dict[str, Any]:
    """Make a TwistStamped; its header names the arm's own base whatever the base frame is.

    Source: SAW 9e535e6, mtsIntuitiveResearchKitArm.cpp:292 and :2280, and recorded answers.
    """
    return build.twist_stamped(stamp, arm.own_frame, arm.twist(local=False))


def _local_measured_cv(arm: ArmReadout, stamp: Stamp) -> Any:
    """Make a TwistStamped in axes of the tip, though its header names the base.

    Source: SAW 9e535e6, mtsIntuitiveResearchKitArm.cpp:993: the body Jacobian's velocities.
    """
    R = arm.tip(setpoint=False, local=True)[:3, :3]
    return build.twist_stamped(stamp, arm.own_frame, turned(R.T, arm.twist(local=True)))


def _wrench(arm: ArmReadout, stamp: Stamp, frame: Any) -> Any:
    """Make a WrenchStamped; no frame is named, as in SAW 9e535e6, Arm.cpp:305."""
    return build.wrench_stamped(stamp, "", arm.wrench(frame))


def _jacobian(arm: ArmReadout, stamp: Stamp, frame: Any) -> Any:  # noqa: ARG001  as every make
    return build.matrix(arm.jacobian(frame))


def _up(arm: ArmStatus) -> dict[str, Any]:  # noqa: ARG001  as every content
    return build.joy(0)


def _first_status(arm: ArmStatus) -> dict[str, Any]:
    return {"data": f"current state {arm.phase}"}


# ---------------------------------------------------------------------- verbs from messages


@lru_cache(maxsize=64)
def _own(arm: ArmDescription) -> tuple[str, ...]:
    return arm.mechanism.joint_names[: arm.own_joints]


def _state(message: Message, arm: ArmDescription) -> Verb:  # noqa: ARG001  as every reader
    verb = text(message, "string")
    if verb not in STATE_COMMANDS:
        raise RefusedError("state", f"got {verb!r}; allowed: {', '.join(STATE_COMMANDS)}")
    return verb, {}


def _servo_jp(message: Message, arm: ArmDescription) -> Verb:
    names = _own(arm)
    q = joints(message, "position", names)
    v = joints_or_none(message, "velocity", names)
    return "servo_jp", {"q": q} if v is None else {"q": q, "v": v}


#: {end of a verb: the field of a JointState that it takes, and its argument}.
JOINT_VERBS = {
    "jp": ("position", "q"),
    "jr": ("position", "dq"),
    "jv": ("velocity", "v"),
    "jf": ("effort", "effort"),
}


def _joint_verb(verb: str) -> Reader:
    values, argument = JOINT_VERBS[verb[-2:]]
    return lambda message, arm: (verb, {argument: joints(message, values, _own(arm))})


def _goal(message: Message, names: Sequence[str], part: str = "") -> NotedVerb:
    """Read move_jp; with too few numbers the goal is that of the last move, as on the robot.

    Source: SAW 9e535e6, mtsIntuitiveResearchKitArm.cpp:2132; recorded answers to 0 and 5 values.
    """
    got, count = len(vector(message, "position")), len(names)
    if got < count:
        note = f"got {got} numbers in position; allowed: {count}, for {', '.join(names)}"
        return "move_again", {}, f"{note}; the goal of the last move stays"
    return f"{part}move_jp", {"q": joints(message, "position", names)}


def _move_jp(message: Message, arm: ArmDescription) -> NotedVerb:
    return _goal(message, _own(arm))


def _jaw_verb(verb: str) -> Reader:
    values, argument = JOINT_VERBS[verb[-2:]]

    def read(message: Message, arm: ArmDescription) -> NotedVerb:
        if not arm.has_jaw:
            raise RefusedError("jaw", f"{arm.tool or 'the bare arm'} has no jaw")
        if verb == "move_jp":
            return _goal(message, ("jaw",), "jaw.")
        return f"jaw.{verb}", {argument: joints(message, values, ("jaw",))}

    return read


def _pose_verb(verb: str) -> Reader:
    return lambda message, arm: (verb, {"T": pose(message, "pose")})  # noqa: ARG005


def _wrench_verb(frame: str) -> Reader:
    return lambda message, arm: (  # noqa: ARG005
        "servo_cf",
        {"wrench": wrench(message, "wrench"), "frame": frame},
    )


def _servo_cs(message: Message, arm: ArmDescription) -> NotedVerb:
    """Follow the pose, or exert the wrench; the velocity is not needed, a servo has its own."""
    valid = {what: flag(message, f"{what}_is_valid.data") for what in ("pose", "twist", "wrench")}
    if valid["pose"] == valid["wrench"]:
        raise RefusedError(
            "valid",
            "got a CartesianState with "
            + ("a pose and a wrench" if valid["pose"] else "neither pose nor wrench")
            + " valid; allowed: one of them",
        )
    return (_pose_verb("servo_cp") if valid["pose"] else _wrench_verb("body"))(message, arm)


def _servo_ci(message: Message, arm: ArmDescription) -> Verb:  # noqa: ARG001
    kinds = (f"{part}_{way}" for part in ("position", "orientation") for way in SIDES)
    impedance = CartesianImpedance(
        point(message, "force_position"),
        rotation(message, "force_orientation"),
        rotation(message, "torque_orientation"),
        **{side: _gains(message, side) for side in kinds},
    )
    return "servo_ci", {"impedance": impedance}


SIDES = ("positive", "negative")


def _gains(message: Message, side: str) -> HalfPlaneGains:
    values = {name: point(message, f"{side}.{name}") for name in ("p", "d", "bias", "deadband")}
    if (values["deadband"] < 0.0).any():
        raise RefusedError("gains", f"got {side}.deadband below 0; allowed: 0 or more")
    return HalfPlaneGains(**values)


def _plain(verb: str) -> Reader:
    return lambda message, arm: (verb, {})  # noqa: ARG005


def _switch(verb: str) -> Reader:
    return lambda message, arm: (verb, {"on": flag(message, "data")})  # noqa: ARG005


def _gravity_switch(message: Message, arm: ArmDescription) -> NotedVerb:
    """Read use_gravity_compensation; note where the robot ignores it unless it is configured.

    Source: SAW 9e535e6, `ConfigureGC` of mtsIntuitiveResearchKitPSM.cpp:254 and MTM.cpp:212.
    """
    verb, arguments = "use_gravity_compensation", {"on": flag(message, "data")}
    key = {"PSM": "kinematic_gc", "MTM": "gravity_compensation"}.get(arm.type)
    if not arguments["on"] or key is None or (arm.type == "PSM" and arm.generation == "Si"):
        return verb, arguments
    note = f'it is on; the robot ignores this where the file of its arm has no "{key}"'
    return verb, arguments, note


def _brakes(message: Message, arm: ArmDescription) -> Verb:  # noqa: ARG001
    return ("lock_brakes" if flag(message, "data") else "release_brakes"), {}


def _ratio(of: str) -> Reader:
    def read(message: Message, arm: ArmDescription) -> Verb:  # noqa: ARG001
        ratio = number(message, "data")
        if not 0.0 < ratio <= 1.0:
            raise RefusedError("ratio", f"got a ratio of {ratio:g}; allowed: above 0, up to 1")
        return "set_trajectory_ratio", {"ratio": ratio, "of": of}

    return read


def _base_frame(message: Message, arm: ArmDescription) -> Verb:  # noqa: ARG001
    frame = text(message, "header.frame_id")
    return "set_base_frame", {"T": pose(message, "pose"), "frame_id": frame}


def _lock(message: Message, arm: ArmDescription) -> Verb:  # noqa: ARG001
    return "lock_orientation", {"R": rotation(message, "")}


def _gripper(message: Message, arm: ArmDescription) -> Verb:
    """Be the fingers of a hand, which the simulated master lacks."""
    last = arm.joints[-1]
    opening = float(joints(message, "position", (last.name,))[0])
    if not last.lower <= opening <= last.upper:
        raise RefusedError(
            "opening", f"got an opening of {opening:g}; allowed: {last.lower:g} to {last.upper:g}"
        )
    if opening == last.upper:
        return "gripper.release", {}
    return "gripper.squeeze_to", {"angle": opening}


def _tool(message: Message, arm: ArmDescription) -> Verb:
    """Mount one of the built-in tools; a message names no file."""
    name = text(message, "data")
    if name in NO_TOOL:
        return "set_tool_type", {"name": "none"}
    known = fitting_tools(arm)
    try:
        tool = tool_of_version(name)
    except InputError:
        tool = name
    if tool in known:
        return "set_tool_type", {"name": tool}
    return "reject_type", {"kind": "tool", "name": name, "known": (*known, "none")}


def _endoscope(message: Message, arm: ArmDescription) -> Verb:  # noqa: ARG001
    name = text(message, "data")
    if name not in ENDOSCOPES:
        return "reject_type", {"kind": "endoscope", "name": name, "known": tuple(ENDOSCOPES)}
    return "set_endoscope_type", {"name": name}


# ---------------------------------------------------------------------- the rows

EVERY = (
    latched("operating_state", STATE, "state, is_homed, is_busy"),
    latched("desired_state", STRING, "the last commanded state",
            first=lambda arm: {"data": arm.desired}),
    latched("goal_reached", BOOL, "whether a move reached its goal"),
    latched("error", STRING, "why the arm is in FAULT"),
    latched("warning", STRING, "what was rejected or clipped, and why"),
    latched("status", STRING, "states, desired and current, and other events",
            first=_first_status),
    command("state_command", COMMAND, "", "enable, disable, home, unhome, pause, resume", _state),
    state("measured_js", JOINTS, SI, "measured joints, jaw or gripper not included", _joints("")),
    state("measured_cp", POSE, PLACE, "the tip, in the frame that the header names",
            _tip(False, False)),
    state("local/measured_cp", POSE, PLACE, "the tip in the arm's own base frame",
            _tip(False, True)),
    command("servo_jp", JOINTS, "rad, m", "set-points now; may carry velocities", _servo_jp, True),
    command("move_jp", JOINTS, "rad, m", "a goal, reached within the arm's limits",
            _move_jp),
)  # fmt: skip

#: Of arms with motors of their own: PSM, ECM, MTM.
MOVERS = (
    state("setpoint_js", JOINTS, SI, "set-points of the joints' servos", _joints("setpoint_")),
    state("gravity_compensation/setpoint_js", JOINTS, "N m, N",
            "efforts that carry the links' weight; zero while switched off", _gravity),
    state("setpoint_cp", POSE, PLACE, "the tip at the set-points, as measured_cp",
            _tip(True, False)),
    state("local/setpoint_cp", POSE, PLACE, "the same in the arm's own base frame",
            _tip(True, True)),
    state("measured_cv", TWIST, SPEED, "of the tip, in axes of measured_cp's frame", measured_cv),
    state("local/measured_cv", TWIST, SPEED, "of the tip, in its own axes",
            _local_measured_cv),
    state("body/measured_cf", WRENCH, FORCE, "wrench of the motors at the tip, in its axes",
            partial(_wrench, frame="body")),
    state("spatial/measured_cf", WRENCH, FORCE,
            "the same about the base frame's origin, in its axes",
            partial(_wrench, frame="spatial")),
    state("body/jacobian", MATRIX, "", "6 x n, (linear; angular), at the tip in its axes",
            partial(_jacobian, frame="body")),
    state("spatial/jacobian", MATRIX, "", "6 x n, about the base frame's origin",
            partial(_jacobian, frame="spatial")),
    latched("trajectory_j/ratio", FLOAT, "ratio of both limits; 0 while they differ",
            content=lambda arm: {"data": arm.ratios[0] if len(set(arm.ratios)) == 1 else 0.0}),
    latched("trajectory_j/ratio_v", FLOAT, "ratio of the velocity limits",
            content=lambda arm: {"data": arm.ratios[0]}),
    latched("trajectory_j/ratio_a", FLOAT, "ratio of the acceleration limits",
            content=lambda arm: {"data": arm.ratios[1]}),
    command("servo_jr", JOINTS, "rad, m", "add to the set-points now", _joint_verb("servo_jr"),
            True),
    command("move_jr", JOINTS, "rad, m", "move on from the goal", _joint_verb("move_jr")),
    command("servo_jv", JOINTS, "rad/s, m/s", "velocities, in the field velocity",
            _joint_verb("servo_jv"), True),
    command("servo_jf", JOINTS, "N m, N", "efforts, in the field effort", _joint_verb("servo_jf"),
            True),
    command("servo_cp", POSE, PLACE, "a pose of the tip now, as measured_cp",
            _pose_verb("servo_cp"), True),
    command("servo_cr", POSE, PLACE, "a step from the set-point", _pose_verb("servo_cr")),
    command("move_cp", POSE, PLACE, "a goal of the tip, as measured_cp", _pose_verb("move_cp")),
    command("servo_cs", "crtk_msgs/CartesianState", SI, "pose, velocity and force, by its mask",
            _servo_cs, True),
    command("body/servo_cf", WRENCH, FORCE, "a wrench at the tip, in its axes",
            _wrench_verb("body"), True),
    command("spatial/servo_cf", WRENCH, FORCE, "a wrench about the base frame's origin",
            _wrench_verb("spatial"), True),
    command("servo_ci", "crtk_msgs/CartesianImpedance", SI, "a spring and damper about a pose",
            _servo_ci, True),
    command("hold", EMPTY, "", "end every move and stay", _plain("hold")),
    command("free", EMPTY, "", "gravity compensation only", _plain("free")),
    command("use_gravity_compensation", BOOL, "", "switch gravity compensation",
            _gravity_switch),
    command("body/set_cf_orientation_absolute", BOOL, "",
            "wrenches in axes of measured_cp's frame", _switch("set_cf_orientation_absolute")),
    command("trajectory_j/set_ratio", FLOAT, "above 0 to 1",
            "ratio of both limits, for new moves", _ratio("both")),
    command("trajectory_j/set_ratio_v", FLOAT, "above 0 to 1", "ratio of the velocity limits",
            _ratio("velocity")),
    command("trajectory_j/set_ratio_a", FLOAT, "above 0 to 1", "ratio of the acceleration limits",
            _ratio("acceleration")),
    command("set_base_frame", POSE, PLACE, "the arm's base in measured_cp's frame", _base_frame),
)  # fmt: skip

CLUTCHES = (
    latched("arm_clutch", JOY, "the button on the arm", first=_up),
    latched("IO/arm_clutch", JOY, "the button on the arm", first=_up),
    latched("IO/SUJ_clutch", JOY, "the button of its setup joints", first=_up),
)

PSM = (
    state("jaw/measured_js", JOINTS, "rad, N m", "the measured opening", _end("", *FIELDS)),
    state("jaw/setpoint_js", JOINTS, "rad, N m", "set-point of the opening, without velocity",
            _end("setpoint_", "q", "effort")),
    command("jaw/servo_jp", JOINTS, "rad", "an opening now", _jaw_verb("servo_jp"), True),
    command("jaw/move_jp", JOINTS, "rad", "an opening to go to; below 0 it grips",
            _jaw_verb("move_jp")),
    command("jaw/servo_jf", JOINTS, "N m", "the jaw's effort", _jaw_verb("servo_jf"), True),
    command("set_tool_type", STRING, "", "mount a tool, NAME:CODE[VERSION]", _tool),
    latched("tool_type", STRING, "the mounted tool, NAME:CODE[VERSION]; ERROR: unknown",
            content=lambda arm: {"data": full_name(arm.tool)}),
    latched("tool_type_request", EMPTY, "a tool of unknown kind was mounted"),
    command("emulate_adapter_present", BOOL, "", "as if the sterile adapter were mounted",
            _switch("emulate_adapter_present")),
    command("emulate_tool_present", BOOL, "", "as if a tool were mounted or taken off",
            _switch("emulate_tool_present")),
    *CLUTCHES,
    latched("IO/adapter", JOY, "whether a sterile adapter is mounted"),
    latched("IO/tool", JOY, "whether a tool is mounted",
            content=lambda arm: build.joy(int(bool(arm.tool)))),
)  # fmt: skip

ECM = (
    command("set_endoscope_type", STRING, "", "which endoscope is mounted", _endoscope),
    latched("endoscope_type", STRING, "which endoscope is mounted", first=lambda _: {"data": ""}),
    *CLUTCHES,
)

MTM = (
    state("gripper/measured_js", JOINTS, "rad", "the measured opening, position only",
            _end("", "q")),
    command("gripper/servo_jp", JOINTS, "rad", "hold an opening, as by fingers; wide open: release",
            _gripper, True),
    latched("gripper/pinch", EMPTY, "the gripper was shut"),
    latched("gripper/closed", BOOL, "whether it is shut", content=lambda arm: {"data": arm.closed}),
    command("lock_orientation", "geometry_msgs/Quaternion", "xyzw", "an orientation for the gimbal",
            _lock),
    command("unlock_orientation", EMPTY, "", "release the gimbal", _plain("unlock_orientation")),
    latched("orientation_locked", BOOL, "whether the gimbal holds an orientation",
            content=lambda arm: {"data": arm.orientation_locked}),
)  # fmt: skip

#: Setup joints; potentiometers and brakes are this simulator's own.
SUJ = (
    state("potentiometers/measured_js", JOINTS, "rad, m", "readings of the potentiometers",
            _joints("")),
    command("lock_brakes", BOOL, "", "lock or release all brakes", _brakes),
    latched("brakes_locked", BOOL, "whether every brake is locked",
            content=lambda arm: {"data": arm.brakes_locked}),
)  # fmt: skip

EXTRA = {"PSM": PSM, "ECM": ECM, "MTM": MTM, "SUJ": SUJ}


def arm_rows(arm: ArmDescription) -> tuple[Topic, ...]:
    """Return the rows of an arm, their names and functions without its own."""
    return EVERY + (() if arm.type == "SUJ" else MOVERS) + EXTRA[arm.type]


def arm_topics(arm: RigArm, acts: Mapping[str, Act]) -> list[Topic]:
    """Return the topics of an arm.

    Args:
        arm: an arm of a rig
        acts: {verb: what does it in place of the arm}
    """
    before, name = prefix(arm.name, arm.arm), arm.name
    found: list[Topic] = []
    for row in arm_rows(arm.arm):
        topic = row.under(before, name)
        if row.make is not None:
            topic = replace(topic, make=_bound_make(row.make, name))
        elif row.read is not None:
            topic = replace(topic, read=_bound_read(row.read, name, topic.name, acts))
        found.append(topic)
    return found


def _bound_make(make: Any, name: str) -> Make:
    return lambda readings, stamp: make(readings.arm(name), stamp)


def _bound_read(read: Any, name: str, topic: str, acts: Mapping[str, Act]) -> Any:
    def command(message: Message, arm: ArmDescription) -> Command:
        try:
            found = read(message, arm)
        except DoubtfulError as doubt:
            return msgspec.structs.replace(command(doubt.message, arm), note=str(doubt))
        verb, values, note = found if len(found) == 3 else (*found, "")
        act = acts.get(verb)
        return Command(name, verb, values, topic, "", act and partial(act, name, values), note)

    return command
