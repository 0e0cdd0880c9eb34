"""Keyboards, gamepads and SpaceMice: what their keys, sticks and buttons command."""

from __future__ import annotations

import logging
import os
import struct
import threading
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from math import radians
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, MissingExtraError

Array = NDArray[np.float64]

_log = logging.getLogger("trocar")

#: Of the tip while a key is held. Source: our own choice: a block of the pegs is crossed in two
#: seconds, and a tap moves less than a millimetre. [m/s, rad/s]
SPEED, TURN = 0.01, radians(30.0)
#: Of the gripper. Source: our own choice: shut from wide open in a second. [rad/s]
GRIP = radians(60.0)
#: Speed factors of the slow and the fast key. Source: our own choice.
FINE, FAST = 0.2, 3.0
#: Of a stick or a cap that is pushed as far as it goes, which has no key to be faster. Source: our
#: own choice, half way from usual to fast.
STICK = FAST**0.5


@dataclass(frozen=True)
class DeviceCommand:
    """Speeds and choices that a device without a pose commands.

    Attributes:
        move: of the tip: right, up, away, -1 to 1 each
        turn: about the same axes, as a screw is turned to move along them, -1 to 1 each
        grip: above 0 opens, -1 to 1
        pace: factor of all speeds
        tool: which instrument to use from now on, counted from 1; 0: the same
        step: by how many instruments to go on from the one that is used
        camera: whether the endoscope is dragged in place of a tool
        pedals: names of the pedals that are pressed, beside the camera's
    """

    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    grip: float = 0.0
    pace: float = 1.0
    tool: int = 0
    step: int = 0
    camera: bool = False
    pedals: frozenset[str] = frozenset()

    @property
    def linear(self) -> Array:
        """Velocity as the surgeon's frame has it: x left, y up, z away, (3,) [m/s]."""
        right, up, away = self.move
        return self.pace * SPEED * np.array([-right, up, away])

    @property
    def angular(self) -> Array:
        """Angular velocity in the same axes, (3,) [rad/s]."""
        right, up, away = self.turn
        return self.pace * TURN * np.array([-right, up, away])

    @property
    def opening(self) -> float:
        """Opening speed of the gripper [rad/s]."""
        return self.pace * GRIP * self.grip


STILL = DeviceCommand()

#: {key as a browser calls its place: (which of a drive, index, by how much)}. Source: KeyboardEvent
#: code values of W3C UI Events, which name places and not letters.
AXES = {
    "KeyD": ("move", 0, 1.0),
    "KeyA": ("move", 0, -1.0),
    "KeyW": ("move", 1, 1.0),
    "KeyS": ("move", 1, -1.0),
    "KeyR": ("move", 2, 1.0),
    "KeyF": ("move", 2, -1.0),
    "ArrowUp": ("turn", 0, 1.0),
    "ArrowDown": ("turn", 0, -1.0),
    "ArrowLeft": ("turn", 1, 1.0),
    "ArrowRight": ("turn", 1, -1.0),
    "KeyE": ("turn", 2, 1.0),
    "KeyQ": ("turn", 2, -1.0),
    "KeyO": ("grip", 0, 1.0),
    "KeyC": ("grip", 0, -1.0),
}
TOOLS = {f"Digit{k}": k for k in range(1, 10)}
FINE_KEYS, FAST_KEYS = {"KeyX"}, {"ShiftLeft", "ShiftRight"}
#: {pedal: its letter}: held in the frame of the page that takes keys, and anywhere else in the page
#: pressed and released in turn. Source: our own choice: letters that drive nothing.
PEDAL_KEYS = {
    "clutch": "K",
    "camera": "V",
    "coag": "G",
    "bicoag": "B",
    "mono": "M",
    "cam_minus": "Y",
    "cam_plus": "U",
    "operator_present": "P",
}

#: A stick that is moved less is at rest. Source: our own choice; sticks come back that far. [0..1]
DEAD = 0.12


@dataclass(frozen=True)
class DeviceBinding:
    """A line of a table: key, stick or button, and its effect."""

    touch: str
    does: str


