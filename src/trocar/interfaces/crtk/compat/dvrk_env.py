"""The topics of WPI's Gazebo simulation dvrk_env: three commands for every motor, one state.

Source: WPI-AIM/dvrk_env@07023a1 dvrk_plugins/src/dvrk_gazebo_control_plugin.cpp. Its joint names
are scoped by model, "dvrk/psm1/yaw_joint"; its zeros and signs are the dVRK's. The gains lie on
the parameter server there; `trocar sim --ros1` reads them from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.errors import InputError
from trocar.interfaces.commands import JawServo, JawServoJf
from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.compat.joint_commands import JointEffort, JointPosition
from trocar.interfaces.crtk.image_rows import Origin, endoscope_eyes, rows_at
from trocar.interfaces.crtk.sample import RigFigures
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Message
from trocar.simulation.readout import ArmReadout

if TYPE_CHECKING:
    from trocar.interfaces.commands import Command
    from trocar.interfaces.crtk.core import Core

Rows = Iterator[tuple[Topic, Callable[..., Any]]]
STATES = "dvrk/joint/states"
FLOAT, JOINTS = "std_msgs/Float64", "sensor_msgs/JointState"


@dataclass(frozen=True)
class Joint:
    """A joint of dvrk_env.

    Attributes:
        name: as there, without its model
        own: the joint here that moves it, "jaw" for a finger
        ratio: how far it moves when that one moves by 1
        driven: whether it takes commands
        looped: whether it lies in a closed loop, where positions are not set but servoed to
    """

    name: str
    own: str
    ratio: float = 1.0
    driven: bool = True
    looped: bool = False


PSM = (
    Joint("yaw_joint", "yaw"),
    Joint("pitch_back_joint", "pitch", looped=True),
    Joint("pitch_bottom_joint", "pitch", -1.0, driven=False),
    Joint("pitch_end_joint", "pitch", driven=False),
    Joint("main_insertion_joint", "insertion"),
    Joint("tool_roll_joint", "roll"),
    Joint("tool_pitch_joint", "wrist_pitch"),
    Joint("tool_yaw_joint", "wrist_yaw"),
    Joint("tool_gripper1_joint", "jaw", 0.5),
    Joint("tool_gripper2_joint", "jaw", 0.5),
    Joint("pitch_top_joint", "pitch", -1.0, driven=False),
    Joint("pitch_front_joint", "pitch", driven=False),
)
ECM = (
    Joint("yaw_joint", "yaw"),
    Joint("pitch_front_joint", "pitch", looped=True),
    Joint("main_insertion_joint", "insertion"),
    Joint("tool_joint", "roll"),
)
JOINTS_OF = {"PSM": PSM, "ECM": ECM}
VERBS = {
    "SetPosition": "set without dynamics",
    "SetPositionTarget": "servo to",
    "SetEffort": "exert for one tick",
}


def rows(rig: RigDescription) -> Rows:
    """Return every topic, with what makes its message or does what it asks for."""
    for arm in rig.arms:
        for joint in joints_of(arm.arm):
            if joint.driven:
                for verb, text in VERBS.items():
                    name = f"dvrk/{arm.name.lower()}/{joint.name}/{verb}"
                    unit = "N m or N" if verb == "SetEffort" else "rad or m"
                    yield (
                        Topic(name, FLOAT, "sub", depth=1, unit=unit, help=text, arm=arm.name,
                              key=f"{joint.name}/{verb}"),
                        _handler(joint, verb),
                    )  # fmt: skip
    yield Topic(STATES, JOINTS, "pub", "state", help="every joint of every arm", key=STATES), states


def cameras(rig: RigDescription) -> Iterator[tuple[Topic, Origin]]:
    """Return the topics of the endoscope; there `camera_info` has another baseline than the eyes.

    Source: dvrk_description ecm.sdf, the sensor "camera".
    """
    for camera, eye in endoscope_eyes(rig):
        yield from rows_at(f"dvrk/ecm/camera/{eye}", camera, eye, ("image", "info"))


def joints_of(arm: ArmDescription) -> tuple[Joint, ...]:
    """Return the joints that dvrk_env has of an arm, those that this arm has too."""
    names = arm.mechanism.joint_names
    return tuple(joint for joint in JOINTS_OF.get(arm.type, ()) if joint.own in names)


def states(rig: RigFigures, stamp: Stamp) -> Message:
    """Return positions, velocities and efforts of every joint, a passive one's effort 0."""
    names: list[str] = []
    values: list[tuple[float, float, float]] = []
    for rig_arm in rig.sample.rig.arms:
        figures = rig.arm(rig_arm.name)
        for joint in joints_of(rig_arm.arm):
            names.append(f"dvrk/{rig_arm.name.lower()}/{joint.name}")
            values.append(_state(figures, joint))
    q, v, effort = np.array(values, dtype=np.float64).reshape(-1, 3).T
    return say.joints(stamp, names, q, v, effort)


def _state(arm: ArmReadout, joint: Joint) -> tuple[float, float, float]:
    k, s = list(arm.names).index(joint.own), arm.sample
    effort = float(s.effort[k]) if joint.driven else 0.0
    return joint.ratio * float(s.q[k]), joint.ratio * float(s.qd[k]), effort


def _handler(joint: Joint, verb: str) -> Callable[[Core, Topic, Mapping[str, Any]], None]:
    def handle(core: Core, topic: Topic, message: Mapping[str, Any]) -> None:
        value = float(message.get("data", np.nan))
        if not np.isfinite(value):
            raise InputError(f"got {value}; allowed: a finite number")
        if verb == "SetPosition" and joint.looped:
            raise InputError(
                f"{joint.name} lies in a closed loop; allowed: SetPositionTarget, SetEffort"
            )
        if not core.loop.post(_command(core, topic.arm, joint, verb, value)):
            raise InputError("too many commands wait already")

    return handle


def _command(core: Core, arm: str, joint: Joint, verb: str, value: float) -> Command:
    if joint.own == "jaw":
        if verb == "SetEffort":
            return JawServoJf(arm, value)
        return JawServo(arm, value / joint.ratio)
    if verb == "SetEffort":
        return JointEffort(arm, joint.own, value, core.loop.post)
    return JointPosition(arm, joint.own, value, "set" if verb == "SetPosition" else "position")
