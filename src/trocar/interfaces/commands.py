"""What an interface may ask of the simulation: frozen records, applied at tick boundaries.

A command carries plain numbers (tuples, SI units and radians), so that it can cross threads, be
compared, and be written down. `apply(world)` calls the one public method that the command names;
checking and clipping are the arm's own business, so that every interface meets the same rules.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

import numpy as np

from trocar.errors import InputError
from trocar.simulation.journal import Entry, apply_command

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.arm import Arm
    from trocar.simulation.jaw import Jaw

Numbers = tuple[float, ...]
Mode = Literal["set", "position", "effort"]


class Command(Protocol):
    """Anything that can be applied to a world between two ticks."""

    def apply(self, world: World) -> None:
        """Call the world."""
        ...


@dataclass(frozen=True)
class ServoJp:
    """Set the joint set-points directly.

    Args:
        arm: name of the arm
        position: set-points in the arm's joint order without the jaw, (n,) [rad or m]
        velocity: set-point velocities, (n,) [rad/s or m/s]; None means zero
    """

    arm: str
    position: Numbers
    velocity: Numbers | None = None

    def apply(self, world: World) -> None:
        """Call `servo_jp`."""
        velocity = None if self.velocity is None else np.array(self.velocity)
        world.arm(self.arm).servo_jp(np.array(self.position), velocity)


@dataclass(frozen=True)
class ServoJf:
    """Set the joint efforts; joints that are not in effort mode ignore theirs.

    Args:
        arm: name of the arm
        effort: efforts in the arm's joint order without the jaw, (n,) [N m or N]
    """

    arm: str
    effort: Numbers

    def apply(self, world: World) -> None:
        """Call `servo_jf`."""
        world.arm(self.arm).servo_jf(np.array(self.effort))


@dataclass(frozen=True)
class MoveJp:
    """Move the joints to a goal within the arm's velocity and acceleration limits.

    Args:
        arm: name of the arm
        position: goal in the arm's joint order without the jaw, (n,) [rad or m]
    """

    arm: str
    position: Numbers

    def apply(self, world: World) -> None:
        """Call `move_jp`."""
        world.arm(self.arm).move_jp(np.array(self.position))


@dataclass(frozen=True)
class MoveTo:
    """Move an arm, and its jaw where the pose says so, to one of its named poses."""

    arm: str
    pose: str

    def apply(self, world: World) -> None:
        """Call `move_to`."""
        world.arm(self.arm).move_to(self.pose)


@dataclass(frozen=True)
class JawMove:
    """Move the jaw to an opening angle [rad]; below zero the rest is grip force."""

    arm: str
    position: float

    def apply(self, world: World) -> None:
        """Call the jaw's `move_jp`."""
        _jaw(world.arm(self.arm)).move_jp([self.position])


@dataclass(frozen=True)
class JawServo:
    """Set the jaw's set-point directly [rad]."""

    arm: str
    position: float

    def apply(self, world: World) -> None:
        """Call the jaw's `servo_jp`."""
        _jaw(world.arm(self.arm)).servo_jp([self.position])


@dataclass(frozen=True)
class JawServoJf:
    """Set the jaw's effort [N m]."""

    arm: str
    effort: float

    def apply(self, world: World) -> None:
        """Call the jaw's `servo_jf`."""
        _jaw(world.arm(self.arm)).servo_jf([self.effort])


@dataclass(frozen=True)
class Verb:
    """Any verb of an arm, its jaw or the world, by name.

    Args:
        arm: name of the arm, "world" for the world's own
        name: the verb: "servo_cp", "move_jr", "enable", "jaw.close", ...
        values: its arguments by name
    """

    arm: str
    name: str
    values: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def apply(self, world: World) -> None:
        """Call the verb; a verb that is none is an InputError."""
        entry = Entry(world.periods, world.time, "command", self.arm, self.name, self.values)
        apply_command(world, entry)


