"""Commands for one joint of an arm, as interfaces older than CRTK give them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from trocar.interfaces.commands import Command
    from trocar.simulation import World


@dataclass(frozen=True)
class JointPosition:
    """Servo one joint, or pin it; the others keep their set-points.

    Attributes:
        arm, joint: names
        position: [rad or m]
        mode: "position": by the servo; "set": as if it had no mass
    """

    arm: str
    joint: str
    position: float
    mode: Literal["position", "set"] = "position"

    @property
    def stream(self) -> tuple[str, str]:
        """Newer set-points of the same joint take the place of older ones."""
        return self.arm, self.joint

    def apply(self, world: World) -> None:
        """Call `set_mode` where the joint is in another, and `servo_jp`."""
        arm = world.arm(self.arm)
        if arm.mode(self.joint) != self.mode:
            arm.set_mode(self.mode, [self.joint])
        told = arm.setpoint_js()
        goal = np.array(told.position)
        goal[told.name.index(self.joint)] = self.position
        arm.servo_jp(goal)


@dataclass(frozen=True)
class JointEffort:
    """Exert an effort on one joint for one tick; without a new one it exerts none after.

    Attributes:
        arm, joint: names
        effort: [N m or N]
        post: takes the command that ends it
    """

    arm: str
    joint: str
    effort: float
    post: Callable[[Command], object] = field(compare=False)

    @property
    def stream(self) -> tuple[str, str]:
        """Newer efforts on the same joint take the place of older ones."""
        return self.arm, self.joint

    def apply(self, world: World) -> None:
        """Call `set_mode` where the joint is in another, and `servo_jf`."""
        exert(world, self.arm, self.joint, self.effort)
        self.post(JointRelease(self.arm, self.joint))


@dataclass(frozen=True)
class JointRelease:
    """End the effort on one joint."""

    arm: str
    joint: str

    @property
    def stream(self) -> tuple[str, str]:
        """A new effort on the joint takes its place."""
        return self.arm, self.joint

    def apply(self, world: World) -> None:
        """Call `servo_jf`, unless the joint has been taken back by a position."""
        if world.arm(self.arm).mode(self.joint) == "effort":
            exert(world, self.arm, self.joint, 0.0)


def exert(world: World, name: str, joint: str, effort: float) -> None:
    """Set one joint's effort [N m or N]; joints under position control ignore theirs."""
    arm = world.arm(name)
    if arm.mode(joint) != "effort":
        arm.set_mode("effort", [joint])
    told = arm.setpoint_js()
    efforts = np.array(told.effort)
    efforts[told.name.index(joint)] = effort
    arm.servo_jf(efforts)
