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

<!-- Written by make docs. -->"""
SOFTWARE = """\
## The dVRK's software

Published by trocar as by the dVRK 2.4, though a name or a header suggests otherwise:

| topic | what it is |
|---|---|
| `local/measured_cv` | in the axes of the tip; its header names the arm's base (in Python, `local.measured_cv()` is in axes of the base) |
| `measured_cv` | in axes of the frame of `measured_cp`; its header names the arm's base, also after `set_base_frame` or with setup joints |
| `body/measured_cf`, `spatial/measured_cf` | their headers name no frame: axes of the tip, and of the arm's base |
| `body/jacobian`, `spatial/jacobian` | row by row, though the strides (1, 6) are those of columns |
| `trajectory_j/ratio` | 0 while the ratios of velocity and acceleration differ |

The services `forward_kinematics` and `inverse_kinematics` of an arm are in different frames:
forward in that of `measured_cp`, inverse in the arm's own base frame
(mtsIntuitiveResearchKitArm.cpp:2327-2353, sawIntuitiveResearchKit 9e535e6). With a base frame, such
as a PSM's in the ECM's, one does not undo the other; `local/forward_kinematics` does. trocar's are
the same."""  # noqa: E501


def page() -> str:
    """Return the page as Markdown."""
    parts = [TEXT]
    for name in printed_tables():
        parts += [f"## Table {name.removeprefix('table')}", _table(errata(name))]
    for name in names("arms"):
        if rows := errata(name):
            parts += [f"## Arm `{name}`", _table(rows)]
    return "\n\n".join((*parts, SOFTWARE)) + "\n"


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
