"""A format that a test drops in: one file beside those of `trocar.formats`."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from trocar import formats

#: Writes two small files and a folder; reads a file as a ball of the mass in it.
PLAIN = '''
"""Plain text: the number of links."""

from pathlib import Path

import numpy as np

from trocar.errors import TrocarError
from trocar.formats.folder import ExportTask
from trocar.formats.format import Format
from trocar.formats.links import Link, SourceModel, solid


def write_plain(task: ExportTask, *, note: str = "none", fail: bool = False) -> tuple[str, ...]:
    """Fill a folder."""
    text = f"{len(task.model.links)} links, note {note}"
    (task.folder / "model.txt").write_text(text, encoding="utf-8")
    (task.folder / "parts").mkdir()
    (task.folder / "parts" / "part.txt").write_text("part", encoding="utf-8")
    if fail:
        raise TrocarError("half way")
    return ("it is only a test",)


def read_plain(path: Path, packages: tuple[Path, ...] = ()) -> SourceModel:
    """Read a ball."""
    mass = float(path.read_text(encoding="utf-8"))
    ball = solid("sphere", np.eye(4), (0.1,), "casting")
    link = Link("ball", mass=mass, inertia=0.004 * mass * np.eye(3), shapes=(ball,))
    return SourceModel(path.stem, str(path), (link,), (), (), ())


FORMAT = Format(
    title="Plain text",
    order=90,
    options="""
        --note TEXT = none  plain: a note
        --fail              plain: fail half way
    """,
    suffixes=(".plain",),
    write=write_plain,
    read=read_plain,
)
'''


def drop_in(monkeypatch: pytest.MonkeyPatch, folder: Path, name: str, source: str) -> None:
    """Add a format's file for the duration of a test."""
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.py").write_text(source, encoding="utf-8")
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(folder)])
    monkeypatch.setitem(sys.modules, f"trocar.formats.{name}", formats)
    del sys.modules[f"trocar.formats.{name}"]  # removed again after the test, when imported
