"""A verified value: ours, the paper's, what is allowed, and where both come from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

#: What a value in SI is multiplied by to be shown in a unit.
SHOWN = {"mm": 1e3, "um": 1e6, "nm": 1e9, "mrad": 1e3, "urad": 1e6, "ms": 1e3}


@dataclass(frozen=True)
class Figure:
    """A value with what it is compared to.

    Attributes:
        name: what it is
        value: ours [unit]
        unit: of value, paper and limits, in SI: "m", "rad", "s" or "" for a plain number
        shown: unit that people are told it in, `unit` where empty
        paper: the paper's, of the hardware; None where it has none
        paper_simulation: the paper's own simulation's; None where it has none
        lower, upper: what is allowed; None: no such limit
        source: where the paper's value and the limits are from, and how ours is got
    """

    name: str
    value: float
    unit: str
    shown: str = ""
    paper: float | None = None
    paper_simulation: float | None = None
    lower: float | None = None
    upper: float | None = None
    source: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the value is within its tolerance; None where it is only stated."""
        if self.lower is None and self.upper is None:
            return None
        least = -float("inf") if self.lower is None else self.lower
        most = float("inf") if self.upper is None else self.upper
        return math.isfinite(self.value) and least <= self.value <= most

    @property
    def people_unit(self) -> str:
        """The unit that `told` uses."""
        return self.shown or self.unit

    def told(self, value: float | None) -> str:
        """Return a value of this figure for people, without its unit; "" for none."""
        if value is None:
            return ""
        if not math.isfinite(value):
            return "-"
        scaled = SHOWN.get(self.shown, 1.0) * value
        if abs(scaled) >= 1e5:
            return f"{scaled:.0f}"
        if abs(scaled) >= 1.0:
            return f"{scaled:.5g}" if abs(scaled) >= 100.0 else f"{scaled:.4g}"
        # three digits, but nothing below the fifth decimal, where all is noise
        decimals = 2 - math.floor(math.log10(max(abs(scaled), 1e-3)))
        return f"{round(scaled, decimals) + 0.0:.{decimals}f}".rstrip("0").rstrip(".")

    @property
    def allowed(self) -> str:
        """What is allowed, for people; "" where the value is only stated."""
        if self.lower is None and self.upper is None:
            return ""
        if self.lower is None:
            return f"<= {self.told(self.upper)}"
        if self.upper is None:
            return f">= {self.told(self.lower)}"
        middle, half = 0.5 * (self.lower + self.upper), 0.5 * (self.upper - self.lower)
        return f"{self.told(middle)} +- {self.told(half)}"


@dataclass(frozen=True, eq=False)
class Part:
    """What one of the paper's experiments found.

    Attributes:
        name: "closure", "axes", ...
        arm: name of the arm, "" where the experiment is of whole rigs
        title: for people
        figures: in the order in which they are told
        command: the command line that measures them again
        notes: what a reader should know
        data: what is drawn of it, as the part has it
    """

    name: str
    arm: str
    title: str
    figures: tuple[Figure, ...]
    command: str
    notes: tuple[str, ...] = ()
    data: Any = field(default=None, repr=False)
