"""What the tests of the command line share: running it, and reading what it said."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn

import pytest

from trocar.cli import main, output


@dataclass(frozen=True)
class Answer:
    """How a command ended: its exit status, and what it wrote."""

    status: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """The one JSON document of stdout, which holds nothing that JSON does not know."""
        return json.loads(self.out, parse_constant=refuse)

    @property
    def complaint(self) -> str:
        """The one line of a refusal, without the program's name; nothing else was printed."""
        assert self.out == ""
        (line,) = self.err.splitlines()
        name, error, complaint = line.split(": ", 2)
        assert (name, error) == ("trocar", "error")
        return complaint


@pytest.fixture(autouse=True)
def no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """Print no lines of progress, however slow the machine is."""
    monkeypatch.setattr(output, "LINE_S", 3600.0)


Command = Callable[..., Answer]


def refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no JSON")


@pytest.fixture
def trocar(capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the function that runs a command line in this process."""

    def run(*words: object) -> Answer:
        status = main([str(word) for word in words])
        said = capsys.readouterr()
        return Answer(status, said.out, said.err)

    return run
