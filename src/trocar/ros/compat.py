"""Topics of older simulators, served beside the dVRK's own with `--compat`: one table of aliases.

dvrk_env, WPI's Gazebo simulation: three commands for every motor, one state. Its joint names are
scoped by model, "dvrk/psm1/yaw_joint"; its zeros and signs are the dVRK's. Its gains lie on the
parameter server, from which `trocar sim --ros1` reads them.
Source: WPI-AIM/dvrk_env@07023a1 dvrk_plugins/src/dvrk_gazebo_control_plugin.cpp.

dvrk_vrep, UNINA's V-REP scene, with the dVRK's names before version 2.0. There joints jump to their
set-points; here the servos follow them. The jaw is in radians of the dVRK's jaw, where the scene
multiplies by 0.4106 and, for PSM2, once more.
Source: unina-icaros/dvrk-vrep@8d589b6, the scripts inside V-REP_scenes/dVRK.ttt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.errors import InputError, UnknownNameError
from trocar.live.inbox import Command
from trocar.ros import build
from trocar.ros.clock import Stamp
from trocar.ros.images import Origin, endoscope_eyes, rows_at
from trocar.ros.sample import Figures
from trocar.ros.topic import Make, Message, Read, Topic

if TYPE_CHECKING:
    from trocar.simulation import World

Post = Callable[[Command], object]
FLOAT, STRING, JOINTS = "std_msgs/Float64", "std_msgs/String", "sensor_msgs/JointState"


def compatible(
    rig: RigDescription, names: Sequence[str], post: Post
) -> tuple[dict[str, Topic], tuple[tuple[Topic, Origin], ...]]:
    """Return the rows of older interfaces for a rig by name, and those of its cameras.

    Args:
        rig: the rig
        names: of the interfaces
        post: takes commands that follow from others

    Raises:
        UnknownNameError: no such interface
    """
    topics: dict[str, Topic] = {}
    cameras: list[tuple[Topic, Origin]] = []
    for name in names:
        if name not in TABLES:
            raise UnknownNameError("compat", name, TABLES)
        rows, prefix = TABLES[name]
        for camera, eye in endoscope_eyes(rig):
            cameras += rows_at(f"{prefix}/{eye}", camera, eye, ("image", "info"))
        topics |= {topic.name: topic for topic in rows(rig, post)}
    return topics, tuple(cameras)


def _pub(name: str, arm: str, text: str, make: Make, kind: str = JOINTS) -> Topic:
    key, unit = name.rpartition("/")[2], "rad or m" if kind == JOINTS else ""
    return Topic(name, kind, "pub", "state", unit=unit, help=text, arm=arm, key=key, make=make)


def _sub(name: str, arm: str, text: str, read: Read, kind: str = JOINTS) -> Topic:
    key, unit = name.rpartition("/")[2], "" if kind == STRING else "rad or m"
    unit = "N m or N" if key == "SetEffort" else unit
    depth = 64 if kind == STRING else 1
    return Topic(name, kind, "sub", depth=depth, unit=unit, help=text, arm=arm, key=key, read=read)


class CompatJoint(NamedTuple):
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


JOINTS_OF = {
    "PSM": (
        CompatJoint("yaw_joint", "yaw"),
        CompatJoint("pitch_back_joint", "pitch", looped=True),
        CompatJoint("pitch_bottom_joint", "pitch", -1.0, driven=False),
        CompatJoint("pitch_end_joint", "pitch", driven=False),
        CompatJoint("main_insertion_joint", "insertion"),
        CompatJoint("tool_roll_joint", "roll"),
        CompatJoint("tool_pitch_joint", "wrist_pitch"),
        CompatJoint("tool_yaw_joint", "wrist_yaw"),
        CompatJoint("tool_gripper1_joint", "jaw", 0.5),
        CompatJoint("tool_gripper2_joint", "jaw", 0.5),
        CompatJoint("pitch_top_joint", "pitch", -1.0, driven=False),
        CompatJoint("pitch_front_joint", "pitch", driven=False),
    ),
    "ECM": (
        CompatJoint("yaw_joint", "yaw"),
        CompatJoint("pitch_front_joint", "pitch", looped=True),
        CompatJoint("main_insertion_joint", "insertion"),
        CompatJoint("tool_joint", "roll"),
    ),
}
VERBS = {
    "SetPosition": "set without dynamics",
    "SetPositionTarget": "servo to",
    "SetEffort": "exert for one tick",
}


def joints_of(arm: ArmDescription) -> tuple[CompatJoint, ...]:
    """Return the joints that dvrk_env has of an arm, those that this arm has too."""
    names = arm.mechanism.joint_names
    return tuple(joint for joint in JOINTS_OF.get(arm.type, ()) if joint.own in names)


def _env_rows(rig: RigDescription, post: Post) -> Iterator[Topic]:
    for arm in rig.arms:
        for joint in joints_of(arm.arm):
            for verb, text in VERBS.items() if joint.driven else ():
                name = f"dvrk/{arm.name.lower()}/{joint.name}/{verb}"
                yield _sub(name, arm.name, text, _joint_read(arm.name, joint, verb, post), FLOAT)
    text = "every joint of every arm"
    yield Topic("dvrk/joint/states", JOINTS, "pub", "state", help=text, make=_joint_states)


def _joint_states(rig: Figures, stamp: Stamp) -> Message:
    """Return positions, velocities and efforts of every joint, a passive one's effort 0."""
    names: list[str] = []
    values: list[tuple[float, float, float]] = []
    for rig_arm in rig.sample.rig.arms:
        figures = rig.arm(rig_arm.name)
        for joint in joints_of(rig_arm.arm):
            k, s = list(figures.names).index(joint.own), figures.sample
            effort = float(s.effort[k]) if joint.driven else 0.0
            names.append(f"dvrk/{rig_arm.name.lower()}/{joint.name}")
            values.append((joint.ratio * float(s.q[k]), joint.ratio * float(s.qd[k]), effort))
    q, v, effort = np.array(values, dtype=np.float64).reshape(-1, 3).T
    return build.joints(stamp, names, q, v, effort)


