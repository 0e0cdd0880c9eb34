"""A page that shows a recording and needs nothing but itself."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trocar.apps.plotting.figure import units_of
from trocar.recording import ArmStates, Recorded
from trocar.simulation.journal import Entry

#: Commands and events that are listed. Source: our own choice.
MOST_ENTRIES = 500
STYLE = """
body { font-family: system-ui, sans-serif; margin: 2rem auto; max-width: 1200px; color: #222; }
table { border-collapse: collapse; font-size: 0.9rem; }
td, th { padding: 0.2rem 0.8rem; border-bottom: 1px solid #ddd; text-align: right; }
td:first-child, th:first-child, .words td { text-align: left; }
svg { width: 100%; height: auto; }
.note { background: #fff3cd; padding: 0.5rem 1rem; }
"""


@dataclass(frozen=True, eq=False)
class Section:
    """One arm of the page: its states, the joints that are shown, and its figure as SVG."""

    states: ArmStates
    which: Sequence[int]
    figure: str


def page(recorded: Recorded, sections: Sequence[Section]) -> str:
    """Return a page about a recording."""
    about = recorded.about
    facts = {
        "rig": about["rig"],
        "simulated": f"{recorded.start:g} to {recorded.end:g} s",
        "period": f"{1e3 * recorded.timestep:g} ms, {recorded.rows} states",
        "written by": f"trocar {about['trocar']}, MuJoCo {about['mujoco']}",
    }
    note = f'<p class="note">{_text(recorded.problem)}</p>' if recorded.problem else ""
    body = "".join(f"<h2>{_text(s.states.arm.name)}</h2>{_table(s)}{s.figure}" for s in sections)
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f"<title>{_text(recorded.file)}</title><style>{STYLE}</style></head><body>"
        f"<h1>{_text(recorded.file)}</h1>{note}"
        + '<table class="words">'
        + "".join(f"<tr><td>{k}</td><td>{_text(v)}</td></tr>" for k, v in facts.items())
        + f"</table>{body}{_entries(recorded.entries)}</body></html>\n"
    )


def _table(section: Section) -> str:
    """Return errors and efforts of each joint, in numbers."""
    states, rows = section.states, ""
    for joint in section.which:
        units = units_of(states.arm.kinds[joint])
        error = units.factors[1] * (states.setpoint[:, joint] - states.position[:, joint])
        effort = states.effort[:, joint]
        cells = (
            states.arm.joints[joint],
            f"{np.sqrt(np.mean(error**2)):.3f} {units.error}",
            f"{np.max(np.abs(error)):.3f} {units.error}",
            f"{np.max(np.abs(effort)):.3f} {units.effort}",
        )
        rows += "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in cells) + "</tr>"
    head = "".join(
        f"<th>{h}</th>" for h in ("joint", "error, RMS", "error, largest", "effort, largest")
    )
    return f"<table><tr>{head}</tr>{rows}</table>"


def _entries(entries: Sequence[Entry]) -> str:
    """Return commands and events, folded away."""
    rows = "".join(
        f"<tr><td>{e.time:.3f} s</td><td>{_text(e.kind)}</td><td>{_text(e.source)}</td>"
        f"<td>{_text(e.name)}</td><td>{_text(_short(e))}</td></tr>"
        for e in entries[:MOST_ENTRIES]
    )
    more = len(entries) - MOST_ENTRIES
    rest = f"<p>and {more} more</p>" if more > 0 else ""
    return (
        f"<h2>Commands and events</h2><details><summary>{len(entries)}</summary>"
        f'<table class="words">{rows}</table>{rest}</details>'
    )


def _short(entry: Entry) -> str:
    said = ", ".join(f"{k} = {v}" for k, v in entry.values.items())
    return said if len(said) <= 160 else f"{said[:157]}..."


def _text(value: str) -> str:
    return html.escape(value)
