"""What happens to arms, from the world's journal to the topics that tell of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from trocar.interfaces.crtk import say
from trocar.simulation.journal import Entry
from trocar.simulation.records import ArmSample

#: What a state that was asked for is called. Source: SAW, SetDesiredState of
#: mtsIntuitiveResearchKitArm.
DESIRED = {
    "enable": "ENABLED",
    "disable": "DISABLED",
    "home": "ENABLED",
    "pause": "PAUSED",
    "resume": "ENABLED",
}
#: Events that are told as they are, by the topic and the value that is its data.
PLAIN = {
    "goal_reached": "reached",
    "error": "text",
    "warning": "text",
    "status": "text",
}
#: Verbs that clients wait for the end of.
MOVES = {"move_jp", "move_jr", "move_cp", "move_to", "jaw.move_jp", "jaw.move_jr", "home"}
MOVES |= {"jaw.open", "jaw.close"}


def is_move(entry: Entry) -> bool:
    """Tell whether an entry is a command that clients wait for the end of."""
    if entry.kind != "command":
        return False
    return entry.name in MOVES or desired_state(entry) is not None


def desired_state(entry: Entry) -> str | None:
    """Return the operating state that a command asks for, None when it asks for none."""
    if entry.kind != "command":
        return None
    verb = entry.values.get("name") if entry.name == "state_command" else entry.name
    return DESIRED.get(str(verb))


def told(entry: Entry) -> tuple[str, Mapping[str, Any]] | None:
    """Return the topic without its arm and the message without its header, or None."""
    if entry.kind != "event":
        return None
    if entry.name == "operating_state":
        return "operating_state", dict(entry.values)
    if entry.name == "gripper/pinch":
        return "gripper/pinch", {}
    if entry.name in PLAIN:
        return entry.name, {"data": entry.values[PLAIN[entry.name]]}
    return None


def state_of(arm: ArmSample) -> dict[str, Any]:
    """Return a crtk_msgs/OperatingState without its header."""
    return {"state": arm.state, "is_homed": arm.homed, "is_busy": arm.busy}


def _button(on: bool) -> dict[str, Any]:
    return say.joy(int(on))


#: Latched topics that follow from what an arm is: {topic: (which value, its message)}.
STANDING: dict[str, tuple[Callable[[ArmSample], Any], Callable[[Any], dict[str, Any]]]] = {
    "tool_type": (lambda a: a.tool, lambda v: {"data": v}),
    "trajectory_j/ratio": (lambda a: min(a.ratios), lambda v: {"data": v}),
    "trajectory_j/ratio_v": (lambda a: a.ratios[0], lambda v: {"data": v}),
    "trajectory_j/ratio_a": (lambda a: a.ratios[1], lambda v: {"data": v}),
    "gripper/closed": (lambda a: a.closed, lambda v: {"data": v}),
    "orientation_locked": (lambda a: a.orientation_locked, lambda v: {"data": v}),
    "brakes_locked": (lambda a: a.brakes_locked, lambda v: {"data": v}),
    "IO/tool": (lambda a: bool(a.tool), _button),
}

#: What latched topics tell until something happens: {topic: its message}.
FIRST: dict[str, Callable[[ArmSample], dict[str, Any]]] = {
    "desired_state": lambda a: {"data": a.state},
    "endoscope_type": lambda a: {"data": ""},  # noqa: ARG005  nobody has said yet
    "arm_clutch": lambda a: _button(False),  # noqa: ARG005  nobody presses it
    "IO/arm_clutch": lambda a: _button(False),  # noqa: ARG005
    "IO/SUJ_clutch": lambda a: _button(False),  # noqa: ARG005
}


def standing_of(arm: ArmSample) -> tuple[object, ...]:
    """Return what the messages of `STANDING` follow from; compared from sample to sample."""
    return arm.tool, arm.ratios, arm.closed, arm.orientation_locked, arm.brakes_locked
