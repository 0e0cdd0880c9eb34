"""Masters: what moves a slave. Simulated MTMs, and handles that a keyboard or a gamepad moves.

Everything is called in the loop's thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import radians
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.errors import SingularError, TrocarError, UnreachableError
from trocar.geometry.rotations import angle_between, matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform, translation
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import inverse_kinematics
from trocar.teleoperation.devices import STILL, DeviceCommand

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm

Array = NDArray[np.float64]

#: Pause between moves, by as much as it lacks, of a gimbal that friction stopped beside its goal.
#: Source: our own choice. [s]
NUDGE_S = 0.1
#: It has arrived when it lacks less than this. Source: our own choice. [rad]
CLOSE = np.deg2rad(0.5)
#: Largest distance that a joint is commanded beyond its goal. Source: our own choice. [rad]
BEYOND = np.deg2rad(15.0)

#: A device that sends nothing for this long is lost. Source: our own choice: ten times the pause
#: between two messages of a page. [s]
SILENCE_S = 0.5
#: First position of a virtual handle in the surgeon's frame. Source: our own choice. [m]
PLACE = (0.0, 0.0, 0.3)
#: Widest opening of a virtual gripper. Source: as a master's. [rad]
WIDEST = radians(60.0)
#: Speed of a dragged picture over a tool's. Source: our own choice.
CAMERA_PACE = 3.0
#: Distance of each hand on a picture from the middle. Source: our own choice. [m]
APART = 0.1


class MasterLostError(TrocarError):
    """A master that reports nothing any longer, or cannot move.

    Attributes:
        master: its name
        reason: why it is lost
    """

    def __init__(self, master: str, reason: str) -> None:
        self.master, self.reason = master, reason
        super().__init__(f"{master}: {reason}")


@dataclass(frozen=True, eq=False)
class MasterReading:
    """A master at a moment.

    Attributes:
        T: pose of the handle in the surgeon's frame: x left, y up, z away from the eyes, (4, 4)
        gripper: its opening, None without one [rad]
        present: whether a hand is known to be there; else it has to move gripper or roll
        turning: whether it moves by itself: no hand turns it, and no slave may follow
    """

    T: Array
    gripper: float | None = None
    present: bool = False
    turning: bool = False


class Master:
    """Base of all masters: one that is always ready and has nothing to align or to hold.

    Attributes:
        name: "MTMR", ...
    """

    name: str
    #: Whether `exert` acts on a hand.
    exerts = False

    def objection(self, world: World) -> str:  # noqa: ARG002
        """Return the reason that it cannot be used, "" when it can."""
        return ""

    def prepare(self, world: World) -> None:
        """Request that it becomes usable, which may take seconds."""

    def read(self, world: World) -> MasterReading:
        """Return its pose.

        Raises:
            MasterLostError: it reports nothing any longer
        """
        raise NotImplementedError

    def last_pose(self) -> Array | None:
        """Return the handle's last pose in the surgeon's frame, (4, 4); None before the first.

        From any thread.
        """
        return None

    def align(self, world: World, R: Array, tolerance: float) -> str:  # noqa: ARG002
        """Turn in place to an orientation (3, 3), once; return what prevents that, or "".

        Another call moves it again only if the orientation changed by more than `tolerance` [rad].
        """
        return ""

    def match_gripper(self, opening: float) -> None:
        """Take the opening that fits the jaw's [rad], if no fingers hold the gripper."""

    def step_back(self) -> None:
        """Return to the reading before, if no hand holds the handle: the slave cannot follow."""

    def release(self, world: World, *, locked: bool) -> None:
        """Let the hand move it freely; locked: all but its orientation."""

    def exert(self, world: World, wrench: Array) -> None:
        """Exert a wrench on the hand until the next call or `release`.

        Call only while the master is released.

        Args:
            world: the world
            wrench: force and torque in axes of the handle, (6,) [N, N m]
        """

    def hold(self, world: World) -> None:
        """Stay where it is."""


def arm_objection(arm: Arm) -> str:
    """Return the reason that an arm cannot be used, "" when it can."""
    now = arm.operating_state()
    if now.state != "ENABLED":
        return f'{arm.name} is not in state "ENABLED" but "{now.state}"'
    return "" if now.ready else f"{arm.name} is not homed"


