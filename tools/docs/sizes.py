"""Write lines and files of each package, and words of the pages, into docs/performance.md."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGE = DOCS / "performance.md"
PACKAGE = ROOT / "src" / "trocar"
ROW = re.compile(r"^\| (\w+) \| ([\d,-]+) \| [\d,]+ \| ([\d,-]+) \| [\d,]+ \|$", re.MULTILINE)
WORDS = re.compile(r"[\d,]+ words\b")
#: Pages that programs write, beside those of reference/.
GENERATED = (
    "command-line.md",
    "errata.md",
    "licences.md",
    "scene-list.md",
    "script-calls.md",
    "topic-list.md",
)
CODE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)


def sizes(folder: Path) -> tuple[int, int]:
    """Return lines and files of Python in a folder."""
    files = list(folder.rglob("*.py"))
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files), len(files)


def words(text: str) -> int:
    """Return the number of words, tables included, that are not in code blocks."""
    return sum(bool(re.search(r"\w", word)) for word in CODE.sub("", text).split())


def written() -> dict[Path, int]:
    """Return the words of each page that people write."""
    docs = (
        page
        for page in sorted(DOCS.rglob("*.md"))
        if page.name not in GENERATED and page.parent.name != "reference"
    )
    pages = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *docs)
    return {page: words(page.read_text(encoding="utf-8")) for page in pages}


def row(found: re.Match[str]) -> str:
    """Return a row of the table with the numbers of today."""
    name, lines_before, files_before = found.groups()
    lines, files = sizes(PACKAGE if name == "all" else PACKAGE / name)
    return f"| {name} | {lines_before} | {lines:,} | {files_before} | {files} |"


if __name__ == "__main__":
    text = ROW.sub(row, PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(WORDS.sub(f"{sum(written().values()):,} words", text), encoding="utf-8")