def _joint_read(arm: str, joint: CompatJoint, verb: str, post: Post) -> Read:
    def read(message: Mapping[str, Any], _: object) -> Command:
        value = float(message.get("data", np.nan))
        if not np.isfinite(value):
            raise InputError(f"got {value}; allowed: a finite number")
        if verb == "SetPosition" and joint.looped:
            raise InputError(
                f"{joint.name} is part of a closed loop; allowed: SetPositionTarget, SetEffort"
            )
        if joint.own == "jaw":
            if verb == "SetEffort":
                return Command(arm, "jaw.servo_jf", {"effort": [value]})
            return Command(arm, "jaw.servo_jp", {"q": [value / joint.ratio]})
        if verb == "SetEffort":
            return _joint_effort(arm, joint.own, value, post)
        return _joint_command(arm, joint.own, value, "set" if verb == "SetPosition" else "position")

    return read


def _joint_command(
    arm: str, joint: str, value: float, mode: Literal["position", "set", "effort"]
) -> Command:
    """Servo one joint, pin it ("set"), or exert an effort on it; the others stay as they are."""

    def act(world: World) -> None:
        moved = world.arm(arm)
        if moved.joints.mode(joint) != mode:
            moved.joints.set_mode(mode, [joint])
        setpoint = moved.setpoint_js()
        goal = np.array(setpoint.effort if mode == "effort" else setpoint.position)
        goal[setpoint.name.index(joint)] = value
        (moved.servo_jf if mode == "effort" else moved.servo_jp)(goal)

    verb = "servo_jf" if mode == "effort" else "servo_jp"
    return Command(arm, verb, stream=joint, act=act)


def _joint_effort(arm: str, joint: str, effort: float, post: Post) -> Command:
    """Exert an effort on one joint for one tick [N m or N]."""
    exert, release = (_joint_command(arm, joint, value, "effort") for value in (effort, 0.0))

    def end(world: World) -> None:
        if world.arm(arm).joints.mode(joint) == "effort":  # not taken back by a position meanwhile
            release.apply(world)

    def act(world: World) -> None:
        exert.apply(world)
        post(Command(arm, "servo_jf", stream=joint, act=end))

    return Command(arm, "servo_jf", stream=joint, act=act)


