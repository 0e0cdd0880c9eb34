"""The tables of numbers: time and health of the simulation, and every joint of the chosen arm."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import viser

from trocar.interfaces.state import LoopState
from trocar.interfaces.viewer.sheet import ArmSheet

if TYPE_CHECKING:
    from trocar.simulation.records import ArmSnapshot, Health

WANDERS_M = 1e-6
"""From here on a robot's own geometry is said to move its remote centre."""

KEPT = 3
"""How many warnings stay in sight."""

STYLE = """<style>
.trocar { font-size: 12.5px; padding: 1px 14px 3px 10px; font-variant-numeric: tabular-nums; }
.trocar table { width: 100%; border-collapse: collapse; }
.trocar th { text-align: right; font-weight: 500; opacity: .6; padding: 2px 3px; }
.trocar td { text-align: right; padding: 1.5px 3px; white-space: nowrap; }
.trocar th:first-child, .trocar td:first-child { text-align: left; }
.trocar tr + tr td { border-top: 1px solid rgba(128, 128, 128, .18); }
.trocar .cards { display: grid; grid-template-columns: repeat(3, 1fr); gap: 5px; }
.trocar .card { background: rgba(128, 128, 128, .09); border-radius: 4px; padding: 2px 7px; }
.trocar .card span { display: block; font-size: 11px; opacity: .62; white-space: nowrap; }
.trocar .card b { font-size: 15.5px; font-weight: 600; white-space: nowrap; }
.trocar b.good { color: #2b8a3e; } .trocar b.bad { color: #e03131; }
.trocar .note { border-left: 3px solid #f08c00; padding: 1px 6px; margin: 3px 0; }
.trocar .note.bad { border-color: #e03131; font-weight: 600; }
</style>"""


class Notices(logging.Handler):
    """Keep the last warnings of the simulation for the page."""

    def __init__(self) -> None:
        super().__init__(level=logging.WARNING)
        self._kept: deque[str] = deque(maxlen=KEPT)
        self.count = 0

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen to the simulation's log while the `with` block lasts."""
        log = logging.getLogger("trocar")
        log.addHandler(self)
        try:
            yield
        finally:
            log.removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning."""
        self.count += 1
        self._kept.append(record.getMessage())

    @property
    def newest_first(self) -> tuple[str, ...]:
        """The last messages."""
        return tuple(reversed(tuple(self._kept)))


class StatusTables:
    """Tables inside the GUI container that is open."""

    def __init__(self, gui: viser.GuiApi, notices: Notices) -> None:
        self._notices = notices
        self._worst = {"gap": 0.0, "rcm": 0.0}
        self._simulation = gui.add_html(STYLE)
        self._joints = gui.add_html("")
        self._messages = gui.add_html("")
        self._failure = ""
        self.note: Callable[[], str] | None = None

    def show(self, state: LoopState, sheet: ArmSheet) -> None:
        """Write the newest numbers."""
        health = state.health
        if state.snapshot.time < 0.5:
            self._worst = {"gap": 0.0, "rcm": 0.0}
        self._worst["gap"] = max(self._worst["gap"], health.loop_gap_m)
        self._worst["rcm"] = max(self._worst["rcm"], health.rcm_error_m)
        cards = simulation_cards(state, self._worst["gap"], self._worst["rcm"])
        self._simulation.content = STYLE + _box(cards + (self.note() if self.note else ""))
        self._joints.content = _box(joint_table(sheet, state.snapshot.arms[sheet.name]))
        self._messages.content = _box(self._failure + _notes(self._notices))

    def fail(self, error: Exception) -> None:
        """Say what stopped the simulation."""
        self._failure = f'<div class="note bad" data-trocar="failure">{escape(str(error))}</div>'
        self._messages.content = _box(self._failure + _notes(self._notices))


def simulation_cards(state: LoopState, gap_max_m: float, rcm_max_m: float) -> str:
    """Write time, speed and the health of the linkages."""
    health = state.health
    speed = "paused" if state.paused else f"{state.real_time_factor:.2f}"
    margin = _degrees(health.flattening_margin_rad)
    cards = (
        ("time", "simulated", f"{state.snapshot.time:.2f} s", ""),
        ("rtf", "real-time factor", speed, ""),
        ("branch", "linkage branches", "ok" if health.branch_ok else "flipped", ""),
        ("gap", "loop gap", f"{_micro(health.loop_gap_m)} &micro;m", f"max {_micro(gap_max_m)}"),
        (
            "rcm",
            "RCM error",
            f"{_micro(health.rcm_error_m)} &micro;m",
            _rcm_note(health, rcm_max_m),
        ),
        ("margin", "from flattening", margin, "joint range"),
    )
    look = {"branch": "good" if health.branch_ok else "bad"}
    body = "".join(
        f'<div class="card"><span>{name}</span>'
        f'<b class="{look.get(key, "")}" data-trocar="{key}">{value}</b><span>{more}</span></div>'
        for key, name, value, more in cards
    )
    return f'<div class="cards">{body}</div>'


def _rcm_note(health: Health, rcm_max_m: float) -> str:
    """Write the worst so far, and how much of it a calibrated robot's own geometry accounts for."""
    if health.rcm_wander_m < WANDERS_M:
        return f"max {_micro(rcm_max_m)}"
    return f"max {_micro(rcm_max_m)}; its own geometry: up to {_micro(health.rcm_wander_m)}"


def joint_table(sheet: ArmSheet, arm: ArmSnapshot) -> str:
    """Write what is commanded and measured of every joint."""
    head = "".join(f"<th>{text}</th>" for text in ("", "measured", "command", "error", "effort"))
    rows = "".join(_joint_row(sheet, arm, k) for k in range(len(sheet.joints)))
    return f"<table><tr>{head}</tr>{rows}</table>"


def _joint_row(sheet: ArmSheet, arm: ArmSnapshot, k: int) -> str:
    joint, followed = sheet.joints[k], arm.modes[k] != "effort"
    measured, command = arm.q[k] * joint.unit.scale, arm.setpoint[k] * joint.unit.scale
    values = {
        "measured": _number(measured, 2),
        "command": _number(command, 2) if followed else "-",
        "error": _number(measured - command, 3) if followed else "-",
        "effort": f"{_number(arm.effort[k], 2)} {joint.unit.effort_text}",
    }
    cells = "".join(
        f'<td data-trocar="{escape(sheet.name)}/{escape(joint.name)}/{key}">{value}</td>'
        for key, value in values.items()
    )
    return f"<tr><td>{escape(joint.name)} [{joint.unit.text}]</td>{cells}</tr>"


def _number(value: float, digits: int) -> str:
    return f"{round(float(value), digits) + 0.0:.{digits}f}"  # never "-0.00"


def _notes(notices: Notices) -> str:
    return "".join(f'<div class="note">{escape(text)}</div>' for text in notices.newest_first)


def _micro(metres: float) -> str:
    return f"{metres * 1e6:.3f}"


def _degrees(angle: float) -> str:
    return f"{np.rad2deg(angle):.1f} deg" if np.isfinite(angle) else "no loops"


def _box(content: str) -> str:
    return f'<div class="trocar">{content}</div>'
