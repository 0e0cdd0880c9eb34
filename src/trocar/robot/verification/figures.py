"""Measured figures beside their bounds, and the parts that experiments have."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

#: Factor from SI to the unit that is displayed.
DISPLAY_FACTORS = {
    "mm": 1e3,
    "um": 1e6,
    "nm": 1e9,
    "mrad": 1e3,
    "urad": 1e6,
    "ms": 1e3,
    "mN m": 1e3,
    "mJ": 1e3,
    "mW": 1e3,
}


@dataclass(frozen=True)
class Figure:
    """A measured value with its bounds.

    Attributes:
        name: quantity
        value: measured value [unit]
        unit: of value, paper and bounds; "" for a plain number
        upper, lower: largest and smallest allowed value; None: no such bound
        shown: unit of the display where that differs from `unit`, which is then in SI
        paper: value of the paper's hardware; None where it gives none
        paper_simulation: value of the paper's own simulation; None where it gives none
        hardware: measured on the robot that an arm is calibrated to; None: not measured
        nominal: of the description before the calibration; None: not computed
        source: of the paper's value and the bounds, and how the value is measured

    Raises:
        ValueError: a unit of the display that is not known
    """

    name: str
    value: float
    unit: str
    upper: float | None = None
    lower: float | None = None
    shown: str = ""
    paper: float | None = None
    paper_simulation: float | None = None
    hardware: float | None = None
    nominal: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        if self.shown and self.shown not in DISPLAY_FACTORS:
            raise ValueError(f"{self.name}: shown in {self.shown}; known: {[*DISPLAY_FACTORS]}")

    @property
    def met(self) -> bool | None:
        """Whether the value is within its bounds; None without bounds."""
        if self.lower is None and self.upper is None:
            return None
        least = -math.inf if self.lower is None else self.lower
        most = math.inf if self.upper is None else self.upper
        return math.isfinite(self.value) and least <= self.value <= most

    @property
    def verdict(self) -> str:
        """The verdict as text: "met", "MISSED", or "" without bounds."""
        return {None: "", True: "met", False: "MISSED"}[self.met]

    @property
    def display_unit(self) -> str:
        """The unit of `text`."""
        return self.shown or self.unit

    def text(self, value: float | None) -> str:
        """Format a value of this figure for display, without its unit; "" for None."""
        if value is None:
            return ""
        if not math.isfinite(value):
            return "-"
        scaled = value * (DISPLAY_FACTORS[self.shown] if self.shown else 1.0)
        if abs(scaled) >= 1e5:
            return f"{scaled:.0f}"
        if abs(scaled) >= 1.0:
            return f"{scaled:.5g}" if abs(scaled) >= 100.0 else f"{scaled:.4g}"
        if not self.shown and abs(scaled) < 1e-3:
            return f"{scaled:.3g}"
        # three digits, but nothing below the fifth decimal, where all is noise
        decimals = 2 - math.floor(math.log10(max(abs(scaled), 1e-3)))
        return f"{round(scaled, decimals) + 0.0:.{decimals}f}".rstrip("0").rstrip(".")

    @property
    def allowed(self) -> str:
        """The bounds as text; "" without."""
        if self.lower is None:
            return "" if self.upper is None else f"<= {self.text(self.upper)}"
        if self.upper is None:
            return f">= {self.text(self.lower)}"
        middle, half = 0.5 * (self.lower + self.upper), 0.5 * (self.upper - self.lower)
        return f"{self.text(middle)} +- {self.text(half)}"

    def document(self) -> dict[str, Any]:
        """Convert to the table of a JSON document."""
        bounds = {"lower": self.lower, "upper": self.upper}
        return {
            "name": self.name,
            "value": self.value,
            "unit": self.unit,
            "paper": self.paper,
            "paper_simulation": self.paper_simulation,
            "hardware": self.hardware,
            "nominal": self.nominal,
            "tolerance": bounds if self.met is not None else None,
            "met": self.met,
            "source": self.source,
        }


@dataclass(frozen=True, eq=False)
class ReportPart:
    """Figures of one experiment.

    Attributes:
        name: "closure", "axes", ...
        arm: name of the arm, "" for experiments on whole rigs
        title: heading
        figures: in display order
        command: command line that measures them again
        notes: remarks for readers
        data: curves and clouds for the plots of a report
    """

    name: str
    arm: str
    title: str
    figures: tuple[Figure, ...]
    command: str
    notes: tuple[str, ...] = ()
    data: Any = field(default=None, repr=False)


def figure_rows(figures: tuple[Figure, ...] | list[Figure]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of a table of figures, with columns for the values it compares with."""
    paper = any(f.paper is not None for f in figures)
    simulation = any(f.paper_simulation is not None for f in figures)
    robot = any(f.hardware is not None or f.nominal is not None for f in figures)
    ours = "calibrated" if robot else "ours" if paper or simulation else "measured"
    head = ["figure", *(["hardware", "nominal"] if robot else []), ours, "unit",
            *(["paper"] if paper else []), *(["its simulation"] if simulation else []),
            "allowed", ""]  # fmt: skip
    rows = [
        [
            f.name,
            *([f.text(f.hardware), f.text(f.nominal)] if robot else []),
            f.text(f.value),
            f.display_unit,
            *([f.text(f.paper)] if paper else []),
            *([f.text(f.paper_simulation)] if simulation else []),
            f.allowed,
            f.verdict,
        ]
        for f in figures
    ]
    return head, rows
