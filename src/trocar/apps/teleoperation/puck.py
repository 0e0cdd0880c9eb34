"""A six-axis puck (3Dconnexion's SpaceMouse and its like) as a HID device."""

from __future__ import annotations

import struct
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from trocar.apps.teleoperation.drive import Drive
from trocar.apps.teleoperation.mapping import from_puck
from trocar.errors import InputError, MissingExtraError

#: (vendor, products; None: all of it). Source: usb.ids: Logitech made the older ones.
KNOWN = ((0x256F, None), (0x046D, (0xC603, 0xC605, 0xC606, 0xC621, 0xC623, 0xC625, 0xC626, 0xC627,
                                   0xC628, 0xC629, 0xC62B)))  # fmt: skip
#: Generic desktop, multi-axis controller. Source: HID Usage Tables.
USAGE_PAGE, USAGE = 0x01, 0x08
#: A cap that is pushed or turned as far as it goes reports this. Source: 3Dconnexion: about 350.
FULL = 350.0
#: Reports: pushed, turned, buttons; some devices put all six numbers into the first.
PUSHED, TURNED, PRESSED = 1, 2, 3
READS = 32


class Puck:
    """The first puck that is plugged in.

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
                f"--device spacemouse: it is plugged in and cannot be opened ({problem}); let this "
                "user read it (Linux: a udev rule for hidraw), and end what else uses it"
            ) from problem
        if self._device is None:
            raise InputError(
                "--device spacemouse: none is plugged in, or this user may not read it "
                "(Linux: a udev rule for hidraw)"
            )
        self.close()  # the thread that reads it opens it again

    def open(self) -> None:
        """Take hold of it, where it is there.

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

    def look(self) -> Drive | None:
        """Return what the cap and the buttons ask for; None while it is unplugged.

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
                self.take(report)
        except OSError:  # unplugged
            self.close()
            return None
        return from_puck(self._push, self._turn, self._buttons)

    def take(self, report: bytes) -> None:
        """Take a report: its number, then little-endian words of 16 bits."""
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
        """Let go."""
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
    x, y, z = (value / FULL for value in struct.unpack("<3h", data[:6]))
    return x, y, z
