"""One master that moves an instrument: MTM -> PSM."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.apps.teleoperation.component import Component
from trocar.apps.teleoperation.hand import Hand
from trocar.apps.teleoperation.jaw import JawFollower, JawRule
from trocar.apps.teleoperation.reading import Master, Reading
from trocar.apps.teleoperation.slave import Slave
from trocar.apps.teleoperation.states import ALIGNING, ENABLED, SETTING
from trocar.apps.teleoperation.view import base_in_view
from trocar.descriptions.teleop_records import TeleopDescription
from trocar.geometry.rotations import angle_between
from trocar.geometry.se3 import transform

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]

#: The master is turned after the slave so often. Source: our own choice (the dVRK: 10 ms). [s]
ALIGN_S = 0.05


class ToolTeleoperation(Component):
    """An instrument that does what a hand does, smaller.

    Attributes:
        rotation_locked, translation_locked: what does not follow
        align: whether the master turns as the tool is turned, before it moves it
        offset: rotation from the handle to the tip as the surgeon sees both, (3, 3)
    """

    def __init__(self, world: World, says: TeleopDescription, masters: Sequence[Master]) -> None:
        super().__init__(world, says, masters)
        self.rotation_locked, self.translation_locked = (
            says.rotation_locked,
            says.translation_locked,
        )
        self.align = says.align
        self.offset = np.eye(3)
        self._hand = Hand(says.gripper_threshold, says.roll_threshold)
        self._back = False
        self._slave: Slave | None = None
        self._turned = -np.inf
        self._stuck = ""

    # ------------------------------------------------------------------ what others ask

    def lock_rotation(self, on: bool) -> None:
        """Keep the instrument's orientation, or turn it with the hand again."""
        self.rotation_locked = on
        self.tell("rotation_locked", on)
        if self.current == ENABLED:
            if on:
                self._restart()
                self.masters[0].let_go(self.world, locked=True)
            else:  # the handle was turned in between
                self._align_anew()

    def lock_translation(self, on: bool) -> None:
        """Keep the instrument's place, or move it with the hand again."""
        self.translation_locked = on
        self.tell("translation_locked", on)
        self._restart()

    def set_align(self, on: bool) -> None:
        """Turn the master as the tool is turned before it moves it, or do not."""
        self.align = on
        self.tell("align_mtm", on)
        if self.current == ENABLED:
            self._align_anew()

    # ------------------------------------------------------------------ states

    def _align(self, readings: Sequence[Reading]) -> None:
        reading = readings[0]
        if self._slave is None or self.world.time - self._turned >= ALIGN_S:
            self._turn()
        slave = self._slave
        if slave is None or self.desired == ALIGNING:
            return
        self.offset = reading.T[:3, :3].T @ slave.T[:3, :3]
        error = float(angle_between(np.eye(3), self.offset)) if self.align else 0.0
        near = error <= self.says.orientation_tolerance
        gripper = None if self.says.ignore_jaw else reading.gripper
        rolled = self.offset if near and not reading.turning else None
        there = self._hand.look(gripper, rolled) or reading.present
        if near and there:
            self._hand.there = True
            self._enable(readings)
        elif self._due():
            hint = f"unable to align {self.masters[0].name}: {np.degrees(error):.1f} deg off"
            if self._stuck:
                hint += f" ({self._stuck})"
            self.say("warning", "pinch or twist the gripper a bit" if near else hint)

    def _turn(self) -> None:
        """Turn the master after the tool."""
        self._turned = self.world.time
        self._slave = self._taken()
        if not self.align:
            return
        if not self.clutched:
            self._stuck = self.masters[0].align(self.world, self._slave.T[:3, :3])

    def _taken(self) -> Slave:
        arm = self.says.slave
        return Slave(self.world.arm(arm), base_in_view(self.world, arm))

    def _engage(self, readings: Sequence[Reading]) -> None:
        slave = self._slave = self._taken()
        self._from, self._to = readings[0].T, slave.T
        self.offset = self._from[:3, :3].T @ self._to[:3, :3]
        self._jaw = self._new_jaw()
        self._stuck = ""

    def _new_jaw(self) -> JawFollower | None:
        arm, says = self.world.arm(self.says.slave), self.says
        if says.ignore_jaw or arm.jaw is None:
            return None
        rule = JawRule(
            says.gripper_zero,
            says.gripper_max,
            says.jaw_rate,
            says.jaw_rate_after_clutch,
            float(arm.lower[-1]),
            float(arm.upper[-1]),
        )
        opening = float(arm.setpoints()[-1])
        self.masters[0].meet(rule.gripper(opening))
        return JawFollower(rule, opening)

    def _follow(self, readings: Sequence[Reading], period_s: float) -> None:
        reading, slave = readings[0], self._slave
        if slave is None:
            return
        why = slave.follow(self.goal(reading.T), period_s)
        if why:
            self.masters[0].give_way()
            self._complain(why)
        jaw = self.world.arm(self.says.slave).jaw
        if self._jaw is not None and jaw is not None and reading.gripper is not None:
            jaw.servo_jp([self._jaw.follow(reading.gripper, period_s)])

    def _complain(self, why: str) -> None:
        """Say what holds the tool up: at once, and while it lasts once in a while."""
        if why != self._stuck or self._due():
            self._stuck, self._told = why, self.world.time
            self.say("warning", f"{self.says.slave} cannot follow: {why}")

    def goal(self, T: Array) -> Array:
        """Return where the tip belongs while the handle is at T, as the surgeon sees both."""
        p, R = self._to[:3, 3], self._to[:3, :3]
        if not self.translation_locked:
            p = p + self.scale * (T[:3, 3] - self._from[:3, 3])
        if not self.rotation_locked:
            R = T[:3, :3] @ self.offset
        return transform(R, p)

    def _let_hands_move(self) -> None:
        self.masters[0].let_go(self.world, locked=self.rotation_locked)

    def _lock_hands(self) -> None:
        self.masters[0].let_go(self.world, locked=self.align or self.rotation_locked)

    def _after_clutch(self) -> None:
        self._back = True

    def _go(self, state: str) -> None:
        if state == SETTING:
            self._slave = None
        if state == ALIGNING:
            self._turned = -np.inf
            self._hand.look_again()
            self._hand.there = self._hand.there and self._back
            self._back = False
        super()._go(state)

    def _align_anew(self) -> None:
        self._follow_no_more()
        self._back = True
        self._go(SETTING)

    def _restart(self) -> None:
        if self.following:
            self._engage(self._read())