KEYBOARD = (
    DeviceBinding("A  D", "left, right"),
    DeviceBinding("W  S", "up, down"),
    DeviceBinding("R  F", "away, closer"),
    DeviceBinding("arrows", "turn up, down, left, right"),
    DeviceBinding("Q  E", "roll left, right"),
    DeviceBinding("C  O", "close, open the jaw"),
    DeviceBinding("X (held)", f"fine: {FINE:g} of the speed"),
    DeviceBinding("Shift (held)", f"fast: {FAST:g} times the speed"),
    DeviceBinding("1  2 ...", "select the first, second ... instrument"),
    DeviceBinding("V (held)", "camera pedal: move the endoscope instead"),
    DeviceBinding("K (held)", "clutch: hold the tool"),
    DeviceBinding("G  B  M (held)", "pedals coag, bicoag, mono"),
    DeviceBinding("Y  U (held)", "pedals cam -, cam +"),
)
GAMEPAD = (
    DeviceBinding("left stick", "left, right, up, down"),
    DeviceBinding("right, left trigger", "away, closer"),
    DeviceBinding("right stick", "turn left, right, up, down"),
    DeviceBinding("left, right shoulder", "roll left, right"),
    DeviceBinding("A  B", "close, open the jaw"),
    DeviceBinding("X (held)", f"fine: {FINE:g} of the speed"),
    DeviceBinding("Y (held)", "move the endoscope instead"),
    DeviceBinding("left, right on the D-pad", "select the previous, next instrument"),
)
SPACEMOUSE = (
    DeviceBinding("push the cap", "left, right, up, down, away, closer"),
    DeviceBinding("turn the cap", "turn about the same axes"),
    DeviceBinding("left, right button", "close, open the jaw"),
)
MASTERS = (
    DeviceBinding("rings and arrows", "drag the simulated masters in the web viewer"),
    DeviceBinding("gripper sliders", "pinch to start teleoperation; the jaw follows"),
    DeviceBinding("K  V  G  B  M  Y  U  P", "press and release pedals, as labelled"),
)
TABLES = {
    "keyboard": KEYBOARD,
    "gamepad": GAMEPAD,
    "spacemouse": SPACEMOUSE,
    "masters": MASTERS,
}


def table(device: str, instruments: Sequence[str]) -> list[DeviceBinding]:
    """Return the table of a device for a rig with these instruments, one or more."""
    lines: list[DeviceBinding] = []
    for line in TABLES[device]:
        if "instrument" not in line.does:
            lines.append(line)
        elif len(instruments) > 1 and device == "keyboard":
            keys = "  ".join(str(k + 1) for k in range(len(instruments)))
            lines.append(DeviceBinding(keys, f"select {', '.join(instruments)}"))
        elif len(instruments) > 1:
            lines.append(line)
    return lines


def from_keys(held: Collection[str]) -> DeviceCommand:
    """Return the command of the keys that are held; others do nothing."""
    sums = {"move": [0.0] * 3, "turn": [0.0] * 3, "grip": [0.0]}
    for key in held:
        if key in AXES:
            which, index, by = AXES[key]
            sums[which][index] += by
    pace = FINE if FINE_KEYS & set(held) else FAST if FAST_KEYS & set(held) else 1.0
    tool = next((TOOLS[key] for key in sorted(held) if key in TOOLS), 0)
    move, turn = (tuple(sums[which]) for which in ("move", "turn"))
    pedals = frozenset(name for name, key in PEDAL_KEYS.items() if f"Key{key}" in held)
    own = pedals - {"camera", "operator_present"}  # who holds keys is the operator
    camera = "camera" in pedals
    return DeviceCommand(move, turn, sums["grip"][0], pace, tool, 0, camera, own)  # type: ignore[arg-type]  three each


def from_pad(axes: Sequence[float], buttons: Sequence[float]) -> DeviceCommand:
    """Return the command of a gamepad.

    Args:
        axes, buttons: in the standard layout, -1 to 1 (down is above 0), and 0 to 1; how far the
            left and the right trigger are pulled may follow the four axes of the sticks. Source:
            W3C Gamepad, "standard gamepad"
    """

    def axis(index: int) -> float:
        return _beyond_rest(axes[index]) if index < len(axes) else 0.0

    def pressed(index: int) -> float:
        return min(max(buttons[index], 0.0), 1.0) if index < len(buttons) else 0.0

    def pulled(trigger: int) -> float:
        return axis(4 + trigger) if len(axes) >= 6 else _beyond_rest(pressed(6 + trigger))

    return DeviceCommand(
        move=(axis(0), -axis(1), pulled(1) - pulled(0)),
        turn=(-axis(3), -axis(2), pressed(5) - pressed(4)),
        grip=pressed(1) - pressed(0),
        pace=STICK * (FINE if pressed(2) > 0.5 else 1.0),
        step=int(pressed(15) > 0.5) - int(pressed(14) > 0.5),
        camera=pressed(3) > 0.5,
    )


def from_spacemouse(
    push: Sequence[float], turn: Sequence[float], buttons: Sequence[bool]
) -> DeviceCommand:
    """Return the command of a SpaceMouse.

    Args:
        push, turn: right, towards the hand, down; -1 to 1 each. Source: 3Dconnexion's
            reports
        buttons: left, right
    """
    soft: Callable[[float], float] = lambda v: min(max(_beyond_rest(v), -1.0), 1.0)  # noqa: E731
    right, near, down = (soft(v) for v in push)
    about_right, about_near, about_down = (soft(v) for v in turn)
    left_button, right_button = (*buttons, False, False)[:2]
    return DeviceCommand(
        move=(right, -down, -near),
        turn=(about_right, -about_down, -about_near),
        grip=float(right_button) - float(left_button),
        pace=STICK,
    )