@dataclass(frozen=True)
class GripperSqueezeTo:
    """Hold a master's gripper at an opening angle [rad]; wide open is letting it go."""

    arm: str
    position: float

    def apply(self, world: World) -> None:
        """Call the gripper's `squeeze_to` or `release`."""
        arm = world.arm(self.arm)
        if arm.gripper is None:
            raise InputError(f"{arm.name} has no gripper")
        if self.position >= arm.upper[-1]:
            arm.gripper.release()
        else:
            arm.gripper.squeeze_to(self.position)


@dataclass(frozen=True)
class Hold:
    """Stop where the arm is."""

    arm: str

    def apply(self, world: World) -> None:
        """Call `hold`."""
        world.arm(self.arm).hold()


@dataclass(frozen=True)
class SetMode:
    """Switch the control mode of some joints (None: all of the arm)."""

    arm: str
    mode: Mode
    joints: tuple[str, ...] | None = None

    def apply(self, world: World) -> None:
        """Call `set_mode`."""
        world.arm(self.arm).set_mode(self.mode, self.joints)


@dataclass(frozen=True)
class SetGains:
    """Change the gains of one joint; None keeps a gain.

    Args:
        arm: name of the arm
        joint: name of the joint
        p: stiffness [N m/rad or N/m]
        i: integral gain [N m/(rad s) or N/(m s)]
        d: damping [N m s/rad or N s/m]
    """

    arm: str
    joint: str
    p: float | None = None
    i: float | None = None
    d: float | None = None

    def apply(self, world: World) -> None:
        """Call `set_gains`."""
        world.arm(self.arm).set_gains(self.joint, p=self.p, i=self.i, d=self.d)


@dataclass(frozen=True)
class SetGravityCompensation:
    """Switch gravity compensation of an arm."""

    arm: str
    on: bool

    def apply(self, world: World) -> None:
        """Call `use_gravity_compensation`."""
        world.arm(self.arm).use_gravity_compensation(self.on)


@dataclass(frozen=True)
class Brakes:
    """Release or lock the brakes of a setup arm (joints None: all of them)."""

    arm: str
    released: bool
    joints: tuple[str, ...] | None = None

    def apply(self, world: World) -> None:
        """Call `release_brakes` or `lock_brakes`."""
        arm = world.arm(self.arm)
        if self.released:
            arm.release_brakes(self.joints)
        else:
            arm.lock_brakes(self.joints)


@dataclass(frozen=True)
class ExchangeTool:
    """Mount another tool on an arm: a built-in one, the path of a TOML file, or "none"."""

    arm: str
    tool: str

    def apply(self, world: World) -> None:
        """Call `exchange_tool`."""
        world.exchange_tool(self.arm, self.tool)


@dataclass(frozen=True)
class SetReferenceArm:
    """Choose the arm whose tip frame the poses of the others on setup joints are in."""

    arm: str

    def apply(self, world: World) -> None:
        """Call `set_reference_arm`."""
        world.set_reference_arm(self.arm)


@dataclass(frozen=True)
class Reset:
    """Put the whole rig back to a named start pose at time zero."""

    pose: str = "start"
    seed: int | None = None

    def apply(self, world: World) -> None:
        """Call `reset`."""
        world.reset(seed=self.seed, pose=self.pose)


@dataclass(frozen=True)
class Pause:
    """Stop the flow of time; commands are still applied. The loop itself obeys this one."""

    def apply(self, world: World) -> None:
        """Nothing: a world has no flow of time of its own."""


@dataclass(frozen=True)
class Resume:
    """Let time flow again. The loop itself obeys this one."""

    def apply(self, world: World) -> None:
        """Nothing: a world has no flow of time of its own."""


@dataclass(frozen=True)
class Step:
    """Advance some physics periods while time stands still. The loop allows it while paused only.

    Args:
        periods: 1 to `MOST`
    """

    periods: int
    #: Source: our own choice: 10 s at 1 ms, for which nobody else is listened to.
    MOST: ClassVar[int] = 10_000

    def apply(self, world: World) -> None:
        """Call the world's `step`."""
        if not 1 <= self.periods <= self.MOST:
            raise InputError(f"step: got {self.periods} periods; allowed: 1 to {self.MOST}")
        world.step(self.periods)


def _jaw(arm: Arm) -> Jaw:
    if arm.jaw is None:
        raise InputError(f"{arm.name} has no jaw")
    return arm.jaw
