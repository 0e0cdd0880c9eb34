"""The page's part for hands: keys and a gamepad that drive, handles that carry masters, pedals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from json import dumps
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from trocar.geometry.se3 import transform
from trocar.interfaces.viewer.own_thread import when_touched
from trocar.interfaces.viewer.server import LocalServer

Floats = NDArray[np.float64]

HEIGHT_PX = 300
"""Of the part that takes keys. Source: chosen by eye: its table needs no scrolling."""

HANDLE_M = 0.14
"""Size of a master's handle [m]. Source: chosen by eye, a hand's width."""

EVERY = 6
"""Looks between two updates of what is written: five a second can still be read."""


@dataclass(frozen=True)
class Driving:
    """What the page offers to hands.

    Attributes:
        title: of the tab
        tables: {device: (what is touched, what it does)}; the first is open
        websocket: where keys and gamepads are sent to, None: the page takes none
        keys, gamepad: topics that they are sent to
        pedals: {name of a switch: what it does}, and how each stands
        tell: returns HTML that says how things stand
        handles: arms whose tips can be dragged
        carry: called with an arm and where its tip is dragged to, T_world_tip (4, 4)
        let_go: called with the arm when nobody drags any longer
    """

    title: str
    tables: Mapping[str, Sequence[tuple[str, str]]]
    tell: Callable[[], str]
    websocket: str | None = None
    keys: str = ""
    gamepad: str = ""
    pedals: Mapping[str, Callable[[bool], object]] = field(
        default_factory=dict[str, "Callable[[bool], object]"]
    )
    pressed: Mapping[str, bool] = field(default_factory=dict[str, bool])
    handles: Sequence[str] = ()
    carry: Callable[[str, Floats], object] | None = None
    let_go: Callable[[str], object] | None = None


class DrivingTab:
    """The tab, and the handles in the scene; made and refreshed in viser's thread.

    Args:
        server: of the page; the tab is the one that is being filled
        driving: what is offered
    """

    def __init__(self, server: LocalServer, driving: Driving) -> None:
        self._driving = driving
        self._looks, self._said = 0, ""
        gui = server.gui
        self._state = gui.add_html("")
        for name, act in driving.pedals.items():
            box = gui.add_checkbox(name, driving.pressed.get(name, False))
            when_touched(box, act)
        nonce = server.page.nonce
        gui.add_html(_frame(driving, nonce) if driving.websocket else _tables(driving))
        self._handles = Handles(server.scene, driving) if driving.handles else None

    def show(self, tips: Mapping[str, Floats]) -> None:
        """Refresh; `tips` are where the arms' tips are in the world, by name."""
        if self._looks % EVERY == 0:
            said = self._driving.tell()
            if said != self._said:
                self._said = self._state.content = said
        self._looks += 1
        if self._handles is not None:
            self._handles.show(tips)


class Handles:
    """Rings and arrows at masters' tips; who drags one carries the master."""

    def __init__(self, scene: viser.SceneApi, driving: Driving) -> None:
        self._driving = driving
        self._dragged: set[str] = set()
        self._nodes = {name: self._handle(scene, name) for name in driving.handles}

    def show(self, tips: Mapping[str, Floats]) -> None:
        """Move handles to their tips, except those that somebody holds."""
        for name, node in self._nodes.items():
            if name in tips and name not in self._dragged:
                tip = tips[name]
                node.position, node.wxyz = tip[:3, 3], quaternion_from_matrix(tip[:3, :3])

    def _handle(self, scene: viser.SceneApi, name: str) -> viser.TransformControlsHandle:
        node = scene.add_transform_controls(f"/hands/{name}", scale=HANDLE_M, depth_test=False)

        @node.on_update
        async def _(event: Any) -> None:
            if event.phase == "end":
                self._dragged.discard(name)
                if self._driving.let_go is not None:
                    self._driving.let_go(name)
                return
            self._dragged.add(name)
            if event.phase == "update" and self._driving.carry is not None:
                R = matrix_from_quaternion(np.array(node.wxyz, dtype=np.float64))
                self._driving.carry(name, transform(R, np.array(node.position, dtype=np.float64)))

        return node


def _tables(driving: Driving) -> str:
    """Return every table; those after the first open when they are clicked on."""
    (_, first), *others = driving.tables.items()
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
    """Return a frame of its own: it takes the keys while it is clicked on, and no others."""
    page = files("trocar.interfaces.viewer").joinpath("driving.html").read_text(encoding="utf-8")
    told = {
        "url": driving.websocket,
        "keys": f"/{driving.keys}",
        "gamepad": f"/{driving.gamepad}",
    }
    page = page.replace("{{TABLE}}", _tables(driving)).replace("{{TOLD}}", dumps(told))
    page = page.replace("{{NONCE}}", nonce)
    return (
        f'<iframe data-trocar="keys" title="keys" allow="gamepad" srcdoc="{escape(page)}"'
        f' style="width:100%;height:{HEIGHT_PX}px;border:0;border-radius:6px"></iframe>'
    )
