"""What `trocar teleop` adds to a simulator that is served: who drives, and by what."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from trocar.apps.teleoperation import engine_and_components
from trocar.apps.teleoperation.device import Device
from trocar.apps.teleoperation.drive import Drive
from trocar.apps.teleoperation.engine import Ask, Teleoperation
from trocar.apps.teleoperation.gamepad import Gamepad
from trocar.apps.teleoperation.inputs import component_with_inputs
from trocar.apps.teleoperation.mapping import TABLES
from trocar.apps.teleoperation.motion import Motion, Player
from trocar.apps.teleoperation.polling import Poll, Source
from trocar.apps.teleoperation.puck import Puck
from trocar.apps.teleoperation.window import driving_by_device, driving_by_masters
from trocar.errors import InputError, UnknownNameError
from trocar.interfaces.crtk import Component

if TYPE_CHECKING:
    from trocar.interfaces.loop import Loop
    from trocar.interfaces.viewer import Driving

#: Devices that this machine reads itself; the page reads keys, and gamepads that browsers know.
SOURCES: dict[str, Callable[[], Source]] = {"gamepad": Gamepad, "spacemouse": Puck}


class Session:
    """Somebody who drives a rig.

    Args:
        kind: "keyboard", "gamepad", "spacemouse" or "masters"
        arm: the instrument to begin with; the rig's first when omitted
        scale: factor of a device's speeds, or share of the way of masters; as usual when omitted
        motion: a recording whose masters' motion carries the simulated masters

    Raises:
        UnknownNameError: no such kind
        MissingExtraError: the device's library is not installed
        InputError: no such device is plugged in, or the recording cannot be read
    """

    def __init__(
        self,
        kind: str,
        arm: str | None = None,
        scale: float | None = None,
        motion: str | None = None,
    ) -> None:
        if kind not in TABLES:
            raise UnknownNameError("device", kind, TABLES)
        if scale is not None and not 0.0 < scale <= 1.0:
            raise InputError(f"--scale: got {scale:g}; allowed: above 0 to 1")
        if motion is not None and kind != "masters":
            raise InputError("--motion: carries masters; allowed: with --device masters")
        self._kind, self._arm, self._scale = kind, arm, scale
        self._source = SOURCES[kind]() if kind in SOURCES else None
        self._motion = None if motion is None else Motion.read(motion)
        self._device: Device | None = None
        self._engine: Teleoperation | None = None
        self._ends: list[Callable[[], None]] = []

    def components(self, loop: Loop) -> tuple[Component, ...]:
        """Return what a core serves of it, and begin to listen to the device.

        Raises:
            InputError: a rig without instruments or, for masters, without any
        """
        if self._kind == "masters":
            return self._masters(loop)
        scale = 1.0 if self._scale is None else self._scale
        device = self._device = Device(loop, self._kind.upper(), self._arm, scale)
        if self._source is not None:
            poll = Poll(self._source, partial(_post, device))
            poll.start()
            self._ends.append(poll.stop)
        return (component_with_inputs(device),)

    def driving(self, websocket: str | None) -> Driving:
        """Return the window of the page; `websocket` is where a page may send keys to."""
        if self._device is not None:
            url = websocket if self._kind == "keyboard" else None
            return driving_by_device(self._device, self._kind, url)
        if self._engine is None:
            raise InputError("teleoperation: nothing is driven yet")
        return driving_by_masters(self._engine)

    def close(self) -> None:
        """Listen no longer."""
        for end in self._ends:
            end()

    def _masters(self, loop: Loop) -> tuple[Component, ...]:
        if not loop.world.rig.teleops:
            raise InputError(
                f"rig {loop.world.rig.name}: has no masters that move anything; allowed: a rig "
                "with [[teleop]], as full_cart_mtm"
            )
        engine, parts = engine_and_components(loop)
        self._engine = engine
        if self._scale is not None:
            engine.console.set_scale(self._scale)
        if self._arm is not None:
            engine.console.select(_of_slave(engine, self._arm))
        engine.console.enable(True)
        engine.console.see_operator(True)
        if self._motion is not None:
            engine.players.append(Player(engine, self._motion))
        return parts


def _post(device: Device, drive: Drive | None) -> None:
    name = device.master.name
    device.loop.post(Ask(partial(device.hear, drive), (name, "device")))


def _of_slave(engine: Teleoperation, arm: str) -> str:
    """Return the component that moves an instrument; the endoscope is the camera pedal's."""
    tools = {n: one.says.slave for n, one in engine.components.items() if one.says.kind == "psm"}
    for name, slave in tools.items():
        if slave == arm:
            return name
    able = ", ".join(tools.values())
    raise InputError(f"--arm: got {arm!r}; allowed: {able}")
