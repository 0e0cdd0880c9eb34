"""Write docs/script-calls.md: the calls of a dVRK script, from the table that tests them."""

from __future__ import annotations

import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROWS = ROOT / "tests" / "scripts" / "api_rows.py"
PAGE = ROOT / "docs" / "script-calls.md"
TEXT = """\
# Calls of dVRK scripts

Every call that [`trocar run`](scripts.md) offers a script; each is tested to do what it does on the
robot. `arm` is a PSM, ECM or MTM. Topics of `dvrk.suj(ral).PSM1` are under `/SUJ/PSM1/`.

<!-- Written by make docs. -->"""
MODULES = {"ral": "crtk.ral", "utils": "crtk.utils, others"}


def page() -> str:
    """Return the page as Markdown."""
    lines = ["| module | calls |", "|---|---|"]
    for part, (_, _, rows) in runpy.run_path(str(ROWS))["PARTS"].items():
        calls = ", ".join(f"`{call}`" for call in rows)
        lines.append(f"| {MODULES.get(part, f'dvrk.{part}')} | {calls} |")
    return "\n".join([TEXT, "", *lines, ""])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
