"""The measurements: time and health of the simulation, a table and two plots of an arm's joints."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from trocar.live.state import LoopState
from trocar.viewer.help import hint
from trocar.viewer.notices import Notices, html_of
from trocar.viewer.panel import ArmInfo, JointInfo

if TYPE_CHECKING:
    from trocar.simulation.records import ArmSnapshot, Snapshot

Floats = NDArray[np.float64]

WANDERS_M = 1e-6
"""Motion of a remote centre by a robot's own geometry from which the page shows it [m]."""

SPAN_S = 10.0
"""Length of the plots [s of simulated time]. Source: our own choice."""

SAMPLES = 400
"""Most samples kept: the span at 30 refreshes a second, and some."""

COMMANDED, MEASURED, ERROR = "#ffb45c", "#1c6fc4", "#c2255c"
WIDTHS = {COMMANDED: 5.0, MEASURED: 1.6, ERROR: 1.6}
"""Line widths in pixels: the set-point shows behind the measured position."""

TIME = "ago"
"""Name of the time scale; viser changes the range of one called "x"."""

STEPS = 5
"""Approximate number of steps of an axis."""

STYLE = """<style data-trocar="style">
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
.trocar .note time { opacity: .6; font-variant-numeric: tabular-nums; }
.trocar .title, .trocar .who { padding: 2px 0 4px; }
.trocar .who { padding: 4px 0 0; font-weight: 600; }
.trocar .why { border-left: 3px solid #1c6fa4; padding: 1px 6px; margin: 3px 0; }
.trocar .note.bad { border-color: #e03131; font-weight: 600; }
</style>"""


class StatusTables:
    """Tables inside the GUI container that is open.

    Attributes:
        note: returns HTML to show above the table of joints; None: nothing
    """

    def __init__(self, gui: viser.GuiApi, notices: Notices) -> None:
        self._notices = notices
        self._worst_gap = self._worst_rcm = 0.0
        self._simulation = gui.add_html("")
        self.joints = gui.add_html("")
        self.messages = gui.add_html("")
        self._failure = ""
        self.note: Callable[[], str] | None = None

    def show(self, state: LoopState, arm: ArmInfo) -> None:
        """Write the newest numbers."""
        health = state.health
        if state.snapshot.time < 0.5:
            self._worst_gap = self._worst_rcm = 0.0
        self._worst_gap = max(self._worst_gap, health.loop_gap_m)
        self._worst_rcm = max(self._worst_rcm, health.rcm_error_m)
        cards = simulation_cards(state, self._worst_gap, self._worst_rcm)
        self._simulation.content = _box(cards + (self.note() if self.note else ""))
        self.joints.content = _box(joint_table(arm, state.snapshot.arms[arm.name]))
        self._show_messages()

    def fail(self, error: Exception) -> None:
        """Show the error that stopped the simulation."""
        self._failure = f'<div class="note bad" data-trocar="failure">{escape(str(error))}</div>'
        self._show_messages()

    def _show_messages(self) -> None:
        text = _box(self._failure + html_of(self._notices.newest_first))
        if text != self.messages.content:
            self.messages.content = text


def simulation_cards(state: LoopState, gap_max_m: float, rcm_max_m: float) -> str:
    """Write time, speed and the health of the linkages."""
    health = state.health
    speed = "paused" if state.paused else f"{state.real_time_factor:.2f}"
    margin = health.flattening_margin_rad
    rcm = f"max {_micro(rcm_max_m)}"
    if health.rcm_wander_m >= WANDERS_M:  # how much a calibrated robot accounts for itself
        rcm += f"; its own geometry: up to {_micro(health.rcm_wander_m)}"
    cards = (
        ("time", "simulated", f"{state.snapshot.time:.2f} s", ""),
        ("rtf", "real-time factor", speed, ""),
        ("branch", "linkage branches", "ok" if health.branch_ok else "flipped", ""),
        ("gap", "loop gap", f"{_micro(health.loop_gap_m)} &micro;m", f"max {_micro(gap_max_m)}"),
        ("rcm", "RCM error", f"{_micro(health.rcm_error_m)} &micro;m", rcm),
        (
            "margin",
            "from singular",
            f"{np.rad2deg(margin):.1f} deg" if np.isfinite(margin) else "no loops",
            "joint range",
        ),
    )
    look = {"branch": "good" if health.branch_ok else "bad"}
    body = "".join(
        f'<div class="card"><span>{name}</span>'
        f'<b class="{look.get(key, "")}" data-trocar="{key}">{value}</b><span>{more}</span></div>'
        for key, name, value, more in cards
    )
    return f'<div class="cards">{body}</div>'


def joint_table(info: ArmInfo, arm: ArmSnapshot) -> str:
    """Write set-point and measurement of every joint."""
    head = "".join(f"<th>{text}</th>" for text in ("", "measured", "command", "error", "effort"))
    rows = "".join(_joint_row(info, arm, k) for k in range(len(info.joints)))
    return f"<table><tr>{head}</tr>{rows}</table>"


def _joint_row(info: ArmInfo, arm: ArmSnapshot, k: int) -> str:
    joint, followed = info.joints[k], arm.modes[k] != "effort"
    measured, command = arm.q[k] * joint.unit.scale, arm.setpoint[k] * joint.unit.scale
    values = {
        "measured": _number(measured, 2),
        "command": _number(command, 2) if followed else "-",
        "error": _number(measured - command, 3) if followed else "-",
        "effort": f"{_number(arm.effort[k], 2)} {joint.unit.effort_text}",
    }
    cells = "".join(
        f'<td data-trocar="{escape(info.name)}/{escape(joint.name)}/{key}">{value}</td>'
        for key, value in values.items()
    )
    return f"<tr><td>{escape(joint.name)} [{joint.unit.text}]</td>{cells}</tr>"