def prepare_arm(arm: Arm) -> None:
    """Enable and home an arm where it needs that; homing takes a while."""
    now = arm.operating_state()
    if now.state == "PAUSED":
        arm.state_command("resume")
    elif now.state == "FAULT" or (now.phase == "HOMED" and not now.is_homed):
        arm.disable()
    if arm.operating_state().state == "DISABLED":
        arm.enable()
    if arm.operating_state().phase == "ENABLED":
        arm.home()


class ArmMaster(Master):
    """A simulated MTM of the rig.

    Args:
        name: of the arm
    """

    exerts = True

    def __init__(self, name: str) -> None:
        self.name = name
        self._exerting = False
        self._base: Array | None = None
        self._requested: Array | None = None
        self._goal = self._extra = np.zeros(0)
        self._place: Array | None = None
        self._nudged = 0.0

    def objection(self, world: World) -> str:
        """Return the reason that the arm cannot be used, "" when it can."""
        return arm_objection(world.arm(self.name))

    def prepare(self, world: World) -> None:
        """Enable and home the arm where it needs it."""
        self._base = self._requested = self._place = None
        prepare_arm(world.arm(self.name))

    def read(self, world: World) -> MasterReading:
        """Return the measured pose of the handle, and its gripper."""
        arm = world.arm(self.name)
        if self._base is None:
            self._base = arm.local.base_frame()[0]
        q = arm.joints.readings()[0]
        opening = float(q[-1]) if arm.description.has_gripper else None
        T = self._base @ chain_pose(arm.description.mechanism)(q)
        return MasterReading(T, opening, turning=arm.operating_state().is_busy)

    def align(self, world: World, R: Array, tolerance: float) -> str:
        """Turn the gimbal once; the handle stays in its place.

        A gimbal that friction stopped beside its goal is moved on until it is close.
        """
        arm, here = world.arm(self.name), self.read(world).T
        if self._requested is None or angle_between(self._requested, R) > tolerance:
            return self._begin(arm, here, R)
        if not arm.operating_state().is_busy and world.time - self._nudged > NUDGE_S:
            self._nudged = world.time
            if angle_between(here[:3, :3], R) >= CLOSE:
                own = slice(0, len(self._goal))
                lacks = self._goal - arm.joints.readings()[0][own]
                self._extra = np.clip(self._extra + lacks, -BEYOND, BEYOND)
                arm.move_jp(
                    np.clip(self._goal + self._extra, arm.joints.lower[own], arm.joints.upper[own])
                )
        return ""

    def release(self, world: World, *, locked: bool) -> None:
        """Exert only the links' weight; locked: the gimbal holds its orientation.

        The dVRK commands a wrench of zero in both cases. `free` is that without the platform's
        null space, which has no hand to give way to here, at a tenth of the cost.
        """
        arm = world.arm(self.name)
        self._requested = self._place = None
        self._exerting = False
        arm.joints.use_gravity_compensation(True)
        if locked:
            arm.body.servo_cf(np.zeros(6))
            arm.forces.lock_orientation()
        else:
            arm.free()

    def exert(self, world: World, wrench: Array) -> None:
        """Exert a wrench on the hand, in axes of the handle, (6,) [N, N m]."""
        arm = world.arm(self.name)
        if not self._exerting:
            self._exerting = True
            arm.forces.set_cf_orientation_absolute(False)  # a client may have switched it
        arm.body.servo_cf(wrench)

    def hold(self, world: World) -> None:
        """Stay where it is."""
        self._requested = self._place = None
        if not self.objection(world):
            world.arm(self.name).hold()

    def _begin(self, arm: Arm, here: Array, R: Array) -> str:
        """Move to the joint positions with the orientation that are nearest to those now."""
        mechanism = arm.description.mechanism
        if self._place is None:
            self._place = here[:3, 3].copy()
        base = self._base if self._base is not None else np.eye(4)
        goal = inverse(base) @ transform(R, self._place)
        try:
            found = inverse_kinematics(mechanism, "gimbal_arm", goal, arm.joints.readings()[0][:7])
        except (UnreachableError, SingularError) as problem:
            return str(problem)
        self._goal = found[0]
        self._requested, self._extra = R.copy(), np.zeros(len(self._goal))
        arm.move_jp(self._goal)
        return ""


