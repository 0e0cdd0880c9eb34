"""Self-contained HTML report pages."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

from trocar.errors import InputError
from trocar.outputs import check_file, whole_file
from trocar.plotting.drawing import new_figure

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 1080px;
  padding: 2rem 1.5rem; color: #1d2733; background: #fff; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 0.4rem; }
h2 { font-size: 1.35rem; margin: 2.6rem 0 0.5rem; padding-top: 0.8rem;
  border-top: 1px solid #d5dde5; }
h3 { font-size: 1.05rem; margin: 1.6rem 0 0.4rem; }
p { margin: 0.4rem 0 0.8rem; max-width: 70ch; }
table { border-collapse: collapse; font-size: 0.88rem; margin: 0.6rem 0 1rem;
  font-variant-numeric: tabular-nums; }
td, th { padding: 0.25rem 0.9rem 0.25rem 0; border-bottom: 1px solid #e4e9ee; text-align: right;
  vertical-align: top; }
th { font-weight: 600; color: #51606f; border-bottom: 1px solid #b9c4cf; vertical-align: bottom; }
td:first-child, th:first-child, .words td, .words th { text-align: left; }
.scroll { overflow-x: auto; }
.good { color: #00724f; } .bad { color: #b00020; font-weight: 700; } .quiet { color: #6b7885; }
.note { background: #fff3cd; padding: 0.5rem 1rem; max-width: none; }
figure { margin: 1rem 0 1.4rem; }
figcaption { font-size: 0.88rem; color: #51606f; max-width: 80ch; }
svg, img { width: 100%; height: auto; }
code { background: #f1f4f7; padding: 0.1rem 0.3rem; border-radius: 3px; font-size: 0.88em; }
"""


class Cell(str):
    """A text that is HTML already."""

    __slots__ = ()


def text(value: str) -> str:
    """Return a text as HTML; a Cell stays as it is."""
    return value if isinstance(value, Cell) else html.escape(value)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], words: bool = False) -> str:
    """Return a table; its first column is flush left, the others right unless all are `words`."""
    cells = "".join(f"<th>{text(name)}</th>" for name in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{text(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    kind = ' class="words"' if words else ""
    return f'<div class="scroll"><table{kind}><tr>{cells}</tr>{body}</table></div>'


def picture(svg: str, caption: str) -> str:
    """Return a drawing with its caption."""
    return f"<figure>{svg}<figcaption>{text(caption)}</figcaption></figure>"


def document(title: str, body: str) -> str:
    """Return a whole page."""
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{text(title)}</title><style>{STYLE}</style></head><body>{body}</body></html>\n"
    )


def page_in(folder: str | Path, purpose: str, overwrite: bool) -> Path:
    """Return the path of a page with drawings, checked before anything is computed.

    Args:
        folder: of the page; made when it is written
        purpose: of the drawings, for the error if matplotlib is missing
        overwrite: an existing page may be replaced

    Raises:
        InputError: the folder is a file, or holds a page already
        MissingExtraError: matplotlib is not installed
    """
    target = Path(folder).expanduser()
    if target.exists() and not target.is_dir():
        raise InputError(f"{target}: is not a folder; allowed: an existing or a new folder")
    if target.is_dir():
        check_file(target / "index.html", overwrite)
    new_figure(1.0, 1.0, purpose)
    return target / "index.html"


def write(path: Path, page: str, overwrite: bool) -> None:
    """Write a page, and make its folder.

    Raises:
        InputError: it exists and may not be replaced, or cannot be written
        TrocarError: the disk is full
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    with whole_file(path, overwrite) as part:
        part.write_text(page, encoding="utf-8")
