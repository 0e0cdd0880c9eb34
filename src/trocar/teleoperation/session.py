"""Sessions of teleoperation: a device, the masters of a console, or clients; and their tab."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from math import radians
from typing import TYPE_CHECKING

import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.descriptions.teleops import TeleopDescription
from trocar.errors import InputError, UnknownNameError
from trocar.ros import Component
from trocar.teleoperation.component import DISABLED, ENABLED
from trocar.teleoperation.devices import (
    PEDAL_KEYS,
    SOURCES,
    TABLES,
    DeviceBinding,
    DeviceCommand,
    Poll,
    table,
)
from trocar.teleoperation.engine import Teleoperation
from trocar.teleoperation.force_feedback import FeedbackSettings
from trocar.teleoperation.masters import HandOf, Master, VirtualMaster
from trocar.teleoperation.motion import MasterMotion, MotionPlayer
from trocar.teleoperation.psm import PsmTeleoperation
from trocar.teleoperation.remote_master import engine_and_components
from trocar.teleoperation.topics import KEYS, PAD, component, input_component, pedal_component
from trocar.teleoperation.virtual_fixtures import Fixtures
from trocar.viewer import Driving, Pedal

if TYPE_CHECKING:
    from trocar.live.loop import Loop

#: The gripper at which a jaw is just shut: a little below it the jaw grips. Source: our own choice.
GRIPPER_ZERO = radians(10.0)
COLOURS = {DISABLED: "#868e96", ENABLED: "#2b8a3e"}
LABELS = {
    "operator_present": "Operator present",
    "cam_minus": "Cam -",
    "cam_plus": "Cam +",
}


class Device:
    """A keyboard, a gamepad or a SpaceMouse, the components that it moves, and the one it uses.

    It is the operator, too: while it is there, the selected component follows.

    Args:
        loop: of a world with an instrument
        name: "KEYBOARD", "GAMEPAD", ...
        arm: the first instrument to use; the rig's first when omitted
        scale: factor of all its speeds
        fixtures: virtual fixtures of the instruments

    Attributes:
        master: its handle
        engine: its teleoperation
        tools: names of the components that move instruments
        used: name of the component that is used

    Raises:
        InputError: the rig has no instrument, or none of that name
    """

    def __init__(
        self,
        loop: Loop,
        name: str,
        arm: str | None = None,
        scale: float = 1.0,
        fixtures: Fixtures | None = None,
    ) -> None:
        self.master = VirtualMaster(name, lambda: loop.now, scale)
        hands: list[Master] = [HandOf(self.master, left=left) for left in (True, False)]
        self.tools, teleops = _teleops(loop.world.rig, name, [hand.name for hand in hands])
        self.used = self.tools[0] if arm is None else f"{name}_{arm}"
        if self.used not in self.tools:
            able = ", ".join(tool.removeprefix(f"{name}_") for tool in self.tools)
            raise InputError(f"--arm: got {arm!r}; allowed: {able}")
        masters = {master.name: master for master in (self.master, *hands)}
        self.engine = Teleoperation(loop, teleops, masters, fixtures)
        self._choice = (0, 0)
        self._held: frozenset[str] = frozenset()
        self.engine.console.select(self.used)
        self.engine.components[self.used].message = f"waits for the first input of {name}"

    @property
    def instruments(self) -> list[str]:
        """The arms that it moves one at a time."""
        return [self.engine.components[tool].description.slave for tool in self.tools]

    def receive(self, drive: DeviceCommand | None) -> None:
        """Take a command of the device, None: it is put aside; in the loop's thread."""
        console, was_alive = self.engine.console, self.master.alive
        self._press(frozenset() if drive is None else drive.pedals)
        if drive is None:
            self.master.put_aside()
            if console.present:
                console.set_operator_present(False)
                self.engine.rest()
            return
        self.master.receive(drive)
        if not console.enabled:  # the first input, whenever it comes
            console.enable(True)
        self._choose(drive)
        if not was_alive or not console.present:
            console.set_operator_present(False)
            console.set_operator_present(True)
        if drive.camera != console.camera:
            self.engine.pedals.press("camera", drive.camera)

    def components(self) -> tuple[Component, ...]:
        """Return the topics of teleoperation, pedals, keys and sticks."""
        inputs = input_component(self.engine, self.master.name, self.receive)
        return component(self.engine), inputs

    def _press(self, pedals: frozenset[str]) -> None:
        for name in sorted(pedals ^ self._held):
            self.engine.pedals.press(name, name in pedals)
        self._held = pedals

    def _choose(self, drive: DeviceCommand) -> None:
        """Use another instrument, once for each time that a key is pressed."""
        before, self._choice = self._choice, (drive.tool, drive.step)
        if before == self._choice:
            return
        index = self.tools.index(self.used)
        if 0 < drive.tool <= len(self.tools):
            index = drive.tool - 1
        elif drive.step:
            index = (index + drive.step) % len(self.tools)
        if self.tools[index] != self.used:
            self.used = self.tools[index]
            self.engine.console.select(self.used)


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
            source="our own choice: a device commands speeds of the tip itself",
        )
        for arm in rig.arms
        if arm.arm.type == "PSM"
    ]
    if not found:
        raise InputError(f"rig {rig.name}: has no instrument; allowed: a rig with a PSM")
    scopes = [
        TeleopDescription(f"{name}_{arm.name}", "ecm", tuple(hands), arm.name, scale=1.0)
        for arm in rig.arms
        if arm.arm.type == "ECM"
    ]
    return [tool.name for tool in found], (*found, *scopes)


