"""The topics of a master that is no arm of the rig: what it tells, and what it is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from trocar.apps.teleoperation.engine import Ask
from trocar.apps.teleoperation.remote_master import RemoteMaster
from trocar.interfaces.crtk import Component, Core, Topic, say
from trocar.interfaces.crtk.arm_rows import (
    BOOL,
    COMMAND,
    EMPTY,
    JOINTS,
    PLACE,
    POSE,
    STATE,
    WRENCH,
)
from trocar.interfaces.crtk.component import served
from trocar.interfaces.crtk.fields import Message, flag, joints, text
from trocar.interfaces.crtk.places import pose
from trocar.interfaces.crtk.topics import topics_from

#: Where a master's poses are told. Source: as of a rig's masters.
DISPLAY = "HRSV"
ZERO = {"x": 0.0, "y": 0.0, "z": 0.0}

ROWS = (
    ("sub 1", "measured_cp", POSE, PLACE, "where the master is, told by itself"),
    ("sub 1", "gripper/measured_js", JOINTS, "rad", "its gripper, told by itself"),
    ("sub", "operating_state", STATE, "", "told by itself"),
    ("pub", "state_command", COMMAND, "", "what it is asked to do"),
    ("pub", "move_cp", POSE, PLACE, "where it is asked to turn"),
    ("pub", "body/servo_cf", WRENCH, "N, N m", "what it is asked to exert: nothing"),
    ("pub", "lock_orientation", "geometry_msgs/Quaternion", "xyzw", "what its gimbal is to hold"),
    ("pub", "unlock_orientation", EMPTY, "", "its gimbal is to be free"),
    ("pub", "use_gravity_compensation", BOOL, "", "switches its gravity compensation"),
    ("pub", "hold", EMPTY, "", "it is asked to stay"),
)


def component_of(master: RemoteMaster) -> Component:
    """Return what a core serves of a master that is somewhere else."""
    rows = tuple((m, f"{master.name}/{key}", kind, u, t) for m, key, kind, u, t in ROWS)
    cores: list[Core] = []

    def begin(core: Core) -> Callable[[], None]:
        cores.append(core)
        master.publish = partial(_publish, core, master.name)
        return lambda: None

    def take(read: Callable[[Message], Callable[[], None]], topic: Topic, message: Message) -> None:
        act = read(message)
        if cores:
            cores[-1].incoming.post(Ask(act, (master.name, topic.name)))

    readers: dict[str, Callable[[Message], Callable[[], None]]] = {
        "measured_cp": partial(_pose, master),
        "gripper/measured_js": partial(_gripper, master),
        "operating_state": partial(_state, master),
    }
    handlers = {f"{master.name}/{key}": partial(take, read) for key, read in readers.items()}
    return Component(served(topics_from(rows)), handlers, begin)


def _pose(master: RemoteMaster, message: Message) -> Callable[[], None]:
    return partial(master.hear_pose, pose(message, "pose"))


def _gripper(master: RemoteMaster, message: Message) -> Callable[[], None]:
    return partial(master.hear_gripper, float(joints(message, "position", ("gripper",))[0]))


def _state(master: RemoteMaster, message: Message) -> Callable[[], None]:
    return partial(master.hear_state, text(message, "state"), flag(message, "is_homed"))


def _publish(core: Core, name: str, key: str, fields: Mapping[str, Any]) -> None:
    message = dict(fields)
    if key == "move_cp":
        at = say.pose(fields["T"])
        message = {"header": say.header(core.stamper.stamp(), DISPLAY), "pose": at}
    elif key == "lock_orientation":
        message = say.quaternion(fields["T"])
    elif key == "body/servo_cf":
        message = {"wrench": {"force": ZERO, "torque": ZERO}}
    core.emit(f"{name}/{key}", message)