def _number(value: float, digits: int) -> str:
    return f"{round(float(value), digits) + 0.0:.{digits}f}"  # never "-0.00"


def _micro(metres: float) -> str:
    return f"{metres * 1e6:.3f}"


def _box(content: str) -> str:
    return f'<div class="trocar">{content}</div>'


@dataclass(frozen=True)
class Trace:
    """One joint's recent motion: times before now [s], commanded and measured [rad or m]."""

    ago: Floats
    commanded: Floats
    measured: Floats


class History:
    """The last seconds of every arm's motion, for the plots."""

    def __init__(self) -> None:
        self._kept: deque[Snapshot] = deque(maxlen=SAMPLES)

    def add(self, snapshot: Snapshot) -> None:
        """Keep a snapshot; forget everything when time was set back or a tool was exchanged."""
        last = self._kept[-1] if self._kept else snapshot
        if snapshot.time < last.time or snapshot.build != last.build:
            self._kept.clear()
        if not self._kept or snapshot.time > self._kept[-1].time:
            self._kept.append(snapshot)
        while snapshot.time - self._kept[0].time > SPAN_S:
            self._kept.popleft()

    def trace(self, arm: str, joint: int) -> Trace:
        """Return one joint's motion."""
        times = np.array([snapshot.time for snapshot in self._kept])
        return Trace(
            ago=times - times[-1] if times.size else times,
            commanded=np.array([snapshot.arms[arm].setpoint[joint] for snapshot in self._kept]),
            measured=np.array([snapshot.arms[arm].q[joint] for snapshot in self._kept]),
        )


class JointPlots:
    """A choice of joint and its two plots, inside the GUI container that is open."""

    def __init__(self, gui: viser.GuiApi, arm: ArmInfo) -> None:
        self._names = (arm.name, *(joint.name for joint in arm.joints))
        label = f"Last {SPAN_S:.0f} s of"
        self._choice = gui.add_dropdown(label, self._names[1:], hint=hint(label))
        self._motion = _Plot(gui, (("commanded", COMMANDED), ("measured", MEASURED)), height=150)
        self._error = _Plot(gui, (("measured - commanded", ERROR),), height=115)

    def show(self, history: History, arm: ArmInfo) -> None:
        """Draw the chosen joint of an arm."""
        names = (arm.name, *(joint.name for joint in arm.joints))
        if names != self._names:
            self._names = names
            self._choice.options = names[1:]
            self._choice.value = names[1]
        index = names.index(self._choice.value, 1) - 1
        joint = arm.joints[index]
        trace = history.trace(arm.name, index)
        if trace.ago.size < 2:
            return
        commanded, measured = trace.commanded * joint.unit.scale, trace.measured * joint.unit.scale
        least = _least(joint)
        self._motion.draw(joint.unit.text, trace.ago, (commanded, measured), least=least)
        self._error.draw(joint.unit.text, trace.ago, (measured - commanded,), least=least / 50)


@dataclass(frozen=True)
class Span:
    """The ends of an axis."""

    low: float
    high: float


class _Plot:
    def __init__(self, gui: viser.GuiApi, lines: tuple[tuple[str, str], ...], height: int) -> None:
        self._lines = lines
        self._unit = ""
        self._span = Span(-1.0, 1.0)
        self._handle = gui.add_uplot(
            data=tuple([np.array([-SPAN_S, 0.0])] + [np.zeros(2)] * len(lines)),
            series=self._series(),
            scales=_scales(self._span),
            axes=(uplot.Axis(scale=TIME, size=30), uplot.Axis(size=54)),
            legend=uplot.Legend(show=True, live=False),
            height=height,
            padding=(8, 14, 0, 0),
        )

    def draw(self, unit: str, ago: Floats, lines: tuple[Floats, ...], *, least: float) -> None:
        span = axis_span(np.concatenate(lines), self._span, least)
        if span != self._span:
            self._span = span
            self._handle.scales = _scales(span)
        if unit != self._unit:
            self._unit = unit
            self._handle.series = self._series()
        self._handle.data = (ago, *lines)

    def _series(self) -> tuple[uplot.Series, ...]:
        return (
            uplot.Series(label="s", scale=TIME),
            *(
                uplot.Series(label=f"{text} [{self._unit}]", stroke=colour, width=WIDTHS[colour])
                for text, colour in self._lines
            ),
        )


def axis_span(values: Floats, old: Span, least: float) -> Span:
    """Return the ends of an axis: round numbers around the values, kept while they serve.

    uPlot's own ranges change with every sample, so that the axis trembles.

    Args:
        values: what is to be drawn
        old: the ends so far; kept while the values are inside and fill a fifth of them
        least: smallest height, so that noise is not blown up
    """
    low, high = float(values.min()), float(values.max())
    height = max(high - low, least)
    old_height = old.high - old.low
    if old.low <= low and high <= old.high and least <= old_height < 5 * height:
        return old
    step = 10.0 ** np.ceil(np.log10(height / STEPS))
    step = next(step / part for part in (5, 2, 1) if STEPS * step / part >= height)
    middle = (low + high) / 2
    low, high = min(low, middle - height / 2), max(high, middle + height / 2)
    return Span(float(np.floor(low / step) * step), float(np.ceil(high / step) * step))


def _scales(span: Span) -> dict[str, uplot.Scale]:
    return {
        TIME: uplot.Scale(time=False, range=(-SPAN_S, 0.0)),
        "y": uplot.Scale(range=(span.low, span.high)),
    }


def _least(joint: JointInfo) -> float:
    return 0.02 * (joint.upper - joint.lower) * joint.unit.scale
