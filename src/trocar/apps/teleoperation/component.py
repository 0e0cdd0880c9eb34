"""What all teleoperation components do: their states, and when they fall back to DISABLED.

DISABLED -> SETTING_ARMS_STATE -> ALIGNING_MTM -> ENABLED; a clutch that is released begins anew.
Source: SAW mtsTeleOperationPSM.cpp, mtsTeleOperationECM.cpp.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

from trocar.apps.teleoperation.reading import Master, MasterLostError, Reading
from trocar.apps.teleoperation.ready import ask_to_be_ready, why_arm_not_ready
from trocar.apps.teleoperation.states import (
    ALIGNING,
    COMMANDS,
    DISABLED,
    ENABLED,
    READY_S,
    SETTING,
    TELL_S,
    Tell,
    nowhere,
)
from trocar.descriptions.teleop_records import TeleopDescription
from trocar.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from trocar.simulation import World

_log = logging.getLogger("trocar")


class Component:
    """One slave that follows one master or two; everything is called in the loop's thread.

    Args:
        world: the slave is an arm of its rig
        says: what the rig says of it
        masters: as many as it says

    Attributes:
        says, masters: as given
        current, desired: states
        following: whether the slave follows
        clutched: whether the clutch is pressed
        scale: share of the masters' translation that is made
        tell: takes what changes
        said: what it said last, "" once it follows
    """

    def __init__(self, world: World, says: TeleopDescription, masters: Sequence[Master]) -> None:
        self.world, self.says, self.masters = world, says, tuple(masters)
        self.current = self.desired = DISABLED
        self.following = self.clutched = False
        self.scale = says.scale
        self.tell: Tell = nowhere
        self.said = ""
        self._since = self._told = 0.0

    @property
    def name(self) -> str:
        """Its name: "MTMR_PSM1"."""
        return self.says.name

    @property
    def resting(self) -> bool:
        """Whether nothing has to be done at the next tick."""
        return self.current == self.desired == DISABLED

    # ------------------------------------------------------------------ what others ask

    def command(self, word: str) -> None:
        """Go to another state: "enable", "disable" or "align_mtm".

        Raises:
            UnknownNameError: another word
        """
        if word not in COMMANDS:
            raise UnknownNameError("state command", word, COMMANDS, self.name)
        self.desire(COMMANDS[word])

    def desire(self, state: str) -> None:
        """Say which state is wanted."""
        self.desired = state
        self.tell("desired_state", state)

    def press_clutch(self, pressed: bool) -> None:
        """Press or release the clutch: while it is pressed the slave stays."""
        self.clutched = pressed
        if self.desired != ENABLED or self.current != ENABLED:
            return
        if pressed:
            self._let_go()
        else:
            self.say("status", "console clutch released")
            self._after_clutch()
            self._go(SETTING)

    def set_scale(self, scale: float) -> None:
        """Change the share of translation that is made; the slave does not jump.

        Raises:
            InputError: not above 0 to 1
        """
        if not 0.0 < scale <= 1.0:
            raise InputError(f"{self.name}: got a scale of {scale:g}; allowed: above 0 to 1")
        self.scale = scale
        self.tell("scale", scale)
        if self.following:
            self._engage(self._read())

    def begin_anew(self) -> None:
        """Take hold of the arms anew, after a reset put them somewhere else."""
        if self.current != DISABLED:
            self._follow_no_more()
            self._go(SETTING)

    # ------------------------------------------------------------------ each tick

    def tick(self, period_s: float) -> None:
        """Do what the state asks for, after a period [s]."""
        if self.desired == DISABLED:
            if self.current != DISABLED:
                self._stop()
            return
        if self.current == DISABLED:
            self._go(SETTING)
        try:
            readings = self._read()
        except MasterLostError as problem:
            self._fail(str(problem))
            return
        if self.current == SETTING:
            self._set_arms()
            return
        why = self._why_not_ready()
        if why:
            self._fail(f"{why} anymore")
        elif self.current == ALIGNING:
            self._align(readings)
        elif self.desired != ENABLED:
            self._follow_no_more()
            self._go(self.desired)
        elif not self.clutched:
            self._follow(readings, period_s)

    def say(self, level: str, text: str) -> None:
        """Tell of something in words: "error", "warning" or "status"."""
        self.said = text
        self.tell(level, f"{self.name}: {text}")
        _log.log(logging.INFO if level == "status" else logging.WARNING, "%s: %s", self.name, text)

    # ------------------------------------------------------------------ for those that inherit

    def _align(self, readings: Sequence[Reading]) -> None:
        """Do what comes before the slave follows; then `_enable`."""
        raise NotImplementedError

    def _engage(self, readings: Sequence[Reading]) -> None:
        """Note where masters and slave are: from here on it follows."""
        raise NotImplementedError

    def _follow(self, readings: Sequence[Reading], period_s: float) -> None:
        """Move the slave as the masters moved."""
        raise NotImplementedError

    def _let_hands_move(self) -> None:
        """Let the masters be moved while the slave follows."""
        raise NotImplementedError

    def _lock_hands(self) -> None:
        """Let the masters be moved while the clutch is pressed."""
        raise NotImplementedError

    def _after_clutch(self) -> None:
        """Note that what comes is no first time."""

    def _enable(self, readings: Sequence[Reading]) -> None:
        self._go(ENABLED)
        if self.clutched:
            self._let_go()
            return
        self._let_hands_move()
        self._engage(readings)
        self._set_following(True)

    def _due(self) -> bool:
        """Tell whether it is time to say again what keeps it from beginning."""
        if self.world.time - self._told < TELL_S:
            return False
        self._told = self.world.time
        return True

    # ------------------------------------------------------------------ inside

    def _read(self) -> list[Reading]:
        return [master.read(self.world) for master in self.masters]

    def _why_not_ready(self) -> str:
        slave = why_arm_not_ready(self.world.arm(self.says.slave))
        return next(
            (why for why in (slave, *(m.why_not_ready(self.world) for m in self.masters)) if why),
            "",
        )

    def _set_arms(self) -> None:
        why = self._why_not_ready()
        if not why:
            self._go(ALIGNING)
        elif self.world.time - self._since > READY_S:
            self._fail(f"timed out while setting up arms: {why}")

    def _go(self, state: str) -> None:
        self._since = self._told = self.world.time
        if state == SETTING:
            ask_to_be_ready(self.world.arm(self.says.slave))
            for master in self.masters:
                master.get_ready(self.world)
        if state != self.current:
            self.current = state
            self.tell("current_state", state)

    def _let_go(self) -> None:
        self._set_following(False)
        self.say("status", "console clutch pressed")
        self.world.arm(self.says.slave).hold()
        self._lock_hands()

    def _set_following(self, on: bool) -> None:
        if on != self.following:
            self.following, self.said = on, ""
            self.tell("following", on)

    def _follow_no_more(self) -> None:
        if self.following:
            self._set_following(False)
            slave = self.world.arm(self.says.slave)
            if not why_arm_not_ready(slave):
                slave.hold()

    def _stop(self) -> None:
        self._follow_no_more()
        for master in self.masters:
            master.hold(self.world)
        self._go(DISABLED)

    def _fail(self, why: str) -> None:
        self.say("error", why)
        self.desire(DISABLED)
        self._stop()
