"""`python -m benchmarks attack`: which attacks it finds, what it prints, and its exit codes."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import pytest

from benchmarks.__main__ import main
from benchmarks.attack import Tally
from benchmarks.attack import __main__ as runner

CLEAN = Tally("files", 12)
FAILED = Tally("commands", 9, ["servo_jp 1e308: the loop ended"], [["verb", "sent"], ["x", "9"]])


def tallied(monkeypatch: pytest.MonkeyPatch, *tallies: Tally) -> None:
    monkeypatch.setattr(runner, "attacks", lambda: [tally.name for tally in tallies])
    monkeypatch.setattr(runner, "run", lambda *_: iter(tallies))


def test_an_attack_is_a_file_of_the_package() -> None:
    assert "faults" in runner.attacks()
    assert "__main__" not in runner.attacks()


def test_clean_is_what_did_not_fail() -> None:
    assert (CLEAN.clean, FAILED.clean) == (12, 8)


def test_what_failed_is_printed_with_the_command_that_repeats_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tallied(monkeypatch, CLEAN, FAILED)
    assert main(["attack", "--seed", "7", "--seconds", "3"]) == 1
    out = capsys.readouterr().out
    assert "commands      9      8       1" in out
    assert "python -m benchmarks attack --only commands --seed 7 --seconds 3" in out
    assert "servo_jp 1e308: the loop ended" in out
    assert "verb" in out


def test_nothing_failed_is_success(monkeypatch, capsys: pytest.CaptureFixture[str]) -> None:
    tallied(monkeypatch, CLEAN)
    assert main(["attack", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["attacks"][0]["clean"] == 12
    assert found["seed"] == 0


def test_an_attack_that_breaks_off_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    def attack(seed: int, seconds: float) -> Tally:
        raise RuntimeError(f"{seed} {seconds}")

    monkeypatch.setitem(sys.modules, "benchmarks.attack.broken", SimpleNamespace(attack=attack))
    tally = runner.tally_of("broken", 5, 1.0)
    assert tally.clean == 0 and "RuntimeError: 5 1.0" in tally.failed[0]


@pytest.mark.parametrize(
    ("words", "allowed"),
    [
        (["--seconds", "0"], "allowed: above 0"),
        (["--seconds", "nan"], "allowed: above 0"),
        (["--jobs", "0"], "allowed: 1 or more"),
        (["--seed", "-1"], "allowed: 0 or more"),
    ],
)
def test_bad_options_are_refused(
    words: list[str], allowed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["attack", *words]) == 2
    assert allowed in capsys.readouterr().err


def test_an_unknown_attack_is_refused_by_the_names_that_there_are(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["attack", "--only", "nothing"])
    assert ended.value.code == 2
    assert "faults" in capsys.readouterr().err
