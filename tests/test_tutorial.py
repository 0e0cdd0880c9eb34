"""The lessons: each script runs as its page says, is short, and has a picture that can be drawn."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import logging
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "tutorial"
LESSONS = sorted(FOLDER.glob("[0-9]*.py"))
MOST_LINES = 60
MOST_BYTES = 120_000
#: Modules beside the rooms' own that pages tell users to import.
DOCUMENTED = ("trocar.descriptions.paper",)

each = pytest.mark.parametrize("lesson", LESSONS, ids=lambda path: path.stem)


def page(lesson: Path) -> str:
    return lesson.with_suffix(".md").read_text(encoding="utf-8")


def run(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@each
def test_a_lesson_prints_what_its_page_shows(
    lesson: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(lesson)])
    try:
        runpy.run_path(str(lesson), run_name="__main__")
    finally:
        logging.disable(logging.NOTSET)  # a lesson may silence warnings, in this process
    said = capsys.readouterr()
    assert not said.err
    assert not list(tmp_path.iterdir()), "a lesson leaves nothing behind"
    (block,) = re.findall(r"^```console\n(.*?)^```$", page(lesson), re.DOTALL | re.MULTILINE)
    command, printed = block.split("\n", 1)
    assert command == f"$ python docs/tutorial/{lesson.name}"
    # "..." stands for whatever is left out.
    wanted = re.escape(printed.strip()).replace(re.escape("..."), "(?s:.*?)")
    assert re.fullmatch(wanted, said.out.strip()), said.out


@each
def test_a_lesson_is_short_and_says_what_one_sees(lesson: Path) -> None:
    text = lesson.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    assert "\nOne sees: " in (ast.get_docstring(ast.parse(text)) or "")


@each
def test_a_lesson_uses_public_names_only_and_draws_nothing(lesson: Path) -> None:
    tree = ast.parse(lesson.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_"), f"line {node.lineno}: {node.attr}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [getattr(node, "module", None), *(alias.name for alias in node.names)]
            assert not [n for n in names if n and n.startswith("matplotlib")]
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("trocar."):
            module = importlib.import_module(str(node.module))
            public = set(getattr(module, "__all__", vars(module)))
            assert hasattr(module, "__path__") or node.module in DOCUMENTED, node.module
            assert {alias.name for alias in node.names} <= public, f"line {node.lineno}"


@each
def test_a_page_shows_its_picture_and_leads_to_the_next_lesson(lesson: Path) -> None:
    text = page(lesson)
    picture = lesson.with_suffix(".png")
    assert f"]({picture.name})" in text
    assert f"]({lesson.name})" in text
    assert picture.stat().st_size < MOST_BYTES
    later = LESSONS[LESSONS.index(lesson) + 1 :]
    assert not later or f"]({later[0].stem}.md)" in text
    assert f"]({lesson.stem}.md)" in (FOLDER / "README.md").read_text(encoding="utf-8")


@each
def test_the_python_of_a_page_runs(lesson: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", page(lesson), re.DOTALL | re.MULTILINE):
        exec(compile(block, lesson.stem, "exec"), names)
    capsys.readouterr()


def test_there_are_five_lessons_numbered_without_a_gap() -> None:
    assert [int(path.name[:2]) for path in LESSONS] == [1, 2, 3, 4, 5]


@pytest.mark.slow
def test_every_picture_can_be_drawn_anew(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra plot is not installed")
    result = run(str(FOLDER / "draw.py"), str(tmp_path), folder=tmp_path)
    assert result.returncode == 0, result.stderr
    drawn = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(drawn) == {lesson.with_suffix(".png").name for lesson in LESSONS}
    assert max(drawn.values()) < MOST_BYTES
