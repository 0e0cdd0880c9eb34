"""The states that all teleoperation components share, and when they fall back to DISABLED.

DISABLED -> SETTING_ARMS_STATE -> ALIGNING_MTM -> ENABLED; a clutch that is released begins anew.
Source: SAW mtsTeleOperationPSM.cpp; mtsTeleOperationECM.cpp has all but the aligning.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from trocar.descriptions.teleops import TeleopDescription
from trocar.errors import InputError, UnknownNameError
from trocar.teleoperation.masters import (
    Master,
    MasterLostError,
    MasterReading,
    arm_objection,
    prepare_arm,
)

if TYPE_CHECKING:
    from trocar.simulation import World

_log = logging.getLogger("trocar")

DISABLED = "DISABLED"
SETTING = "SETTING_ARMS_STATE"
ALIGNING = "ALIGNING_MTM"
ENABLED = "ENABLED"


#: Time that arms have to get ready. Source: SAW mtsTeleOperationPSM.cpp. [s]
READY_S = 60.0
#: Time between two reports of what keeps a component from following. Source: as above. [s]
REPORT_S = 2.0

#: Called with what changed or happened: (key, value), as ("current_state", "ENABLED").
Publish = Callable[[str, object], None]


def publish_nothing(key: str, value: object) -> None:
    """Drop it: nothing is connected."""


class TeleopComponent:
    """One slave that follows one master or two; everything is called in the loop's thread.

    Args:
        world: the slave is an arm of its rig
        description: the record of the rig
        masters: as many as it names

    Attributes:
        description, masters: as given
        current, desired: states
        following: whether the slave follows
        clutched: whether the clutch is pressed
        scale: the slave's translation over the masters'
        publish: called with what changes
        message: the last report, "" once the slave follows
    """

    #: {state command: the state that is then requested}. Source: SAW mtsTeleOperationECM.cpp.
    commands: Mapping[str, str] = {"enable": ENABLED, "disable": DISABLED}

    def __init__(
        self, world: World, description: TeleopDescription, masters: Sequence[Master]
    ) -> None:
        self.world, self.description, self.masters = world, description, tuple(masters)
        self.current = self.desired = DISABLED
        self.following = self.clutched = False
        self.scale = description.scale
        self.publish: Publish = publish_nothing
        self.message = ""
        self._since = self._reported = 0.0

    @property
    def name(self) -> str:
        """Its name: "MTMR_PSM1"."""
        return self.description.name

    @property
    def resting(self) -> bool:
        """Whether nothing has to be done at the next tick."""
        return self.current == self.desired == DISABLED

    # ------------------------------------------------------------------ commands

    def command(self, word: str) -> None:
        """Request another state: "enable", "disable" or, of an instrument, "align_MTM".

        Raises:
            UnknownNameError: another word
        """
        if word not in self.commands:
            raise UnknownNameError("state command", word, self.commands, self.name)
        self.request(self.commands[word])

    def request(self, state: str) -> None:
        """Request a state."""
        changed, self.desired = state != self.desired, state
        self.publish("desired_state", state)
        if changed:
            self.publish("status", f"{self.name}: set desired state to {state}")

    def press_clutch(self, pressed: bool) -> None:
        """Press or release the clutch: while it is pressed the slave stays."""
        self.clutched = pressed
        if self.desired != ENABLED or self.current != ENABLED:
            return
        if pressed:
            self._disengage()
        else:
            self.report("status", "console clutch released")
            self._after_clutch()
            self._enter(SETTING)

    def set_scale(self, scale: float) -> None:
        """Change the ratio of translations; the slave does not jump.

        Raises:
            InputError: not finite
        """
        if not isfinite(scale):
            raise InputError(f"{self.name}: got a scale of {scale:g}; allowed: finite")
        self.scale = scale
        self.publish("scale", scale)
        if self.following:
            self._engage(self._read())

    def restart(self) -> None:
        """Align again after a reset put the arms somewhere else."""
        if self.current != DISABLED:
            self._stop_following()
            self._enter(SETTING)

    def tick(self, period_s: float) -> None:
        """Do what the state requires after a period [s]."""
        if self.desired == DISABLED:
            if self.current != DISABLED:
                self._stop()
            return
        if self.current == DISABLED:
            self._enter(SETTING)
        try:
            readings = self._read()
        except MasterLostError as problem:
            self._fail(str(problem))
            return
        if self.current == SETTING:
            self._wait_for_arms()
            return
        objection = self._objection()
        if objection:
            self._fail(f"{objection} anymore")
        elif self.current == ALIGNING:
            self._align(readings)
        elif self.desired != ENABLED:
            self._stop_following()
            self._enter(self.desired)
        elif not self.clutched:
            self._follow(readings, period_s)

    def report(self, level: str, text: str) -> None:
        """Publish and log a message of the level "error", "warning" or "status"."""
        self.message = text
        self.publish(level, f"{self.name}: {text}")
        _log.log(logging.INFO if level == "status" else logging.WARNING, "%s: %s", self.name, text)

    # ------------------------------------------------------------------ of each kind

    def _align(self, readings: Sequence[MasterReading]) -> None:
        """Do what comes before the slave follows; then `_enable`."""
        raise NotImplementedError

    def _engage(self, readings: Sequence[MasterReading]) -> None:
        """Note where masters and slave are: from here on it follows."""
        raise NotImplementedError

    def _follow(self, readings: Sequence[MasterReading], period_s: float) -> None:
        """Move the slave as the masters moved."""
        raise NotImplementedError

    def _release_masters(self, *, clutch: bool) -> None:
        """Let the masters be moved, while the slave follows or while the clutch is pressed."""
        raise NotImplementedError

    def _after_clutch(self) -> None:
        """Prepare for aligning again."""

    def _enable(self, readings: Sequence[MasterReading]) -> None:
        self._enter(ENABLED)
        if self.clutched:
            self._disengage()
            return
        self._release_masters(clutch=False)
        self._engage(readings)
        self._set_following(True)

    def _report_due(self) -> bool:
        """Return whether it is time to report again what keeps the slave from following."""
        if self.world.time - self._reported < REPORT_S:
            return False
        self._reported = self.world.time
        return True

    # ------------------------------------------------------------------ inside

    def _read(self) -> list[MasterReading]:
        return [master.read(self.world) for master in self.masters]

    def _objection(self) -> str:
        slave = arm_objection(self.world.arm(self.description.slave))
        return slave or next(filter(None, (m.objection(self.world) for m in self.masters)), "")

    def _wait_for_arms(self) -> None:
        objection = self._objection()
        if not objection:
            self._enter(ALIGNING)
        elif self.world.time - self._since > READY_S:
            self._fail(f"timed out while setting up arms: {objection}")

    def _enter(self, state: str) -> None:
        self._since = self._reported = self.world.time
        if state == SETTING:
            prepare_arm(self.world.arm(self.description.slave))
            for master in self.masters:
                master.prepare(self.world)
        if state != self.current:
            self.current = state
            self.publish("current_state", state)
            self.publish("status", f"{self.name}: current state is {state}")

    def _disengage(self) -> None:
        self._set_following(False)
        self.report("status", "console clutch pressed")
        self.world.arm(self.description.slave).hold()
        self._release_masters(clutch=True)

    def _set_following(self, on: bool) -> None:
        if on != self.following:
            self.following, self.message = on, ""
            self.publish("following", on)

    def _stop_following(self) -> None:
        if self.following:
            self._set_following(False)
            slave = self.world.arm(self.description.slave)
            if not arm_objection(slave):
                slave.hold()

    def _stop(self) -> None:
        if not self.following:
            self.publish("following", False)  # at each stop, as on the dVRK
        self._stop_following()
        for master in self.masters:
            master.hold(self.world)
        self._enter(DISABLED)

    def _fail(self, reason: str) -> None:
        """Disable it without publishing `desired_state`, which shows commands, as on the dVRK."""
        self.report("error", reason)
        self.desired = DISABLED
        self._stop()