class VirtualMaster(Master):
    """A handle in the air, moved at the speeds of a keyboard, a gamepad or a SpaceMouse.

    Args:
        name: of the device: "KEYBOARD"
        now: wall time [s]
        scale: factor of all its speeds

    Attributes:
        name, scale: as given
        drive: the commanded speeds
    """

    def __init__(self, name: str, now: Callable[[], float], scale: float = 1.0) -> None:
        self.name, self._now, self.scale = name, now, scale
        self.drive = STILL
        self._received: float | None = None
        self._pose = self._before = translation(PLACE)
        self._gripper = WIDEST
        self._read_at = -1.0

    @property
    def alive(self) -> bool:
        """Whether the device sent something a moment ago."""
        return self._received is not None and self._now() - self._received <= SILENCE_S

    def receive(self, drive: DeviceCommand) -> None:
        """Take what the device sends."""
        self.drive, self._received = drive, self._now()

    def put_aside(self) -> None:
        """Stop, and expect no messages from the device."""
        self.drive, self._received = STILL, None

    def objection(self, world: World) -> str:  # noqa: ARG002
        """Return the reason that it cannot be used: the device sends nothing."""
        return "" if self.alive else f"{self.name} sends nothing"

    def prepare(self, world: World) -> None:
        """Begin in the middle."""
        self._pose = transform(self._pose[:3, :3], PLACE)
        self._read_at = world.time

    def read(self, world: World) -> MasterReading:
        """Move on by the time since the last call, and return where it is.

        Raises:
            MasterLostError: the device has sent nothing for a while
        """
        if self._received is not None and not self.alive:
            self.put_aside()
            raise MasterLostError(self.name, f"no message for {SILENCE_S:g} s")
        period = self.scale * (world.time - self._read_at)
        self._read_at = world.time
        if period > 0.0:
            drive, pace = self.drive, CAMERA_PACE if self.drive.camera else 1.0
            turn = matrix_from_rotation_vector(pace * period * drive.angular)
            place = self._pose[:3, 3] + pace * period * drive.linear
            self._before, self._pose = self._pose, transform(turn @ self._pose[:3, :3], place)
            self.match_gripper(self._gripper + period * drive.opening)
        return MasterReading(self._pose, self._gripper, present=True)

    def last_pose(self) -> Array | None:
        """Return the handle's pose, (4, 4)."""
        return self._pose

    def align(self, world: World, R: Array, tolerance: float) -> str:  # noqa: ARG002
        """Turn at once: nothing is in the way."""
        self._pose = transform(R, self._pose[:3, 3])
        return ""

    def match_gripper(self, opening: float) -> None:
        """Take the opening that fits the jaw's [rad]."""
        self._gripper = min(max(opening, 0.0), WIDEST)

    def step_back(self) -> None:
        """Go back to the reading before."""
        self._pose = self._before


class HandOf(Master):
    """One of two hands that a virtual master has on the picture.

    Args:
        master: moves both
        left: whether it is the left one
    """

    def __init__(self, master: VirtualMaster, *, left: bool) -> None:
        self.name = f"{master.name}_{'LEFT' if left else 'RIGHT'}"
        self._master = master
        self._offset = np.array([APART if left else -APART, 0.0, 0.0])

    def objection(self, world: World) -> str:
        """Return the reason that the master cannot be used."""
        return self._master.objection(world)

    def prepare(self, world: World) -> None:
        """Begin anew, upright."""
        self._master.prepare(world)
        self._master.align(world, np.eye(3), 0.0)

    def read(self, world: World) -> MasterReading:
        """Return the hand's pose.

        Raises:
            MasterLostError: as the master does
        """
        return MasterReading(self._hand(self._master.read(world).T), present=True)

    def last_pose(self) -> Array | None:
        """Return the hand's pose, (4, 4)."""
        T = self._master.last_pose()
        return None if T is None else self._hand(T)

    def _hand(self, T: Array) -> Array:
        return transform(T[:3, :3], T[:3, 3] + T[:3, :3] @ self._offset)
