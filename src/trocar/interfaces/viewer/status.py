"""The tables of numbers: time and health of the simulation, and every joint of the chosen arm."""

from __future__ import annotations

import logging
from collections import deque
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import viser

from trocar.interfaces.state import LoopState
from trocar.interfaces.viewer.sheet import ArmSheet

if TYPE_CHECKING:
    from trocar.simulation import ArmSnapshot, Health

KEPT = 4
"""How many warnings stay in sight."""

STYLE = """<style>
.trocar { font-size: 12.5px; padding: 2px 10px 8px; font-variant-numeric: tabular-nums; }
.trocar table { width: 100%; border-collapse: collapse; }
.trocar th { text-align: right; font-weight: 500; opacity: .62; padding: 2px 3px; }
.trocar td { text-align: right; padding: 2px 3px; white-space: nowrap; }
.trocar th:first-child, .trocar td:first-child { text-align: left; }
.trocar tr + tr td { border-top: 1px solid rgba(128, 128, 128, .18); }
.trocar .good { color: #2f9e44; } .trocar .bad { color: #e03131; font-weight: 600; }
.trocar .note { border-left: 3px solid #f08c00; padding: 1px 6px; margin: 3px 0; }
.trocar .note.bad { border-color: #e03131; }
</style>"""


class Notices(logging.Handler):
    """Keep the last warnings of the simulation for the page."""

    def __init__(self) -> None:
        super().__init__(level=logging.WARNING)
        self._kept: deque[str] = deque(maxlen=KEPT)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
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

    def show(self, state: LoopState, sheet: ArmSheet) -> None:
        """Write the newest numbers."""
        health = state.health
        if state.snapshot.time < 0.5:
            self._worst = {"gap": 0.0, "rcm": 0.0}
        self._worst["gap"] = max(self._worst["gap"], health.loop_gap_m)
        self._worst["rcm"] = max(self._worst["rcm"], health.rcm_error_m)
        self._simulation.content = STYLE + _box(
            simulation_table(state, self._worst["gap"], self._worst["rcm"])
        )
        self._joints.content = _box(joint_table(sheet, state.snapshot.arms[sheet.name]))
        self._messages.content = _box(self._failure + _notes(self._notices))

    def fail(self, error: Exception) -> None:
        """Say what stopped the simulation."""
        self._failure = f'<div class="note bad" data-trocar="failure">{escape(str(error))}</div>'
        self._messages.content = _box(self._failure + _notes(self._notices))


def simulation_table(state: LoopState, gap_max_m: float, rcm_max_m: float) -> str:
    """Write time, speed and the health of the linkages."""
    health = state.health
    speed = "paused" if state.paused else f"{state.real_time_factor:.2f}"
    margin = np.rad2deg(health.flattening_margin_rad)
    rows = (
        ("simulated time", "time", f"{state.snapshot.time:.2f} s", ""),
        ("real-time factor", "rtf", speed, ""),
        ("loop gap", "gap", _micro(health.loop_gap_m), f"max {_micro(gap_max_m)}"),
        ("remote centre error", "rcm", _micro(health.rcm_error_m), f"max {_micro(rcm_max_m)}"),
        ("linkage branches", "branch", _branch(health), ""),
        ("from flattening", "margin", f"{margin:.1f} deg", ""),
    )
    body = "".join(
        f'<tr><td>{name}</td><td data-trocar="{key}">{value}</td><td>{more}</td></tr>'
        for name, key, value, more in rows
    )
    return f"<table>{body}</table>"


def joint_table(sheet: ArmSheet, arm: ArmSnapshot) -> str:
    """Write what is commanded and measured of every joint."""
    head = "".join(f"<th>{text}</th>" for text in ("", "measured", "command", "error", "effort"))
    rows = []
    for k, joint in enumerate(sheet.joints):
        unit = joint.unit
        measured, command = arm.q[k] * unit.scale, arm.setpoint[k] * unit.scale
        values = {
            "measured": f"{measured:.2f}",
            "command": "-" if arm.modes[k] == "effort" else f"{command:.2f}",
            "error": "-" if arm.modes[k] == "effort" else f"{measured - command:.3f}",
            "effort": f"{arm.effort[k]:.2f} {unit.effort_text}",
        }
        cells = "".join(
            f'<td data-trocar="{sheet.name}/{joint.name}/{key}">{value}</td>'
            for key, value in values.items()
        )
        rows.append(f"<tr><td>{escape(joint.name)} [{unit.text}]</td>{cells}</tr>")
    return f"<table><tr>{head}</tr>{''.join(rows)}</table>"


def _notes(notices: Notices) -> str:
    return "".join(f'<div class="note">{escape(text)}</div>' for text in notices.newest_first)


def _branch(health: Health) -> str:
    good = health.branch_ok
    return f'<span class="{"good" if good else "bad"}">{"ok" if good else "flipped"}</span>'


def _micro(metres: float) -> str:
    return f"{metres * 1e6:.3f} um" if metres < 1e-6 else f"{metres * 1e6:.2f} um"


def _box(content: str) -> str:
    return f'<div class="trocar">{content}</div>'
