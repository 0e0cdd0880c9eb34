"""The topics of teleoperation: its components, the console's pedals, keys and gamepads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import DISPLAY
from trocar.live.inbox import Command
from trocar.ros import Component
from trocar.ros import message_builders as build
from trocar.ros.arm_topics import measured_cv
from trocar.ros.console import BUTTONS, teleop_topics
from trocar.ros.message_fields import (
    Message,
    RefusedError,
    button,
    flag,
    number,
    text,
    vector,
    wrench,
)
from trocar.ros.topic import JOY, STRING, Make, Read, command, served
from trocar.teleoperation.component import TeleopComponent
from trocar.teleoperation.devices import DeviceCommand, from_keys, from_pad
from trocar.teleoperation.engine import Teleoperation
from trocar.teleoperation.masters import ArmMaster, Master
from trocar.teleoperation.psm import PsmTeleoperation

if TYPE_CHECKING:
    from trocar.ros import Core
    from trocar.ros.clock import Stamp
    from trocar.ros.sample import SampleReadings

Array = NDArray[np.float64]

#: Published as a button. Source: SAW system_ROS.cpp declares these as Joy.
JOYS = ("rotation_locked", "translation_locked")
#: Names of the left and the right master in topics. Source: SAW mtsTeleOperationECM.cpp, Init.
SIDES = ("MTML", "MTMR")
#: Namespace of the console's own topics.
CONSOLE = "console/teleop"

#: Topics that switch teleoperation off, too. Source: SAW 9e535e6, system.cpp:780.
POWER_OFF = ("system/power_off", "console/power_off")

KEYS, PAD = "teleop/keys", "teleop/gamepad"
#: Sent when the web viewer loses the keyboard to another window.
ASIDE = "aside"

INPUTS = (
    command(
        KEYS, STRING, "", "codes of the held keys, separated by spaces; or `aside`", newest=True
    ),
    command(PAD, JOY, "", "axes and buttons, in the standard layout; none: aside", newest=True),
)


def reading(
    engine: Teleoperation,
    read: Callable[[Message], Any],
    act: Callable[[Any], object],
    stream: str = "",
) -> Read:
    """Return a reader that checks a message at once and acts in the loop's thread.

    Args:
        engine: makes the command
        read: checks a message
        act: called with what was read
        stream: as of `Teleoperation.command`
    """

    def command(message: Message, _: object) -> Command:
        value = read(message)
        return engine.command(lambda: act(value), stream)

    return command


def pedal_component(engine: Teleoperation) -> Component:
    """Return the topics of pedals: those that emulate them also act."""

    def press(name: str, on: bool) -> None:
        engine.pedals.note(name, on)
        engine.pedals.act(name, on)

    reads = {
        f"{place}/emulate_{name}": reading(engine, _read_pressed, partial(press, name))
        for name in engine.pedals.ACTIVE
        for place in ("console", "footpedals")
        if f"{place}/emulate_{name}" in BUTTONS
    }

    def begin(core: Core) -> Callable[[], None]:
        engine.pedals.connect(core.topics, core.emit)
        return lambda: None

    return Component({}, begin, reads)


def component(engine: Teleoperation) -> Component:
    """Return the topics of teleoperation, with its pedals and its ticks."""
    pedals = pedal_component(engine)
    cores: list[Core] = []

    def publish(before: str, key: str, value: object) -> None:
        fields = build.joy(int(bool(value))) if key in JOYS else {"data": value}
        cores[-1].emit(f"{before}/{key}", fields)

    def begin(core: Core) -> Callable[[], None]:
        """Publish how everything stands, and each change from now on."""
        cores.append(core)
        pedals.begin(core)
        for one in engine.components.values():
            one.publish = partial(publish, one.name)
            for key, value in _state(one).items():
                one.publish(key, value)
        console = engine.console
        console.publish = partial(publish, CONSOLE)
        console.publish("enabled", console.enabled)
        console.publish("scale", console.scale)
        for name in engine.components:
            console.publish("selected" if name in console.selected else "unselected", name)
        return engine.start()

    def read_name(message: Message) -> str:
        name = text(message, "data")
        if name not in engine.components:
            raise RefusedError(
                "component", f"got {name!r}; allowed: {', '.join(engine.components)}"
            )
        return name

    console, request = engine.console, partial(reading, engine)
    reads = {
        f"{CONSOLE}/enable": request(_read_flag, console.enable),
        f"{CONSOLE}/select": request(read_name, console.select),
        f"{CONSOLE}/unselect": request(read_name, console.unselect),
        f"{CONSOLE}/set_scale": request(_read_scale, console.set_scale),
    }
    switch_off = request(lambda _: False, console.enable)
    pressed = dict(pedals.reads) | dict.fromkeys(POWER_OFF, switch_off)
    makes: dict[str, Make] = {}
    for name, one in engine.components.items():
        reads[f"{name}/state_command"] = request(partial(_read_command, one), one.command)
        reads[f"{name}/set_scale"] = request(_read_scale, one.set_scale)
        if isinstance(one, PsmTeleoperation):
            reads[f"{name}/lock_rotation"] = request(_read_flag, one.lock_rotation)
            reads[f"{name}/lock_translation"] = request(_read_flag, one.lock_translation)
            reads[f"{name}/set_align_MTM"] = request(_read_flag, one.set_align)
            topic = f"{name}/following/mtm/body/servo_cf"
            reads[topic] = request(partial(_read_wrench, one.masters[0]), one.exert, topic)
            makes[f"{name}/alignment_offset"] = partial(_offset, one)
            makes[f"{name}/MTM/measured_cp"] = partial(_handle, one.masters[0])
            makes[f"{name}/MTM/measured_cv"] = partial(_velocity, one.masters[0])
            makes[f"{name}/PSM/setpoint_cp"] = partial(_commanded, one.description.slave)
        else:
            for side, master in zip(SIDES, one.masters, strict=True):
                makes[f"{name}/{side}/measured_cp"] = partial(_handle, master)
            makes[f"{name}/ECM/measured_cp"] = partial(_commanded, one.description.slave)
    rows = teleop_topics([one.description for one in engine.components.values()])
    return Component(served(rows, reads, makes), begin, pressed)


def input_component(
    engine: Teleoperation, name: str, receive: Callable[[DeviceCommand | None], object]
) -> Component:
    """Return the topics of keys and sticks.

    Args:
        engine: calls in the loop's thread
        name: of the device
        receive: called there with each command, None: the device is put aside
    """
    reads = {
        topic: reading(engine, read, receive, f"{name} {topic}")
        for topic, read in ((KEYS, _read_keys), (PAD, _read_pad))
    }
    return Component(served(INPUTS, reads), lambda _: lambda: None)


def _read_keys(message: Message) -> DeviceCommand | None:
    held = text(message, "data").split()
    return None if held == [ASIDE] else from_keys(held)


def _read_pad(message: Message) -> DeviceCommand | None:
    axes = vector(message, "axes")
    buttons = vector(message, "buttons")
    if not axes.size and not buttons.size:
        return None
    return from_pad(axes.tolist(), buttons.tolist())


def _read_command(one: TeleopComponent, message: Message) -> str:
    word = text(message, "string")
    if word not in one.commands:
        raise RefusedError("state", f"got {word!r}; allowed: {', '.join(one.commands)}")
    return word


def _read_pressed(message: Message) -> bool:
    """Return whether a pedal is down; a quick tap was released again."""
    return button(message) == 1


def _read_flag(message: Message) -> bool:
    return flag(message, "data")


def _read_wrench(master: Master, message: Message) -> Array:
    if not master.exerts:
        raise RefusedError("wrench", f"{master.name} has no motors that could exert it")
    return wrench(message, "wrench")


def _read_scale(message: Message) -> float:
    return number(message, "data")


def _state(one: TeleopComponent) -> Mapping[str, object]:
    """Return the first messages of a component."""
    found: dict[str, object] = {
        "current_state": one.current,
        "desired_state": one.desired,
        "following": one.following,
        "scale": one.scale,
    }
    if isinstance(one, PsmTeleoperation):
        found |= {
            "rotation_locked": one.rotation_locked,
            "translation_locked": one.translation_locked,
            "align_mtm": one.align,
        }
    return found


def _offset(one: PsmTeleoperation, rig: SampleReadings, stamp: Stamp) -> dict[str, Any]:  # noqa: ARG001
    """Return a geometry_msgs/QuaternionStamped of the rotation from handle to tip."""
    T = np.eye(4)
    T[:3, :3] = one.offset
    return {"header": build.header(stamp, one.masters[0].name), "quaternion": build.quaternion(T)}


def _handle(master: Master, rig: SampleReadings, stamp: Stamp) -> dict[str, Any] | None:
    """Return a geometry_msgs/PoseStamped of a master's handle, None before its first message."""
    if isinstance(master, ArmMaster):
        arm = rig.arm(master.name)
        return build.pose_stamped(stamp, arm.base_frame, arm.tip(setpoint=False, local=False))
    T = master.last_pose()
    return None if T is None else build.pose_stamped(stamp, DISPLAY, T)


def _velocity(master: Master, rig: SampleReadings, stamp: Stamp) -> dict[str, Any] | None:
    """Return a geometry_msgs/TwistStamped of a master's handle, None of one that has no arm."""
    if not isinstance(master, ArmMaster):
        return None
    return measured_cv(rig.arm(master.name), stamp)


def _commanded(name: str, rig: SampleReadings, stamp: Stamp) -> dict[str, Any]:
    """Return a geometry_msgs/PoseStamped of a slave's tip at its set-points."""
    arm = rig.arm(name)
    return build.pose_stamped(stamp, arm.base_frame, arm.tip(setpoint=True, local=False))
