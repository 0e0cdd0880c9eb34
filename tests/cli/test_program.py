"""The program: its subcommands, its exit status, and its one line for whatever goes wrong."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import trocar as package
from trocar.cli import fk, main
from trocar.cli.arguments import keep_negative_numbers
from trocar.cli.program import COMMANDS
from trocar.errors import DivergedError

ROOT = Path(__file__).parents[2]


def start(*words: str) -> subprocess.Popen[bytes]:
    """Start the command line in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "trocar", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def module(command: str) -> str:
    return f"trocar.cli.{command.replace('-', '_')}"


def test_help_names_every_command_that_is_there(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    told = capsys.readouterr().out
    assert not end.value.code
    for name, summary in COMMANDS.items():
        assert (name in told.split() and summary in told) == bool(find_spec(module(name)))


@pytest.mark.parametrize("name", [n for n in COMMANDS if find_spec(module(n))])
def test_every_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert not end.value.code
    assert f"usage: trocar {name}" in capsys.readouterr().out


def test_version_is_the_package_s(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"trocar {package.__version__}\n"


def test_the_module_is_the_program():
    process = start("fk", "psm", "0", "0", "0.12", "0", "0", "-1.2e-05")
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, b"")
    assert b"tip in rcm" in out


def test_an_error_leaves_no_traceback_and_no_output():
    process = start("fk", "psm", "0", "--json")
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, b"")
    assert err.startswith(b"trocar: error: psm: got 1 joint positions") and err.count(b"\n") == 1


@pytest.mark.skipif(os.name == "nt", reason="Windows reports a closed pipe in another way")
def test_a_reader_that_goes_away_is_no_error():
    process = start("show", "psm")
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait(timeout=60) == 1
    process.stderr.close()


def test_a_failed_run_is_told_from_bad_input(trocar, monkeypatch):
    def diverge(_args):
        raise DivergedError(0.25, "pitch", 0.5)

    monkeypatch.setattr(fk, "run", diverge)
    answer = trocar("fk", "psm", 0)
    assert answer.status == 1
    told = "simulation diverged at t = 0.250000 s in joint pitch (last target 0.5)"
    assert answer.complaint == told


def test_an_unexpected_error_keeps_its_traceback(monkeypatch):
    def stumble(_args):
        raise ZeroDivisionError

    monkeypatch.setattr(fk, "run", stumble)
    with pytest.raises(ZeroDivisionError):
        main(["fk", "psm", "0"])


def test_an_interruption_says_so(trocar, monkeypatch):
    def interrupt(_args):
        raise KeyboardInterrupt

    monkeypatch.setattr(fk, "run", interrupt)
    answer = trocar("fk", "psm", 0)
    assert (answer.status, answer.err) == (130, "trocar: interrupted\n")


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "the following arguments are required: COMMAND (see trocar --help)"),
        (["fly"], "argument COMMAND: invalid choice: 'fly'"),
        (["fk"], "fk: the following arguments are required: ARM, Q (see trocar fk --help)"),
        (["fk", "psm", "much"], "fk: argument Q: got 'much'; allowed: a number"),
        (["fk", "psm", "-much"], "fk: the following arguments are required: Q"),
        (["list", "arms", "--all"], "unrecognized arguments: --all"),
        (["list", "legs"], "list: argument arms|tools|rigs|cameras: invalid choice: 'legs'"),
    ],
)
def test_a_command_line_that_cannot_be_read_is_refused_in_one_line(words, complaint, trocar):
    answer = trocar(*words)
    assert answer.status == 2
    assert answer.complaint.startswith(complaint)


def test_a_number_is_no_option():
    numbers = ["-1", "-.5", "-1.2e-05", "-1E3", "-inf", "-nan"]
    assert keep_negative_numbers(numbers) == [f" {n}" for n in numbers]
    assert keep_negative_numbers(["-h", "--json", "--", "1e3"]) == ["-h", "--json", "--", "1e3"]