def _beyond_rest(value: float) -> float:
    """Return a stick's deflection, gentle about its middle."""
    size = max(0.0, abs(value) - DEAD) / (1.0 - DEAD)
    return min(size, 1.0) ** 2 * (1.0 if value > 0.0 else -1.0)


class Source(Protocol):
    """A device that this machine reads itself; used in one thread."""

    def open(self) -> None:
        """Open the device, if it is there.

        Raises:
            OSError: it is there and cannot be used
        """
        ...

    def poll(self) -> DeviceCommand | None:
        """Return its command now, None while it is not there.

        Raises:
            OSError: it is there and cannot be used
        """
        ...

    def close(self) -> None:
        """Close the device."""
        ...


#: Full deflection of SDL's axes. Source: SDL_GameController.
AXIS_FULL = 32767.0
#: SDL's buttons in the order of the standard layout, None for the triggers, which are axes.
#: Source: SDL_GameControllerButton (A 0, B 1, X 2, Y 3, back 4, start 6, sticks 7 and 8, shoulders
#: 9 and 10, cross 11 to 14); W3C Gamepad.
BUTTONS = (0, 1, 2, 3, 9, 10, None, None, 4, 6, 7, 8, 11, 12, 13, 14)
STICKS, TRIGGERS = (0, 1, 2, 3), (4, 5)


class Gamepad:
    """The first gamepad of SDL; an unplugged one may come back.

    Raises:
        MissingExtraError: the library is not installed
        InputError: no gamepad is plugged in, or SDL cannot use it
    """

    def __init__(self) -> None:
        if find_spec("pygame") is None:
            raise MissingExtraError("pygame", "gamepad", "--device gamepad")
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
        self._sdl: Any = import_module("pygame._sdl2.controller")
        self._pygame: Any = import_module("pygame")
        self._one: Any = None
        try:
            self.open()
        except OSError as problem:
            raise InputError(
                f"--device gamepad: SDL cannot open it ({problem}); reconnect it, or use "
                "--device keyboard, which reads gamepads in the browser"
            ) from problem
        if self._one is None:
            raise InputError(
                "--device gamepad: no gamepad found; try "
                "--device keyboard, which reads gamepads in the browser"
            )
        self.close()

    def open(self) -> None:
        """Open the first one that is there.

        Raises:
            OSError: SDL cannot use it
        """
        try:
            self._pygame.display.init()
            self._sdl.init()
            self._find()
        except self._pygame.error as problem:
            raise OSError(str(problem)) from problem

    def poll(self) -> DeviceCommand | None:
        """Return the command of sticks and buttons; None while it is unplugged.

        Raises:
            OSError: SDL cannot read it, as in the moment in which it is unplugged
        """
        try:
            return self._read()
        except self._pygame.error as problem:
            raise OSError(str(problem)) from problem

    def close(self) -> None:
        """Close it."""
        self._one = None
        self._sdl.quit()

    def _read(self) -> DeviceCommand | None:
        self._pygame.event.pump()
        if self._one is None or not self._one.attached():
            self._find()
        if self._one is None:
            return None
        axes = [self._one.get_axis(index) / AXIS_FULL for index in (*STICKS, *TRIGGERS)]
        buttons = [0.0 if b is None else float(self._one.get_button(b)) for b in BUTTONS]
        return from_pad(axes, buttons)

    def _find(self) -> None:
        self._one = None
        for index in range(self._sdl.get_count()):
            if self._sdl.is_controller(index):
                self._one = self._sdl.Controller(index)
                return


#: (vendor, products; None: all of it). Source: usb.ids: Logitech made the older ones.
KNOWN = ((0x256F, None), (0x046D, (0xC603, 0xC605, 0xC606, 0xC621, 0xC623, 0xC625, 0xC626, 0xC627,
                                   0xC628, 0xC629, 0xC62B)))  # fmt: skip
#: Generic desktop, multi-axis controller. Source: HID Usage Tables.
USAGE_PAGE, USAGE = 0x01, 0x08
#: Report of a cap that is pushed or turned as far as it goes. Source: 3Dconnexion: about 350.
CAP_FULL = 350.0
#: Reports: pushed, turned, buttons; some devices put all six numbers into the first.
PUSHED, TURNED, PRESSED = 1, 2, 3
READS = 32


