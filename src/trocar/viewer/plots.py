"""Plots of any four quantities over the last minute, and the same as CSV."""

from __future__ import annotations

import csv
import io
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from trocar.live.state import LoopState
from trocar.viewer.help import hint
from trocar.viewer.measurements import Span, axis_span
from trocar.viewer.panel import ANGLE, ArmInfo
from trocar.viewer.server import Buttons, when_touched

if TYPE_CHECKING:
    from trocar.simulation.records import ArmSnapshot
    from trocar.viewer.desk import Desk

Floats = NDArray[np.float64]

SPAN_S, PERIOD_S = 60.0, 0.1
"""Simulated time of the plots, and between two samples [s]. Source: our own choice."""

PLOTS, NONE, EXPORT = 4, "none", "Export CSV"
FIRST = 1e9
"""Order of the first list in the folder: below the button, with its plot right after it."""

COLOURS = ("#1c6fc4", "#c2255c", "#2b8a3e", "#e8590c")

QUANTITIES = ("measured", "commanded", "error", "velocity", "effort")


class LastMinute:
    """The readings of all arms in the last minute; one for all browsers."""

    def __init__(self) -> None:
        self._kept: deque[tuple[float, int, Mapping[str, ArmSnapshot]]] = deque()

    def add(self, state: LoopState) -> None:
        """Keep the readings of a state, once a period."""
        now = state.snapshot
        if self._kept and (now.time < self._kept[-1][0] or now.build != self._kept[-1][1]):
            self._kept.clear()
        if not self._kept or now.time >= self._kept[-1][0] + PERIOD_S - 1e-9:
            self._kept.append((now.time, now.build, now.arms))
        while now.time - self._kept[0][0] > SPAN_S:
            self._kept.popleft()

    @property
    def times(self) -> Floats:
        """Times of the samples, (n,) [s]."""
        return np.array([time for time, _, _ in self._kept])

    def values(self, arm: str, joint: int, quantity: str) -> Floats:
        """Return a quantity of a joint, (n,) in SI; NaN of one that the arm lacks without tool."""
        return np.array([_value(arms[arm], joint, quantity) for _, _, arms in self._kept])


class QuantityPlots:
    """The folder of one browser, in the container that is open.

    Args:
        desk: of the browser
        arms: {name: its description}
        last: the readings
    """

    def __init__(self, desk: Desk, arms: Mapping[str, ArmInfo], last: LastMinute) -> None:
        self._desk, self._last = desk, last
        self._columns = {
            f"{arm.name} {joint.name} {quantity}": (arm.name, k, quantity)
            for arm in arms.values()
            for k, joint in enumerate(arm.joints)
            for quantity in QUANTITIES
        }
        self._units = {
            title: _unit(arms[arm], k, quantity)
            for title, (arm, k, quantity) in self._columns.items()
        }
        self._gui: viser.GuiApi = desk.browser.gui
        self._rows: list[tuple[viser.GuiDropdownHandle[str], viser.GuiUplotHandle | None]] = []
        self._spans = [Span(-1.0, 1.0)] * PLOTS
        self._folder = self._gui.add_folder("Plots, 60 s", expand_by_default=False)
        with self._folder:
            Buttons(self._gui, "Last minute", (EXPORT,), self._export, hint("Last minute"))
        self._add()

    def show(self, state: LoopState) -> None:  # noqa: ARG002  as of a folder
        """Draw the chosen quantities."""
        times = self._last.times
        if times.size < 2:
            return
        for number, (choice, plot) in enumerate(self._rows):
            if plot is None or choice.value == NONE:
                continue
            _, scale, least = self._units[choice.value]
            values = scale * self._last.values(*self._columns[choice.value])
            there = values[np.isfinite(values)]
            if not there.size:
                continue
            span = axis_span(there, self._spans[number], least)
            if span != self._spans[number]:
                self._spans[number] = span
                plot.scales = _scales(span)
            plot.data = (times - times[-1], values)

    def close(self) -> None:
        """Do nothing: it has no nodes in the scene."""

    def table(self) -> str:
        """Return the chosen quantities, or all, as CSV: time [s], and one column each in SI."""
        chosen = [choice.value for choice, _ in self._rows if choice.value != NONE]
        titles = chosen or list(self._columns)
        columns = [self._last.values(*self._columns[title]) for title in titles]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["time s", *(f"{t} {_si(self._units[t][0])}" for t in titles)])
        for row in zip(self._last.times, *columns, strict=True):
            writer.writerow([f"{value:.9g}" for value in row])
        return text.getvalue()

    def _export(self, _: str) -> None:
        if isinstance(self._desk.browser, viser.ClientHandle):
            self._desk.browser.send_file_download(
                "last_minute.csv", self.table().encode(), save_immediately=True
            )

    def _add(self) -> None:
        """Add a list of quantities. Hundreds of rows, which a browser makes though none is seen."""
        number = len(self._rows)
        with self._folder:
            choice = self._gui.add_dropdown(
                f"Plot {number + 1}",
                [NONE, *self._columns],
                hint=hint("Plot"),
                order=FIRST + 2 * number,
            )
        self._rows.append((choice, None))
        when_touched(choice, lambda _: self._choose(number))

    def _choose(self, number: int) -> None:
        choice, plot = self._rows[number]
        if plot is not None:
            plot.remove()
            plot = None
        if choice.value != NONE:
            unit = self._units[choice.value][0]
            self._spans[number] = Span(-1.0, 1.0)
            with self._folder:
                plot = self._gui.add_uplot(
                    data=(np.array([-SPAN_S, 0.0]), np.zeros(2)),
                    series=(
                        uplot.Series(label="s", scale="ago"),
                        uplot.Series(
                            label=f"{choice.value} [{unit}]", stroke=COLOURS[number], width=1.6
                        ),
                    ),
                    scales=_scales(self._spans[number]),
                    axes=(uplot.Axis(scale="ago", size=30), uplot.Axis(size=54)),
                    legend=uplot.Legend(show=True, live=False),
                    height=130,
                    padding=(8, 14, 0, 0),
                    order=FIRST + 2 * number + 1,
                )
        self._rows[number] = choice, plot
        if plot is not None and number + 1 == len(self._rows) < PLOTS:
            self._add()


def _value(arm: ArmSnapshot, joint: int, quantity: str) -> float:
    if joint >= len(arm.q):
        return np.nan
    if quantity == "measured":
        return float(arm.q[joint])
    if quantity == "commanded":
        return float(arm.setpoint[joint])
    if quantity == "error":
        return float(arm.q[joint] - arm.setpoint[joint])
    return float((arm.qd if quantity == "velocity" else arm.effort)[joint])


def _unit(arm: ArmInfo, joint: int, quantity: str) -> tuple[str, float, float]:
    """Return a quantity's unit, its scale from SI, and the least height of its axis."""
    unit = arm.joints[joint].unit
    if quantity == "effort":
        return unit.effort_text, 1.0, 0.05
    if quantity == "velocity":
        return f"{unit.text}/s", unit.scale, 1.0
    return unit.text, unit.scale, 0.1 if quantity == "error" else 1.0


def _si(unit: str) -> str:
    return unit.replace(ANGLE.text, "rad").replace("mm", "m")


def _scales(span: Span) -> dict[str, uplot.Scale]:
    return {
        "ago": uplot.Scale(time=False, range=(-SPAN_S, 0.0)),
        "y": uplot.Scale(range=(span.low, span.high)),
    }