#: Setup joints of the scene: the right arm's, the left arm's, the endoscope's, five names each.
SIDES = (("R", "SUJ_PSM1"), ("L", "SUJ_PSM2"), ("C", "SUJ_ECM"))
SETUP_NAMES = ("Prismatic_joint", *(f"Revolute_joint{k}" for k in range(1, 5)))
#: The topic of an arm's state has another name for each.
STATE_OF = {"PSM1": "current_state", "PSM2": "robot_state"}


def _vrep_rows(rig: RigDescription, post: Post) -> Iterator[Topic]:  # noqa: ARG001  as _env_rows
    names = {arm.name: arm.arm for arm in rig.arms}
    for arm, description in names.items():
        if description.type not in ("PSM", "ECM"):
            continue
        joints, before = description.mechanism.joint_names, f"dvrk/{arm}"
        servo = _servo(arm, "servo_jp", len(joints) - ("jaw" in joints))
        yield _pub(f"{before}/state_joint_current", arm, "positions, velocities", _arm_state(arm))
        yield _sub(f"{before}/state_joint_desired", arm, "servo the joints", servo)
        if "jaw" in joints:
            servo = _servo(arm, "jaw.servo_jp", 1)
            yield _pub(f"{before}/state_jaw_current", arm, "the jaw", _arm_state(arm, jaw=True))
            yield _sub(f"{before}/state_jaw_desired", arm, "servo the jaw", servo)
        if arm in STATE_OF:
            text = "READY or uninitialized"
            yield _pub(f"{before}/{STATE_OF[arm]}", arm, text, _ready(arm), STRING)
            text = "Home enables the arm and brings it home"
            yield _sub(f"{before}/set_robot_state", arm, text, _set_state(arm), STRING)
    if all(arm in names for _, arm in SIDES):
        text = "the setup joints, left at 0 where the arm has no such joint"
        yield _pub("dvrk/setup_joint/state_joint_current", "", text, _setup)


def _arm_state(name: str, *, jaw: bool = False) -> Make:
    def make(rig: Figures, stamp: Stamp) -> Message:
        arm = rig.arm(name)
        which = slice(-1, None) if jaw else arm.own
        return build.joints(stamp, (), arm.sample.q[which], arm.sample.qd[which], np.zeros(0))

    return make


def _ready(name: str) -> Make:
    def make(rig: Figures, stamp: Stamp) -> Message:  # noqa: ARG001  as every maker
        arm = rig.arm(name).sample.status
        return {"data": "READY" if arm.state == "ENABLED" and arm.homed else "uninitialized"}

    return make


def _setup(rig: Figures, stamp: Stamp) -> Message:
    names: list[str] = []
    q: list[float] = []
    for side, arm in SIDES:
        names += [f"{side}_{joint}" for joint in SETUP_NAMES]
        found = rig.arm(arm).sample.q[: len(SETUP_NAMES)].tolist()
        q += found + [0.0] * (len(SETUP_NAMES) - len(found))
    return build.joints(stamp, names, np.array(q), np.zeros(0), np.zeros(0))


def _servo(arm: str, verb: str, count: int) -> Read:
    def read(message: Mapping[str, Any], _: object) -> Command:
        position = np.asarray(message.get("position", ()), dtype=np.float64)
        if position.shape != (count,) or not np.isfinite(position).all():
            raise InputError(f"position: got {position.tolist()}; allowed: {count} finite numbers")
        return Command(arm, verb, {"q": tuple(position.tolist())})

    return read


def _set_state(arm: str) -> Read:
    def read(message: Mapping[str, Any], _: object) -> list[Command]:
        wanted = str(message.get("data", ""))
        if wanted != "Home":
            raise InputError(f"got {wanted!r}; allowed: Home")
        return [Command(arm, "state_command", {"name": name}) for name in ("enable", "home")]

    return read


#: {interface: (its rows, prefix of the endoscope's topics)}. The `camera_info` of both
#: differs from ours: dvrk_env's eyes have another baseline (dvrk_description ecm.sdf), and the
#: scene's `P` lacks it.
TABLES = {
    "dvrk_env": (_env_rows, "dvrk/ecm/camera"),
    "dvrk_vrep": (_vrep_rows, "stereo"),
}
