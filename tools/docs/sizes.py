"""Write lines and files of each package into the table of docs/performance.md."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "performance.md"
PACKAGE = ROOT / "src" / "trocar"
ROW = re.compile(r"^\| (\w+) \| ([\d,-]+) \| [\d,]+ \| ([\d,-]+) \| [\d,]+ \|$", re.MULTILINE)


def sizes(folder: Path) -> tuple[int, int]:
    """Return lines and files of Python in a folder."""
    files = list(folder.rglob("*.py"))
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files), len(files)


def row(found: re.Match[str]) -> str:
    """Return a row of the table with the numbers of today."""
    name, lines_before, files_before = found.groups()
    lines, files = sizes(PACKAGE if name == "all" else PACKAGE / name)
    return f"| {name} | {lines_before} | {lines:,} | {files_before} | {files} |"


if __name__ == "__main__":
    PAGE.write_text(ROW.sub(row, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