class SpaceMouse:
    """The first six-axis controller (3Dconnexion's SpaceMouse and its like) that is plugged in.

    Raises:
        MissingExtraError: the library is not installed
        InputError: none is plugged in, or it cannot be opened
    """

    def __init__(self) -> None:
        if find_spec("hid") is None:
            raise MissingExtraError("hidapi", "spacemouse", "--device spacemouse")
        self._hid: Any = import_module("hid")
        self._device: Any = None
        self._push, self._turn = (0.0,) * 3, (0.0,) * 3
        self._buttons = (False, False)
        try:
            self.open()
        except OSError as problem:
            raise InputError(
                f"--device spacemouse: cannot be opened ({problem}); grant this "
                "user access (Linux: a udev rule for hidraw), and close other programs that use it"
            ) from problem
        if self._device is None:
            raise InputError(
                "--device spacemouse: none found, or no read access (Linux: a udev rule for hidraw)"
            )
        self.close()  # the polling thread opens it again

    def open(self) -> None:
        """Open it, if it is there.

        Raises:
            OSError: it is there and cannot be opened
        """
        path = self._path()
        if path is None:
            return
        device = self._hid.device()
        device.open_path(path)
        device.set_nonblocking(True)
        self._device = device

    def poll(self) -> DeviceCommand | None:
        """Return the command of cap and buttons; None while it is unplugged.

        Raises:
            OSError: it was plugged in again and cannot be opened
        """
        if self._device is None:
            self.open()
        if self._device is None:
            return None
        try:
            for _ in range(READS):
                report = bytes(self._device.read(64))
                if not report:
                    break
                self.parse(report)
        except OSError:  # unplugged
            self.close()
            return None
        return from_spacemouse(self._push, self._turn, self._buttons)

    def parse(self, report: bytes) -> None:
        """Read a report: its number, then little-endian words of 16 bits."""
        kind, data = report[0], report[1:]
        if kind == PUSHED and len(data) >= 12:
            self._push, self._turn = _triple(data[:6]), _triple(data[6:12])
        elif kind == PUSHED and len(data) >= 6:
            self._push = _triple(data)
        elif kind == TURNED and len(data) >= 6:
            self._turn = _triple(data)
        elif kind == PRESSED and data:
            self._buttons = bool(data[0] & 1), bool(data[0] & 2)

    def close(self) -> None:
        """Close it."""
        if self._device is not None:
            self._device.close()
        self._device = None
        self._push = self._turn = (0.0,) * 3
        self._buttons = (False, False)

    def _path(self) -> bytes | None:
        for vendor, products in KNOWN:
            for one in self._hid.enumerate(vendor, 0):
                axes = (one.get("usage_page", 0), one.get("usage", 0)) in (
                    (USAGE_PAGE, USAGE),
                    (0, 0),  # some systems do not say
                )
                if axes and (products is None or one["product_id"] in products):
                    return one["path"]
        return None


def _triple(data: bytes) -> tuple[float, float, float]:
    x, y, z = (value / CAP_FULL for value in struct.unpack("<3h", data[:6]))
    return x, y, z


#: {device: its class}, of those that this machine reads itself; the page reads keys, and gamepads
#: that browsers know.
SOURCES: dict[str, Callable[[], Source]] = {"gamepad": Gamepad, "spacemouse": SpaceMouse}

#: Period of polling. Source: our own choice, twice as often as hands tremble. [s]
PERIOD_S = 0.01
#: Period of the search for a device that is unplugged: listing devices takes a system's time.
#: Source: our own choice: short for a person who plugs one in. [s]
RETRY_S = 1.0


class Poll:
    """Poll a device in a thread of its own and hand on its commands.

    While the device is unplugged nothing is handed on. One that is there and cannot be used is
    reported once, until it works again.

    Args:
        source: the device
        receive: called with each command
        wait: waits for some seconds and returns whether to end; tests bring their own
    """

    def __init__(
        self,
        source: Source,
        receive: Callable[[DeviceCommand], object],
        wait: Callable[[float], bool] | None = None,
    ) -> None:
        self._source, self._receive = source, receive
        self._over = threading.Event()
        self._wait = wait or self._over.wait
        self._opened = self._warned = False
        self._thread = threading.Thread(target=self.run, name="trocar-device", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and wait for it."""
        self._over.set()
        self._thread.join(1.0)

    def run(self) -> None:
        """Poll in the calling thread, to the end."""
        pause = PERIOD_S
        try:
            while not self._wait(pause):
                drive = self._poll()
                pause = RETRY_S if drive is None else PERIOD_S
                if drive is not None:
                    self._receive(drive)
        finally:
            self._source.close()

    def _poll(self) -> DeviceCommand | None:
        try:
            if not self._opened:
                self._source.open()
                self._opened = True
            drive = self._source.poll()
        except OSError as problem:
            if not self._warned:
                _log.warning("input device failed: %s; retrying", problem)
            self._warned, self._opened = True, False
            self._source.close()
            return None
        self._warned = self._warned and drive is None
        return drive
