"""What the command line prints: tables for people, one JSON document for programs."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.descriptions import ArmDescription

GAP = "  "


def print_json(document: Mapping[str, Any]) -> None:
    """Print a document; arrays become lists, NaN and infinity null."""
    text = json.dumps(plain(document), indent=2, allow_nan=False)
    print(re.sub(r"\[\n[^][{}]*\]", _on_one_line, text))


def _on_one_line(values: re.Match[str]) -> str:
    return f"[{' '.join(values[0][1:-1].split())}]"


def plain(value: Any) -> Any:
    """Return a value as JSON has it."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # an array or a number of numpy, which is not imported here
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    return value


def warn(message: str) -> None:
    """Say on stderr what the user should know, but what stops nothing."""
    print(f"trocar: warning: {message}", file=sys.stderr)


def title(arm: ArmDescription) -> str:
    """Name an arm and its tool."""
    return f"{arm.name} with {arm.tool}" if arm.tool else arm.name


def fixed(value: float, decimals: int = 9) -> str:
    """Write a number with so many decimals, rounded to 0 without a sign."""
    if not math.isfinite(value):
        return "-"
    return f"{round(float(value), decimals) + 0.0:.{decimals}f}"


def short(value: float | None) -> str:
    """Write a number with up to seven digits, what is only rounding as 0, what is none as -."""
    if value is None or not math.isfinite(value):
        return "-"
    return "0" if abs(value) < 1e-12 else f"{value:.7g}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], indent: str = "  ") -> str:
    """Lay out rows under a head; columns of numbers are flush right.

    Args:
        head: the columns' names with their units
        rows: as many texts each
        indent: what each line starts with
    """
    body = [list(row) for row in rows]
    right = [all(_numeric(row[i]) for row in body) for i in range(len(head))]
    widths = [max(len(line[i]) for line in [head, *body]) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        padded = (
            cell.rjust(width) if flush else cell.ljust(width)
            for cell, width, flush in zip(cells, widths, right, strict=True)
        )
        return (indent + GAP.join(padded)).rstrip()

    return "\n".join([line(head), *(line(row) for row in body)])


def _numeric(cell: str) -> bool:
    return bool(cell) and set(cell) <= set("0123456789+-.e ")
