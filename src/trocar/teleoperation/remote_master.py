"""A master that is no arm of the rig: a real MTM, or a program, that speaks over its own topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import DISPLAY
from trocar.geometry.rotations import angle_between
from trocar.geometry.se3 import transform
from trocar.ros import Component, Core
from trocar.ros import message_builders as build
from trocar.ros.message_fields import Message, flag, joints, pose, text
from trocar.ros.topic import (
    BOOL,
    COMMAND,
    EMPTY,
    JOINTS,
    PLACE,
    POSE,
    STATE,
    WRENCH,
    command,
    event,
    served,
)
from trocar.teleoperation.engine import Teleoperation
from trocar.teleoperation.masters import Master, MasterLostError, MasterReading
from trocar.teleoperation.topics import component, reading
from trocar.teleoperation.virtual_fixtures import Fixtures

if TYPE_CHECKING:
    from trocar.live.loop import Loop
    from trocar.simulation import World

Array = NDArray[np.float64]

#: A master that reports nothing for this long is lost. Source: our own choice: ten messages of the
#: dVRK's slowest usual rate. [s]
SILENCE_S = 0.1
#: A goal takes at most this long to show in the master's operating state. Source: our own choice:
#: ten messages of the dVRK's slowest usual rate. [s]
BEGUN_S = 0.1

#: Topics that follow the master's name: published by it ("sub"), and commands to it ("pub").
ROWS = (
    command("measured_cp", POSE, PLACE, "pose of the master, published by itself", newest=True),
    command("gripper/measured_js", JOINTS, "rad", "its gripper, published by itself", newest=True),
    command("operating_state", STATE, "", "published by itself"),
    event("state_command", COMMAND, "home"),
    event("move_cp", POSE, "orientation of the tool", PLACE),
    event("body/servo_cf", WRENCH, "wrench of clients and virtual fixtures, else zero", "N, N m"),
    event("lock_orientation", "geometry_msgs/Quaternion", "hold the gimbal", "xyzw"),
    event("unlock_orientation", EMPTY, "free the gimbal"),
    event("use_gravity_compensation", BOOL, "switch gravity compensation"),
    event("hold", EMPTY, "stay"),
)


class RemoteMaster(Master):
    """The last messages of a master, and commands to it.

    Args:
        name: the prefix of its topics: "MTMR"
        now: wall time [s]

    Attributes:
        name: as given
        publish: called with a topic without the name, and the fields of its message
    """

    exerts = True

    def __init__(self, name: str, now: Callable[[], float]) -> None:
        self.name, self._now = name, now
        self._wrench = np.zeros(6)
        self.publish: Callable[[str, Mapping[str, Any]], None] = lambda topic, fields: None  # noqa: ARG005  not connected yet
        self._pose: Array | None = None
        self._gripper: float | None = None
        self._received: float | None = None
        self._state: tuple[str, bool] = ("", False)
        self._busy = False
        self._requested: Array | None = None
        self._sent = -np.inf

    def receive_pose(self, T: Array) -> None:
        """Take its pose in the frame of the stereo display, (4, 4)."""
        self._pose, self._received = T, self._now()

    def receive_gripper(self, opening: float) -> None:
        """Take the opening of its gripper [rad]."""
        self._gripper = opening

    def receive_state(self, state: str, homed: bool, busy: bool) -> None:
        """Take its operating state."""
        self._state, self._busy = (state, homed), busy

    def objection(self, world: World) -> str:  # noqa: ARG002
        """Return the reason that the master cannot be used, "" when it can."""
        if self._pose is None:
            return f"{self.name} publishes nothing"
        state, homed = self._state
        if state and (state != "ENABLED" or not homed):
            return f'{self.name} is not in state "ENABLED" and homed but "{state}"'
        return ""

    def prepare(self, world: World) -> None:
        """Request enable and home, if its reported state is another."""
        self._requested = None
        if self._pose is not None and self.objection(world):
            self.publish("state_command", {"string": "home"})

    def read(self, world: World) -> MasterReading:  # noqa: ARG002
        """Return its last pose and gripper.

        Raises:
            MasterLostError: it has published nothing for a while
        """
        if self._pose is None or self._received is None:
            return MasterReading(np.eye(4))
        if self._now() - self._received > SILENCE_S:
            self._pose = self._received = None
            raise MasterLostError(self.name, f"no message for {SILENCE_S:g} s")
        begun = self._requested is not None and self._now() - self._sent < BEGUN_S
        return MasterReading(self._pose, self._gripper, turning=self._busy or begun)

    def last_pose(self) -> Array | None:
        """Return its last pose, (4, 4), None before the first."""
        return self._pose

    def align(self, world: World, R: Array, tolerance: float) -> str:  # noqa: ARG002
        """Request a rotation in place, once."""
        if self._pose is None:
            return f"{self.name} publishes nothing"
        if self._requested is None or angle_between(self._requested, R) > tolerance:
            self._requested, self._sent = R.copy(), self._now()
            self.publish("move_cp", {"T": transform(R, self._pose[:3, 3])})
        return ""

    def release(self, world: World, *, locked: bool) -> None:  # noqa: ARG002
        """Request that it carries only its links' weight, as on the dVRK."""
        self._requested = None
        self.publish("use_gravity_compensation", {"data": True})
        self._wrench = np.zeros(6)
        self.publish("body/servo_cf", {"wrench": self._wrench})
        if locked and self._pose is not None:
            self.publish("lock_orientation", {"T": self._pose})
        else:
            self.publish("unlock_orientation", {})

    def exert(self, world: World, wrench: Array) -> None:  # noqa: ARG002
        """Request a wrench on the hand, in axes of the handle, (6,) [N, N m]."""
        if (wrench != self._wrench).any():
            self._wrench = wrench.copy()
            self.publish("body/servo_cf", {"wrench": self._wrench})

    def hold(self, world: World) -> None:  # noqa: ARG002
        """Request that it stays where it is."""
        self._requested = None
        if self._pose is not None:
            self.publish("hold", {})