class Session:
    """The driver of a rig, or of its pedals alone.

    Args:
        kind: "keyboard", "gamepad", "spacemouse" or "masters"; None: clients drive, the page has
            the pedals
        arm: the first instrument to use; the rig's first when omitted
        scale: factor of a device's speeds, or ratio of the masters' way; as usual when omitted
        motion: a recording whose masters' motion carries the simulated masters
        feedback: force feedback to the masters; None: none

    Attributes:
        device, engine: once components are made; a session of masters has no device

    Raises:
        UnknownNameError: no such kind
        MissingExtraError: the device's library is not installed
        InputError: no such device is plugged in, or the recording cannot be read
    """

    def __init__(
        self,
        kind: str | None = None,
        arm: str | None = None,
        scale: float | None = None,
        motion: str | None = None,
        feedback: FeedbackSettings | None = None,
    ) -> None:
        if kind is not None and kind not in TABLES:
            raise UnknownNameError("device", kind, TABLES)
        if scale is not None and not 0.0 < scale <= 1.0:
            raise InputError(f"--scale: got {scale:g}; allowed: above 0 to 1")
        if motion is not None and kind != "masters":
            raise InputError("--motion: allowed with --device masters only")
        if feedback is not None and kind != "masters":
            raise InputError("--feedback: allowed with --device masters only")
        self._kind, self._arm, self._scale = kind, arm, scale
        self._feedback = feedback
        self._source = SOURCES[kind]() if kind in SOURCES else None
        self._motion = None if motion is None else MasterMotion.read(motion)
        self.device: Device | None = None
        self.engine: Teleoperation | None = None
        self._poll: Poll | None = None

    def components(self, loop: Loop, fixtures: Fixtures | None = None) -> tuple[Component, ...]:
        """Return its topics, and begin to poll the device.

        Args:
            loop: of a world
            fixtures: virtual fixtures of its instruments

        Raises:
            InputError: a rig without instruments or, for masters, without any
            DescriptionError: a fixture with a force that no master exerts
        """
        if self._kind is None or self._kind == "masters":
            return self._masters(loop, fixtures)
        scale = 1.0 if self._scale is None else self._scale
        device = self.device = Device(loop, self._kind.upper(), self._arm, scale, fixtures)
        self.engine = device.engine
        if self._source is not None:
            stream = f"{device.master.name} device"
            self._poll = Poll(
                self._source,
                lambda drive: device.engine.call(partial(device.receive, drive), stream),
            )
            self._poll.start()
        return device.components()

    def driving(self, websocket: str | None) -> Driving:
        """Return the tab of the page; `websocket` is the address to which a page sends keys."""
        if self.engine is None:
            raise InputError("teleoperation: not started")
        pedals = [_pedal(self.engine, name) for name in self.engine.pedals.names]
        if self._kind is None:
            return Driving("Pedals", {}, partial(status, self.engine), pedals=pedals)
        if self.device is not None:
            url = websocket if self._kind == "keyboard" else None
            kinds = ("keyboard", "gamepad") if url else (self._kind,)
            return Driving(
                "Drive",
                {kind: _rows(table(kind, self.device.instruments)) for kind in kinds},
                partial(status, self.engine, self.device.master.scale),
                url,
                KEYS,
                PAD,
                [pedal for pedal in pedals if pedal.label != LABELS["operator_present"]],
            )
        engine, console = self.engine, self.engine.console
        if engine.components:
            on = Pedal(
                "Teleoperation on",
                lambda on: engine.call(partial(console.enable, on)),
                lambda: console.enabled,
            )
            pedals.insert(0, on)
        return Driving(
            "Masters",
            {"masters": _rows(TABLES["masters"])},
            partial(status, engine),
            pedals=pedals,
            handles=tuple(engine.carriers),
            carry=lambda name, T: engine.call(partial(engine.carriers[name].carry, T)),
            let_go=lambda name: engine.call(engine.carriers[name].let_go),
        )

    def close(self) -> None:
        """Poll no longer."""
        if self._poll is not None:
            self._poll.stop()

    def _masters(self, loop: Loop, fixtures: Fixtures | None) -> tuple[Component, ...]:
        if not loop.world.rig.teleops:
            engine = self.engine = Teleoperation(loop, fixtures=fixtures)
            pedals = pedal_component(engine)
            if self._kind is None:
                return (pedals,)
            if not engine.carriers:
                raise InputError(
                    f"rig {loop.world.rig.name}: has no masters; allowed: a rig with an MTM, "
                    "e.g. full_cart_mtm"
                )
            if self._arm is not None or self._scale is not None:
                raise InputError(
                    f"--arm, --scale: rig {loop.world.rig.name} has no instrument that its masters "
                    "move; allowed: a rig with [[teleop]], e.g. full_cart_mtm"
                )
            engine.set_feedback(self._feedback)
            if self._motion is not None:
                engine.players.append(MotionPlayer(engine, self._motion))
            return pedals, Component({}, lambda _: engine.start())
        engine, parts = engine_and_components(loop, fixtures)
        self.engine = engine
        engine.set_feedback(self._feedback)
        if self._kind is not None:
            if self._scale is not None:
                engine.console.set_scale(self._scale)
            if self._arm is not None:
                engine.console.select(_moving(engine, self._arm))
            engine.console.enable(True)
            engine.console.set_operator_present(True)
            engine.pedals.note("operator_present", True)
        if self._motion is not None:
            engine.players.append(MotionPlayer(engine, self._motion))
        return parts


