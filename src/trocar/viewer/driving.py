"""The tab for hands: keys and a gamepad that drive, handles that carry masters, pedals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from json import dumps
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from trocar.geometry.se3 import transform
from trocar.viewer.panel import Setting

Floats = NDArray[np.float64]

HEIGHT_PX = 300
"""Height of the frame that takes keys. Source: chosen by eye: its table needs no scrolling."""

HANDLE_M = 0.14
"""Size of a master's handle [m]. Source: chosen by eye, a hand's width."""

EVERY = 6
"""Refreshes between two updates of text and switches: five a second can still be read."""


@dataclass(frozen=True)
class Pedal:
    """A pedal or a switch that the page presses.

    Attributes:
        label: of its box
        press: called with True when it is pressed, with False when it is released
        pressed: returns whether it is pressed now, on the page or elsewhere
        key: letter that presses and releases it anywhere in the page; "": none
    """

    label: str
    press: Callable[[bool], object]
    pressed: Callable[[], bool]
    key: str = ""


@dataclass(frozen=True)
class Driving:
    """The controls that the page offers to hands.

    Attributes:
        title: of the tab
        tables: {device: (key or stick, effect)}; the first is open; none: the page has pedals only,
            in a tab behind the measurements
        status: returns HTML with the state of what is driven
        websocket: address to which the page sends keys and gamepads; None: it takes none
        keys, gamepad: topics of the two
        pedals: in the order of their boxes
        handles: arms whose tips can be dragged
        carry: called with an arm and the pose its tip is dragged to, T_world_tip (4, 4)
        let_go: called with the arm when dragging ends
    """

    title: str
    tables: Mapping[str, Sequence[tuple[str, str]]]
    status: Callable[[], str]
    websocket: str | None = None
    keys: str = ""
    gamepad: str = ""
    pedals: Sequence[Pedal] = ()
    handles: Sequence[str] = ()
    carry: Callable[[str, Floats], object] | None = None
    let_go: Callable[[str], object] | None = None


class DrivingTab:
    """The tab, and the handles in the scene; made and refreshed in viser's thread.

    Args:
        browser: has the widgets, of which the tab is the container that is open, and the scene
        driving: the controls
        nonce: of the scripts that may run; "": none that sends keys
        blocked: returns the reason that keeps this browser from driving; "" for none
    """

    def __init__(
        self,
        browser: viser.ClientHandle | viser.ViserServer,
        driving: Driving,
        nonce: str,
        blocked: Callable[[], str] = lambda: "",
    ) -> None:
        self._driving, self._blocked = driving, blocked
        self._refreshes, self._status = 0, ""
        gui = browser.gui
        self._text = gui.add_html("")
        self._pedals = [(pedal, self._pedal(gui, pedal)) for pedal in driving.pedals]
        gui.add_html(_frame(driving, nonce) if driving.websocket and nonce else _tables(driving))
        self._dragged: set[str] = set()
        self._handles = {name: self._handle(browser.scene, name) for name in driving.handles}

    def show(self, tips: Mapping[str, Floats]) -> None:
        """Refresh; handles that are not dragged go to their tips, {arm: T_world_tip (4, 4)}."""
        if self._refreshes % EVERY == 0:
            status = self._driving.status()
            if status != self._status:
                self._status = status
                self._text.content = f'<div style="padding-bottom:6px">{status}</div>'
            for pedal, setting in self._pedals:
                setting.show(pedal.pressed())
                if setting.handle.disabled != bool(self._blocked()):
                    setting.handle.disabled = bool(self._blocked())
        self._refreshes += 1
        for name, node in self._handles.items():
            if name in tips and name not in self._dragged:
                tip = tips[name]
                node.position, node.wxyz = tip[:3, 3], quaternion_from_matrix(tip[:3, :3])

    def remove(self) -> None:
        """Take the handles out of the scene."""
        for node in self._handles.values():
            node.remove()

    def _handle(self, scene: viser.SceneApi, name: str) -> viser.TransformControlsHandle:
        """Add rings and arrows at a master's tip; dragging them carries the master."""
        node = scene.add_transform_controls(f"/hands/{name}", scale=HANDLE_M, depth_test=False)

        @node.on_update
        async def _(event: Any) -> None:
            if event.phase == "end" or self._blocked():
                if name in self._dragged and self._driving.let_go is not None:
                    self._driving.let_go(name)
                self._dragged.discard(name)
                return
            self._dragged.add(name)
            if event.phase == "update" and self._driving.carry is not None:
                R = matrix_from_quaternion(np.array(node.wxyz, dtype=np.float64))
                self._driving.carry(name, transform(R, np.array(node.position, dtype=np.float64)))

        return node

    def _pedal(self, gui: viser.GuiApi, pedal: Pedal) -> Setting[bool]:
        """Add a pedal's box, and its key, which presses and releases in turn."""
        key: Any = pedal.key or None
        label = f"{pedal.label} ({key})" if key else pedal.label
        box = gui.add_checkbox(label, pedal.pressed(), disabled=bool(self._blocked()))
        setting = Setting[bool](box, pedal.press)
        command = gui.add_command(f"Pedal: {pedal.label}", hotkey=key)

        @command.on_trigger
        async def _(_: Any) -> None:
            if self._blocked():
                return
            on = not setting.handle.value
            setting.handle.value = on
            setting.touch(on)

        return setting


def _tables(driving: Driving) -> str:
    """Return every table; those after the first are folded."""
    (_, first), *others = driving.tables.items() or [("", ())]
    folded = (
        f"<details><summary>{escape(name)}</summary>{_table(lines)}</details>"
        for name, lines in others
    )
    return _table(first) + "".join(folded)


def _table(lines: Sequence[tuple[str, str]]) -> str:
    rows = "".join(f"<tr><td>{escape(a)}</td><td>{escape(b)}</td></tr>" for a, b in lines)
    return (
        '<table data-trocar="mapping"'
        ' style="font-size:.92em;line-height:1.45;border-spacing:10px 0">'
        f"{rows}</table>"
    )


def _frame(driving: Driving, nonce: str) -> str:
    """Return an inner frame, which takes keys only while it has the focus."""
    page = files("trocar.viewer").joinpath("driving.html").read_text(encoding="utf-8")
    settings = {
        "url": driving.websocket,
        "keys": f"/{driving.keys}",
        "gamepad": f"/{driving.gamepad}",
    }
    page = page.replace("{{TABLE}}", _tables(driving)).replace("{{SETTINGS}}", dumps(settings))
    page = page.replace("{{NONCE}}", nonce)
    return (
        f'<iframe data-trocar="keys" title="keys" allow="gamepad" srcdoc="{escape(page)}"'
        f' style="width:100%;height:{HEIGHT_PX}px;border:0;border-radius:6px"></iframe>'
    )
