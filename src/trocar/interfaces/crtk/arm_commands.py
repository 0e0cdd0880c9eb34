"""What a message on one of an arm's topics asks for: pure functions, a row per topic."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.mounting import fitting_tools
from trocar.descriptions.records import ArmDescription
from trocar.interfaces.crtk.fields import (
    Message,
    RefusedError,
    flag,
    joints,
    joints_or_none,
    number,
    text,
)
from trocar.interfaces.crtk.places import point, pose, rotation, wrench
from trocar.simulation.arm import STATE_COMMANDS
from trocar.simulation.controllers import CartesianImpedance, HalfPlaneGains
from trocar.simulation.moves import RATIO_MIN

Array = NDArray[np.float64]
#: A verb of the arm and its arguments.
Wish = tuple[str, Mapping[str, Any]]
Reader = Callable[[Message, ArmDescription], Wish]

#: Source: SAW mtsIntuitiveResearchKitEndoscopeTypes.cdg.
ENDOSCOPES = (
    "NONE",
    *(
        f"{kind}_{way}"
        for kind in ("Classic_SD", "Classic_HD", "Si_HD")
        for way in ("STRAIGHT", "UP", "DOWN")
    ),
)
BARE = ("", "none", "NONE")


def wish(key: str, message: Message, arm: ArmDescription) -> Wish:
    """Return the verb that a message asks for.

    Args:
        key: the topic without the arm's name
        message: whatever came
        arm: the arm with its tool, as it is now

    Raises:
        RefusedError: the message cannot be used; the reason says what is allowed
        KeyError: no such topic
    """
    return READERS[key](message, arm)


def _own(arm: ArmDescription) -> tuple[str, ...]:
    return arm.mechanism.joint_names[: arm.own_joints]


def _state(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001  as every reader
    asked = text(message, "string")
    if asked not in STATE_COMMANDS:
        raise RefusedError("state", f"got {asked!r}; allowed: {', '.join(STATE_COMMANDS)}")
    return state_verb(asked)


def state_verb(command: str) -> Wish:
    """Return the verb of a state_command: to "home", an arm that is home stays where it is."""
    return command, {"anew": False} if command == "home" else {}


def _joint_verb(verb: str, values: str, argument: str) -> Reader:
    def read(message: Message, arm: ArmDescription) -> Wish:
        return verb, {argument: joints(message, values, _own(arm))}

    return read


def _servo_jp(message: Message, arm: ArmDescription) -> Wish:
    names = _own(arm)
    q = joints(message, "position", names)
    v = joints_or_none(message, "velocity", names)
    return "servo_jp", {"q": q} if v is None else {"q": q, "v": v}


def _jaw_verb(verb: str, values: str, argument: str) -> Reader:
    def read(message: Message, arm: ArmDescription) -> Wish:
        if not arm.has_jaw:
            raise RefusedError("jaw", f"{arm.tool or 'the bare arm'} has no jaw")
        return f"jaw.{verb}", {argument: joints(message, values, ("jaw",))}

    return read


def _pose_verb(verb: str) -> Reader:
    def read(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
        return verb, {"T": pose(message, "pose")}

    return read


def _wrench_verb(frame: str) -> Reader:
    def read(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
        return "servo_cf", {"wrench": wrench(message, "wrench"), "frame": frame}

    return read


def _servo_cs(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
    """Follow the pose, or exert the wrench; the velocity is not needed, a servo has its own."""
    valid = {what: flag(message, f"{what}_is_valid.data") for what in ("pose", "twist", "wrench")}
    if valid["pose"] == valid["wrench"]:
        raise RefusedError(
            "valid",
            "got a CartesianState with "
            + ("a pose and a wrench" if valid["pose"] else "neither pose nor wrench")
            + " valid; allowed: one of them",
        )
    if valid["pose"]:
        return "servo_cp", {"T": pose(message, "pose")}
    return "servo_cf", {"wrench": wrench(message, "wrench"), "frame": "body"}


def _servo_ci(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
    sides = ("position_positive", "position_negative")
    turns = ("orientation_positive", "orientation_negative")
    impedance = CartesianImpedance(
        point(message, "force_position"),
        rotation(message, "force_orientation"),
        rotation(message, "torque_orientation"),
        **{side: _gains(message, side) for side in (*sides, *turns)},
    )
    return "servo_ci", {"impedance": impedance}


def _gains(message: Message, side: str) -> HalfPlaneGains:
    values = {name: point(message, f"{side}.{name}") for name in ("p", "d", "bias", "deadband")}
    if (values["deadband"] < 0.0).any():
        raise RefusedError("gains", f"got {side}.deadband below 0; allowed: 0 or more")
    return HalfPlaneGains(**values)


def _plain(verb: str) -> Reader:
    return lambda message, arm: (verb, {})  # noqa: ARG005


def _switch(verb: str, argument: str = "on") -> Reader:
    return lambda message, arm: (verb, {argument: flag(message, "data")})  # noqa: ARG005


def _ratio(of: str) -> Reader:
    def read(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
        ratio = number(message, "data")
        if not RATIO_MIN <= ratio <= 1.0:
            raise RefusedError("ratio", f"got a ratio of {ratio:g}; allowed: {RATIO_MIN:g} to 1")
        return "set_trajectory_ratio", {"ratio": ratio, "of": of}

    return read


def _base_frame(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
    return "set_base_frame", {
        "T": pose(message, "pose"),
        "frame_id": text(message, "header.frame_id"),
    }


def _lock(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
    return "lock_orientation", {"R": rotation(message, "")}


def _gripper(message: Message, arm: ArmDescription) -> Wish:
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


def _tool(message: Message, arm: ArmDescription) -> Wish:
    """Mount one of the built-in tools; a message names no file."""
    name = text(message, "data")
    if name in BARE:
        return "set_tool_type", {"name": "none"}
    known = fitting_tools(arm)
    for tool in (name, name.partition("[")[0]):
        if tool in known:
            return "set_tool_type", {"name": tool}
    raise RefusedError("tool", f"got {name!r}; allowed: {', '.join(known)}, or none")


def _endoscope(message: Message, arm: ArmDescription) -> Wish:  # noqa: ARG001
    name = text(message, "data")
    if name not in ENDOSCOPES:
        raise RefusedError("endoscope", f"got {name!r}; allowed: {', '.join(ENDOSCOPES)}")
    return "set_endoscope_type", {"name": name}


READERS: Mapping[str, Reader] = {
    "state_command": _state,
    "servo_jp": _servo_jp,
    "servo_jr": _joint_verb("servo_jr", "position", "dq"),
    "servo_jf": _joint_verb("servo_jf", "effort", "effort"),
    "move_jp": _joint_verb("move_jp", "position", "q"),
    "move_jr": _joint_verb("move_jr", "position", "dq"),
    "servo_cp": _pose_verb("servo_cp"),
    "servo_cr": _pose_verb("servo_cr"),
    "move_cp": _pose_verb("move_cp"),
    "servo_cs": _servo_cs,
    "body/servo_cf": _wrench_verb("body"),
    "spatial/servo_cf": _wrench_verb("spatial"),
    "servo_ci": _servo_ci,
    "hold": _plain("hold"),
    "free": _plain("free"),
    "use_gravity_compensation": _switch("use_gravity_compensation"),
    "body/set_cf_orientation_absolute": _switch("set_cf_orientation_absolute"),
    "trajectory_j/set_ratio": _ratio("both"),
    "trajectory_j/set_ratio_v": _ratio("velocity"),
    "trajectory_j/set_ratio_a": _ratio("acceleration"),
    "set_base_frame": _base_frame,
    "jaw/servo_jp": _jaw_verb("servo_jp", "position", "q"),
    "jaw/move_jp": _jaw_verb("move_jp", "position", "q"),
    "jaw/servo_jf": _jaw_verb("servo_jf", "effort", "effort"),
    "gripper/servo_jp": _gripper,
    "set_tool_type": _tool,
    "emulate_adapter_present": _switch("emulate_adapter_present"),
    "emulate_tool_present": _switch("emulate_tool_present"),
    "set_endoscope_type": _endoscope,
    "lock_orientation": _lock,
    "unlock_orientation": _plain("unlock_orientation"),
    "lock_brakes": _switch("lock_brakes", "locked"),
}