def component_of(master: RemoteMaster, engine: Teleoperation) -> Component:
    """Return the topics of a master that is no arm of the rig.

    Args:
        master: the master
        engine: calls in the loop's thread
    """

    def begin(core: Core) -> Callable[[], None]:
        master.publish = partial(_publish, core, master.name)
        return lambda: None

    def opening(message: Message) -> float:
        return float(joints(message, "position", ("gripper",))[0])

    def state(message: Message) -> tuple[str, bool, bool]:
        return text(message, "state"), flag(message, "is_homed"), flag(message, "is_busy")

    readers: dict[str, tuple[Callable[[Message], Any], Callable[[Any], object]]] = {
        "measured_cp": (lambda m: pose(m, "pose"), master.receive_pose),
        "gripper/measured_js": (opening, master.receive_gripper),
        "operating_state": (state, lambda now: master.receive_state(*now)),
    }
    reads = {
        f"{master.name}/{key}": reading(engine, read, act, f"{master.name} {key}")
        for key, (read, act) in readers.items()
    }
    return Component(served((row.under(master.name) for row in ROWS), reads), begin)


def _publish(core: Core, name: str, key: str, fields: Mapping[str, Any]) -> None:
    message = dict(fields)
    if key == "move_cp":
        at = build.pose(fields["T"])
        message = {"header": build.header(core.stamper.stamp(), DISPLAY), "pose": at}
    elif key == "lock_orientation":
        message = build.quaternion(fields["T"])
    elif key == "body/servo_cf":
        wrench = fields["wrench"]
        message = {
            "wrench": {"force": build.vector(wrench[:3]), "torque": build.vector(wrench[3:])}
        }
    core.emit(f"{name}/{key}", message)


def engine_and_components(
    loop: Loop, fixtures: Fixtures | None = None
) -> tuple[Teleoperation, tuple[Component, ...]]:
    """Return the teleoperation of a loop's rig, and what a core serves of it.

    Masters that are no arms of the rig are read from topics of their names.

    Raises:
        DescriptionError: a fixture with a force that no master exerts
    """
    names = {name for teleop in loop.world.rig.teleops for name in teleop.masters}
    remote = {
        name: RemoteMaster(name, lambda: loop.now) for name in sorted(names - set(loop.world.arms))
    }
    engine = Teleoperation(loop, None, remote, fixtures)
    parts = (component_of(master, engine) for master in remote.values())
    return engine, (component(engine), *parts)


def components(loop: Loop, fixtures: Fixtures | None = None) -> tuple[Component, ...]:
    """Return the teleoperation topics of a loop's rig, () where it has no teleoperation."""
    if loop.world.rig.teleops:
        return engine_and_components(loop, fixtures)[1]
    if fixtures is not None:
        fixtures.check_masters(())
    return ()
