"""Two live plots of one joint: commanded against measured, and the difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from trocar.interfaces.viewer.history import SPAN_S, History
from trocar.interfaces.viewer.sheet import ArmSheet, JointSheet

Floats = NDArray[np.float64]

COMMANDED, MEASURED, ERROR = "#ffb45c", "#1c6fc4", "#c2255c"
WIDTHS = {COMMANDED: 5.0, MEASURED: 1.6, ERROR: 1.6}
"""Line widths in pixels: what is commanded shows behind what is measured."""

TIME = "ago"
"""Name of the time scale; viser meddles with the range of one called "x"."""

LINES = 5
"""About how many steps an axis is divided into."""


class JointPlots:
    """A choice of joint and its two plots, inside the GUI container that is open."""

    def __init__(self, gui: viser.GuiApi, sheet: ArmSheet) -> None:
        self._sheet = sheet
        self._choice = gui.add_dropdown("Last 10 s of", _names(sheet))
        self._motion = _Plot(gui, (("commanded", COMMANDED), ("measured", MEASURED)), height=150)
        self._error = _Plot(gui, (("measured - commanded", ERROR),), height=115)

    def show(self, history: History, sheet: ArmSheet) -> None:
        """Draw the chosen joint of an arm."""
        if sheet.name != self._sheet.name or _names(sheet) != _names(self._sheet):
            self._choice.options = _names(sheet)
            self._choice.value = _names(sheet)[0]
        self._sheet = sheet
        names = _names(sheet)
        index = names.index(self._choice.value) if self._choice.value in names else 0
        joint = sheet.joints[index]
        trace = history.trace(sheet.name, index)
        if trace.ago.size < 2:
            return
        commanded, measured = trace.commanded * joint.unit.scale, trace.measured * joint.unit.scale
        self._motion.draw(joint.unit.text, trace.ago, (commanded, measured), least=_least(joint))
        error = measured - commanded
        self._error.draw(joint.unit.text, trace.ago, (error,), least=_least(joint) / 50)


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
        span = wide_enough(np.concatenate(lines), self._span, least)
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


def wide_enough(values: Floats, old: Span, least: float) -> Span:
    """Choose the ends of an axis: round numbers around the values, kept while they serve.

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
    step = 10.0 ** np.ceil(np.log10(height / LINES))
    step = next(step / part for part in (5, 2, 1) if LINES * step / part >= height)
    middle = (low + high) / 2
    low, high = min(low, middle - height / 2), max(high, middle + height / 2)
    return Span(float(np.floor(low / step) * step), float(np.ceil(high / step) * step))


def _scales(span: Span) -> dict[str, uplot.Scale]:
    return {
        TIME: uplot.Scale(time=False, range=(-SPAN_S, 0.0)),
        "y": uplot.Scale(range=(span.low, span.high)),
    }


def _least(joint: JointSheet) -> float:
    return 0.02 * (joint.upper - joint.lower) * joint.unit.scale


def _names(sheet: ArmSheet) -> tuple[str, ...]:
    return tuple(joint.name for joint in sheet.joints)
