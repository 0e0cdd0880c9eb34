"""The topics of UNINA's V-REP scene dvrk-vrep, named as the dVRK's of versions before 2.0.

Source: unina-icaros/dvrk-vrep@8d589b6, the scripts inside V-REP_scenes/dVRK.ttt. There joints jump
to what they are told; here the servos follow it. The jaw is in radians of the dVRK's jaw, where
the scene multiplies by 0.4106 and, for PSM2, once more. Images come from the endoscope.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.interfaces.commands import Command, JawServo, ServoJp, Verb
from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.image_rows import Origin, endoscope_eyes, rows_at
from trocar.interfaces.crtk.sample import RigFigures
from trocar.interfaces.crtk.topics import Topic
from trocar.interfaces.crtk.transport import Message

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core

Rows = Iterator[tuple[Topic, Callable[..., Any]]]
Make = Callable[[RigFigures, Stamp], Message]
JOINTS, STRING = "sensor_msgs/JointState", "std_msgs/String"
SETUP = "dvrk/setup_joint/state_joint_current"
#: Setup joints of the scene: the right arm's, the left arm's, the endoscope's, five names each.
SIDES = (("R", "SUJ_PSM1"), ("L", "SUJ_PSM2"), ("C", "SUJ_ECM"))
SETUP_NAMES = ("Prismatic_joint", *(f"Revolute_joint{k}" for k in range(1, 5)))
#: What tells the state is called otherwise for one arm.
STATE_OF = {"PSM1": "current_state", "PSM2": "robot_state"}


def rows(rig: RigDescription) -> Rows:
    """Return every topic, with what makes its message or does what it asks for."""
    names = {arm.name: arm.arm for arm in rig.arms}
    for arm, description in names.items():
        if description.type not in ("PSM", "ECM"):
            continue
        before = f"dvrk/{arm}"
        yield _pub(f"{before}/state_joint_current", arm, "positions, velocities"), _joints(arm)
        count = len([j for j in description.mechanism.joint_names if j != "jaw"])
        yield _sub(f"{before}/state_joint_desired", arm, "servo the joints"), _servo(count)
        if "jaw" in description.mechanism.joint_names:
            yield _pub(f"{before}/state_jaw_current", arm, "the jaw"), _jaw(arm)
            yield _sub(f"{before}/state_jaw_desired", arm, "servo the jaw"), _servo_jaw
        if arm in STATE_OF:
            yield (
                Topic(f"{before}/{STATE_OF[arm]}", STRING, "pub", "state", unit="",
                      help="READY or uninitialized", arm=arm, key=STATE_OF[arm]),
                _state(arm),
            )  # fmt: skip
            yield (
                Topic(f"{before}/set_robot_state", STRING, "sub", unit="",
                      help="Home enables the arm and brings it home", arm=arm,
                      key="set_robot_state"),
                _set_state,
            )  # fmt: skip
    if all(arm in names for _, arm in SIDES):
        yield _pub(SETUP, "", "the setup joints, left at 0 where the arm has no such joint"), _setup


def cameras(rig: RigDescription) -> Iterator[tuple[Topic, Origin]]:
    """Return the topics of the endoscope; the scene's `P` lacks the baseline, which is here."""
    for camera, eye in endoscope_eyes(rig):
        yield from rows_at(f"stereo/{eye}", camera, eye, ("image", "info"))


def _pub(name: str, arm: str, text: str) -> Topic:
    key = name.rpartition("/")[2]
    return Topic(name, JOINTS, "pub", "state", unit="rad or m", help=text, arm=arm, key=key)


def _sub(name: str, arm: str, text: str) -> Topic:
    key = name.rpartition("/")[2]
    return Topic(name, JOINTS, "sub", depth=1, unit="rad or m", help=text, arm=arm, key=key)


def _joints(name: str) -> Make:
    def make(rig: RigFigures, stamp: Stamp) -> Message:
        arm = rig.arm(name)
        s, own = arm.sample, arm.own
        return say.joints(stamp, (), s.q[own], s.qd[own], np.zeros(0))

    return make


def _jaw(name: str) -> Make:
    def make(rig: RigFigures, stamp: Stamp) -> Message:
        s = rig.arm(name).sample
        return say.joints(stamp, (), s.q[-1:], s.qd[-1:], np.zeros(0))

    return make


def _state(name: str) -> Make:
    def make(rig: RigFigures, stamp: Stamp) -> Message:  # noqa: ARG001  as every maker
        arm = rig.arm(name).sample
        ready = arm.state == "ENABLED" and arm.homed
        return {"data": "READY" if ready else "uninitialized"}

    return make


def _setup(rig: RigFigures, stamp: Stamp) -> Message:
    names: list[str] = []
    q: list[float] = []
    for side, arm in SIDES:
        names += [f"{side}_{joint}" for joint in SETUP_NAMES]
        found = rig.arm(arm).sample.q[: len(SETUP_NAMES)].tolist()
        q += found + [0.0] * (len(SETUP_NAMES) - len(found))
    return say.joints(stamp, names, np.array(q), np.zeros(0), np.zeros(0))


def _servo(count: int) -> Callable[[Core, Topic, Mapping[str, Any]], None]:
    def handle(core: Core, topic: Topic, message: Mapping[str, Any]) -> None:
        _post(core, ServoJp(topic.arm, _finite(message, count)))

    return handle


def _servo_jaw(core: Core, topic: Topic, message: Mapping[str, Any]) -> None:
    (position,) = _finite(message, 1)
    _post(core, JawServo(topic.arm, position))


def _set_state(core: Core, topic: Topic, message: Mapping[str, Any]) -> None:
    wanted = str(message.get("data", ""))
    if wanted != "Home":
        raise InputError(f"got {wanted!r}; allowed: Home")
    for command in ("enable", "home"):
        _post(core, Verb(topic.arm, "state_command", {"name": command}))


def _finite(message: Mapping[str, Any], count: int) -> tuple[float, ...]:
    position = np.asarray(message.get("position", ()), dtype=np.float64)
    if position.shape != (count,) or not np.isfinite(position).all():
        raise InputError(f"position: got {position.tolist()}; allowed: {count} finite numbers")
    return tuple(position.tolist())


def _post(core: Core, command: Command) -> None:
    if not core.loop.post(command):
        raise InputError("too many commands wait already")
