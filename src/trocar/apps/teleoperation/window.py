"""What the page shows and offers of teleoperation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from html import escape

from trocar.apps.teleoperation.device import Device
from trocar.apps.teleoperation.engine import Teleoperation
from trocar.apps.teleoperation.inputs import KEYS, PAD
from trocar.apps.teleoperation.mapping import TABLES, Line
from trocar.apps.teleoperation.states import DISABLED, ENABLED
from trocar.interfaces.viewer import Driving

COLOURS = {DISABLED: "#868e96", ENABLED: "#2b8a3e"}


def driving_by_device(device: Device, kind: str, websocket: str | None) -> Driving:
    """Return the tab of a keyboard, a gamepad or a puck.

    Args:
        device: what is driven
        kind: which table is shown
        websocket: where the page sends keys to; None: the device is not in the page
    """
    tables = ("keyboard", "gamepad") if websocket else (kind,)
    return Driving(
        "Drive",
        {table: _rows(TABLES[table]) for table in tables},
        partial(_said, device.engine, device.master.scale),
        websocket,
        KEYS,
        PAD,
        {"Clutch": _switch(device.engine, device.engine.console.press_clutch)},
    )


def driving_by_masters(engine: Teleoperation) -> Driving:
    """Return the tab of simulated masters: handles to carry them, and pedals."""
    console = engine.console
    return Driving(
        "Masters",
        {"masters": _rows(TABLES["masters"])},
        partial(_said, engine),
        pedals={
            "Teleoperation on": _switch(engine, console.enable),
            "Operator present": _switch(engine, console.see_operator),
            "Clutch": _switch(engine, console.press_clutch),
            "Camera pedal": _switch(engine, console.press_camera),
        },
        pressed={"Teleoperation on": console.enabled, "Operator present": console.present},
        handles=tuple(engine.carriers),
        carry=lambda name, T: engine.ask(partial(engine.carriers[name].carry, T)),
        let_go=lambda name: engine.ask(engine.carriers[name].let_go),
    )


def _switch(engine: Teleoperation, act: Callable[[bool], object]) -> Callable[[bool], object]:
    return lambda on: engine.ask(partial(act, on))


def _rows(lines: Sequence[Line]) -> list[tuple[str, str]]:
    return [(line.touch, line.does) for line in lines]


def _said(engine: Teleoperation, scale: float = 1.0) -> str:
    """Return a line for each component that is selected: its state, and what was said last.

    Args:
        engine: its components
        scale: of what moves the masters
    """
    console = engine.console
    found: list[str] = []
    for name in console.selected:
        one = engine.components[name]
        follows = ", follows" if one.following else ", clutch" if one.clutched else ""
        colour = COLOURS.get(one.current, "#e67700")
        found.append(
            f'<div><b>{escape(name)}</b> <span style="color:{colour}">{one.current}{follows}</span>'
            f' <span style="opacity:.65">scale {scale * one.scale:g}</span></div>'
            + (f'<div style="opacity:.75">{escape(one.said)}</div>' if one.said else "")
        )
    return f'<div data-trocar="teleop" style="font-size:.9em;padding:0 11px">{"".join(found)}</div>'
