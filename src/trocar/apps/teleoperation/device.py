"""A device that drives a rig: one virtual master, used for one instrument at a time."""

from __future__ import annotations

from math import radians
from typing import TYPE_CHECKING

from trocar.apps.teleoperation.drive import Drive
from trocar.apps.teleoperation.engine import Teleoperation
from trocar.apps.teleoperation.reading import Master
from trocar.apps.teleoperation.virtual_master import HandOf, VirtualMaster
from trocar.descriptions.records import RigDescription
from trocar.descriptions.teleop_records import TeleopDescription
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.interfaces.loop import Loop

#: The gripper at which a jaw is just shut: a little below it the jaw grips. Source: our own choice.
GRIPPER_ZERO = radians(10.0)


class Device:
    """A device, the components that it moves, and which of them it uses.

    It is the operator, too: while it is there, what it selected follows.

    Args:
        loop: of a world with an instrument
        name: "KEYBOARD", "GAMEPAD", ...
        arm: the instrument to begin with; the rig's first when omitted
        scale: factor of all its speeds

    Attributes:
        loop: as given
        master: what it moves
        engine: its teleoperation
        tools: names of the components that move instruments

    Raises:
        InputError: the rig has no instrument, or none of that name
    """

    def __init__(self, loop: Loop, name: str, arm: str | None = None, scale: float = 1.0) -> None:
        self.loop, rig = loop, loop.world.rig
        self.master = VirtualMaster(name, lambda: loop.now, scale)
        hands: list[Master] = [HandOf(self.master, left=left) for left in (True, False)]
        self.tools, teleops = _teleops(rig, name, [hand.name for hand in hands])
        wanted = self.tools[0] if arm is None else f"{name}_{arm}"
        if wanted not in self.tools:
            able = ", ".join(tool.removeprefix(f"{name}_") for tool in self.tools)
            raise InputError(f"--arm: got {arm!r}; allowed: {able}")
        masters = {master.name: master for master in (self.master, *hands)}
        self.engine = Teleoperation(loop, teleops, masters)
        self._used, self._chose = wanted, (0, 0)
        self.engine.console.select(wanted)
        self.engine.console.enable(True)

    @property
    def used(self) -> str:
        """Name of the component that is used."""
        return self._used

    def hear(self, drive: Drive | None) -> None:
        """Take what the device says, None: it is put aside; in the loop's thread."""
        console, was_there = self.engine.console, self.master.alive
        if drive is None:
            self.master.forget()
            if console.present:
                console.see_operator(False)
                self.engine.rest()
            return
        self.master.hear(drive)
        self._choose(drive)
        if not was_there or not console.present:
            console.see_operator(False)
            console.see_operator(True)
        if drive.camera != console.camera:
            console.press_camera(drive.camera)

    def _choose(self, drive: Drive) -> None:
        """Use another instrument, once for each time that it is asked for."""
        chose, self._chose = self._chose, (drive.tool, drive.step)
        if chose == self._chose:
            return
        index = self.tools.index(self._used)
        if 0 < drive.tool <= len(self.tools):
            index = drive.tool - 1
        elif drive.step:
            index = (index + drive.step) % len(self.tools)
        if self.tools[index] != self._used:
            self._used = self.tools[index]
            self.engine.console.select(self._used)


def _teleops(
    rig: RigDescription, name: str, hands: list[str]
) -> tuple[list[str], tuple[TeleopDescription, ...]]:
    """Return the names of components for instruments, and all components."""
    found = [
        TeleopDescription(
            f"{name}_{arm.name}",
            "psm",
            (name,),
            arm.name,
            scale=1.0,
            gripper_zero=GRIPPER_ZERO,
            jaw_rate_after_clutch=radians(720.0),
            source="our own choice: a device tells speeds of the tip itself",
        )
        for arm in rig.arms
        if arm.arm.type == "PSM"
    ]
    if not found:
        raise InputError(f"rig {rig.name}: has no instrument to move; allowed: a rig with a PSM")
    scopes = [
        TeleopDescription(f"{name}_{arm.name}", "ecm", tuple(hands), arm.name, scale=1.0)
        for arm in rig.arms
        if arm.arm.type == "ECM"
    ]
    return [tool.name for tool in found], (*found, *scopes)
