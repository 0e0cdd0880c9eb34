"""The examples run, are short, say what one sees, and use nothing that is not public."""

from __future__ import annotations

import ast
import importlib
import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
MOST_LINES = 60
#: A reader takes in about a screen of output.
MOST_PRINTED = 40

each = pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)


@each
def test_an_example_runs_and_prints_a_few_lines(
    example: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(example)])
    runpy.run_path(str(example), run_name="__main__")
    said = capsys.readouterr().out
    assert 3 <= len(said.splitlines()) <= MOST_PRINTED
    assert "nan" not in said.lower().replace("to nan", "")
    assert not list(tmp_path.iterdir()), "an example leaves nothing behind"


@each
def test_an_example_is_short_and_says_what_one_sees(example: Path) -> None:
    text = example.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    assert "\nOne sees: " in (ast.get_docstring(ast.parse(text)) or "")


@each
def test_an_example_uses_public_names_only(example: Path) -> None:
    tree = ast.parse(example.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_"), f"line {node.lineno}: {node.attr}"
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("trocar."):
            module = importlib.import_module(str(node.module))
            public = set(getattr(module, "__all__", vars(module)))
            assert hasattr(module, "__path__") or node.module == "trocar.errors", node.module
            assert {alias.name for alias in node.names} <= public, f"line {node.lineno}"


def test_the_examples_are_numbered_without_a_gap() -> None:
    numbers = [int(path.name[:2]) for path in EXAMPLES]
    assert numbers == list(range(1, len(EXAMPLES) + 1))