def _pedal(engine: Teleoperation, name: str) -> Pedal:
    label, pedals = LABELS.get(name, name.capitalize()), engine.pedals
    press: Callable[[bool], object] = partial(pedals.press, name)
    return Pedal(label, press, lambda: name in pedals.pressed, PEDAL_KEYS[name])


def _rows(lines: Sequence[DeviceBinding]) -> list[tuple[str, str]]:
    return [(line.touch, line.does) for line in lines]


def _moving(engine: Teleoperation, arm: str) -> str:
    """Return the component that moves an instrument; the endoscope is the camera pedal's."""
    described = {name: one.description for name, one in engine.components.items()}
    tools = {d.slave: name for name, d in reversed(described.items()) if d.kind == "psm"}
    if arm not in tools:
        raise InputError(f"--arm: got {arm!r}; allowed: {', '.join(reversed(tools))}")
    return tools[arm]


def status(engine: Teleoperation, scale: float = 1.0) -> str:
    """Return a line for each selected component: its state, and its last message, as HTML.

    Args:
        engine: its components
        scale: of the speeds that move the masters
    """
    found: list[str] = []
    for name in engine.console.selected:
        one = engine.components[name]
        follows = ", follows" if one.following else ", clutch" if one.clutched else ""
        if isinstance(one, PsmTeleoperation) and one.feedback is not None and one.following:
            size, energy = float(np.linalg.norm(one.feedback.force)), one.feedback.passivity.energy
            follows += f", {size:.2f} N at the hand, {1e3 * energy:.1f} mJ"
        colour = COLOURS.get(one.current, "#e67700")
        found.append(
            f'<div><b>{escape(name)}</b> <span style="color:{colour}">{one.current}{follows}</span>'
            f' <span style="opacity:.65">scale {scale * one.scale:g}</span></div>'
            + (f'<div style="opacity:.75">{escape(one.message)}</div>' if one.message else "")
        )
    return f'<div data-trocar="teleop" style="font-size:.9em;padding:0 11px">{"".join(found)}</div>'
