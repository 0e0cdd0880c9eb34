"""Write docs/errata.md, the errata of the package's sources, from its data."""

from __future__ import annotations

from pathlib import Path

from trocar.descriptions import names
from trocar.descriptions.paper import Erratum, errata, printed_tables

PAGE = Path(__file__).parents[2] / "docs" / "errata.md"
TEXT = """\
# Errata of the sources

Of Tables 1 to 5 of the closed-loop paper, and of the dVRK's files from which arms are described.
[The mechanism](mechanism.md) names the paper and the sources of the corrections.

<!-- Written by make docs. -->

## The dVRK's software

The services `forward_kinematics` and `inverse_kinematics` of an arm are in different frames:
forward in that of `measured_cp`, inverse in the arm's own base frame
(mtsIntuitiveResearchKitArm.cpp:2327-2353, sawIntuitiveResearchKit 9e535e6). With a base frame, such
as a PSM's in the ECM's, one does not undo the other; `local/forward_kinematics` does. trocar's are
the same."""


def page() -> str:
    """Return the page as Markdown."""
    parts = [TEXT]
    for name in printed_tables():
        parts += [f"## Table {name.removeprefix('table')}", _table(errata(name))]
    for name in names("arms"):
        if rows := errata(name):
            parts += [f"## Arm `{name}`", _table(rows)]
    return "\n\n".join(parts) + "\n"


def _table(rows: tuple[Erratum, ...]) -> str:
    lines = [
        "| frame or joint, entry | printed | mended | effect of the print | source |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        cells = (f"{row.frame}, {row.key}", _entry(row.printed), _entry(row.mended))
        lines.append(f"| {' | '.join((*cells, row.effect, row.source))} |")
    return "\n".join(lines)


def _entry(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.7g}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
