"""The words of docstrings and comments: imperative, with nouns of the field (CONTRIBUTING.md).

Each pattern was a habit of this code base that needed a second reading.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src" / "trocar").rglob("*.py"))

#: In the first line of a docstring.
FIRST = (
    r"^(Return|Yield|Give|Say|Tell) (what|where|how|which|why|who|whom|whose)\b",
    r"^(What|Where|Who|Whom|Whose|Which|Why|How)\b",
)
#: Anywhere in a docstring, or in the comment of a constant.
ANYWHERE = (
    r"\b(is|are) none\b(?! of)",
    r"\b(wants?|feels?|obeys?|obeyed)\b",
    r"\b(somebody|nobody|whoever)\b",
    r"\blet go of when\b",
)
#: At the beginning of the comment of a constant (`#: ...`).
COMMENT = (r"^(What|Where|Who|Whom|Whose|Which|Why|How|That|So)\b",)


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of each docstring of a module."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                line = node.body[0].lineno
                yield line, text


def comments(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of each comment block of a constant, `#: ...`."""
    block: list[str] = []
    start = last = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and token.string.startswith("#:"):
            if block and token.start[0] != last + 1:
                yield start, " ".join(block)
                block = []
            if not block:
                start = token.start[0]
            block.append(token.string[2:].strip())
            last = token.start[0]
    if block:
        yield start, " ".join(block)


def faults(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and words of each habit that a module has."""
    for line, text in docstrings(source):
        first = text.split("\n", 1)[0]
        for pattern in FIRST:
            if found := re.search(pattern, first):
                yield line, found[0]
        for pattern in ANYWHERE:
            for found in re.finditer(pattern, text):
                yield line, found[0]
    for line, text in comments(source):
        for pattern in (*COMMENT, *ANYWHERE):
            if found := re.search(pattern, text):
                yield line, found[0]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT / "src").as_posix())
def test_docstrings_and_comments_are_plain(path: Path) -> None:
    found = [f"{path.name}:{line}: {words!r}" for line, words in faults(path.read_text("utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ('"""Return where the tip is."""', "Return where"),
        ('"""What a camera saw."""', "What"),
        ('"""Reject.\n\n    A quaternion that is none.\n    """', "is none"),
        ("#: How often it is renewed [s].\nA = 1", "How"),
        ("#: Time.\n#: Nobody waits; somebody wants it.\nA = 1", "somebody"),
    ],
)
def test_the_patterns_find_what_they_are_for(source: str, words: str) -> None:
    assert words in [each for _, each in faults(source)]


def test_plain_words_pass() -> None:
    assert not list(faults('"""Return the pose of the tip."""\n#: Renewal period [s].\nA = 1\n'))
