"""The program: its subcommands, its exit status, and its one line for whatever goes wrong."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import trocar as package
from trocar.cli import fk, main, output
from trocar.cli.arguments import keep_negative_numbers
from trocar.cli.output import progress_bar, progress_steps
from trocar.cli.program import COMMANDS
from trocar.errors import DivergedError

ROOT = Path(__file__).parents[2]
CLI = ROOT / "src" / "trocar" / "cli"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / "src")}


def start(*words: str) -> subprocess.Popen[bytes]:
    """Start the command line in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "trocar", *words],
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def test_help_names_every_command(capsys):
    with pytest.raises(SystemExit) as end:
        main(["--help"])
    told = capsys.readouterr().out
    assert not end.value.code
    for name, summary in COMMANDS.items():
        assert f"  {name}" in told and summary in told


def test_every_module_that_runs_is_a_command():
    modules = {path.stem for path in CLI.glob("*.py") if "\ndef run(args" in path.read_text()}
    assert {name.replace("-", "_") for name in COMMANDS} == modules


def test_without_a_command_the_help_is_printed(trocar):
    answer = trocar()
    assert (answer.status, answer.err) == (0, "")
    assert answer.out.startswith("usage: trocar") and COMMANDS["sim"] in answer.out


def test_every_command_explains_itself(capsys):
    for name in COMMANDS:
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
    assert process.wait(timeout=60) == 141
    process.stderr.close()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no device that is always full")
@pytest.mark.parametrize("words", [("--help",), ("show", "psm")])
@pytest.mark.parametrize("where", ["> /dev/full", ">&-"])
def test_output_that_cannot_be_written_is_one_line_and_exit_1(words, where):
    line = " ".join(["exec", sys.executable, "-m", "trocar", *words, where])
    done = subprocess.run(["sh", "-c", line], env=ENVIRONMENT, capture_output=True, timeout=60)
    assert (done.returncode, done.stdout) == (1, b"")
    last = done.stderr.decode().splitlines()[-1]
    assert last.startswith("trocar: error: output cannot be written: ")
    assert b"Traceback" not in done.stderr


def test_an_error_that_cannot_be_printed_keeps_its_status():
    line = " ".join(["exec", sys.executable, "-m", "trocar", "fk", "nobody", "2>&-"])
    done = subprocess.run(["sh", "-c", line], env=ENVIRONMENT, capture_output=True, timeout=60)
    assert (done.returncode, done.stdout) == (2, b"")


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
        (["--all"], "the following arguments are required: COMMAND (see trocar --help)"),
        (["fly"], "unknown command 'fly'; known: sim, play, "),
        (["simm"], "unknown command 'simm' (did you mean 'sim'?); known: sim, "),
        (
            ["learn", "trian"],
            "unknown command 'learn trian' (did you mean 'learn train'?); known: learn collect, ",
        ),
        (["fk"], "fk: the following arguments are required: ARM, Q (see trocar fk --help)"),
        (["fk", "psm", "much"], "fk: argument Q: got 'much'; allowed: a number"),
        (["fk", "psm", "-much"], "fk: the following arguments are required: Q"),
        (["list", "arms", "--all"], "unrecognized arguments: --all"),
        (["list", "legs"], "list: argument arms|tools|rigs|cameras|scenes: invalid choice: 'legs'"),
    ],
)
def test_a_command_line_that_cannot_be_read_is_refused_in_one_line(words, complaint, trocar):
    answer = trocar(*words)
    assert answer.status == 2
    assert answer.complaint.startswith(complaint)


def completed(line: str) -> list[str]:
    """Ask bash what it would complete a line with, a space at its end for a new word."""
    words = line.split(" ")
    typed = " ".join(f"'{word}'" for word in words)
    script = (
        f"{run_completion('bash')}\nCOMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; _trocar;"
        ' printf "%s\\n" "${COMPREPLY[@]}"'
    )
    found = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    assert not found.stderr
    return found.stdout.split()


def run_completion(shell: str) -> str:
    process = start("completion", shell)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, b"")
    return out.decode()


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_commands_options_and_names():
    assert completed("trocar re") == ["render", "replay"]
    assert completed("trocar sim --hea") == ["--headless"]
    assert "two_psm_ecm" in completed("trocar sim --rig ")
    assert completed("trocar sim --speed ") == ["realtime", "max"]
    assert completed("trocar fk ps") == ["psm", "psm_si"]
    assert completed("trocar sim --record ") == []  # bash completes file names by itself


def test_zsh_takes_the_completion_of_bash_and_fish_has_its_own():
    assert run_completion("zsh").startswith("autoload -Uz bashcompinit")
    fish = run_completion("fish").splitlines()
    assert all(line.startswith("complete -c trocar ") for line in fish)
    sim = [line for line in fish if "__fish_seen_subcommand_from sim'" in line]
    assert any(" -l rig -a " in line and "two_psm_ecm" in line for line in sim)


class Terminal(io.StringIO):
    """A stderr that somebody watches."""

    def isatty(self) -> bool:
        return True


def test_long_work_has_a_bar_with_an_estimate_on_a_terminal(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar("rows") as watch:
        watch(1, 4)
        watch(4, 4)
    with progress_steps("measuring", 3) as announce:
        announce("speed")
        announce("start-up")
    drawn = screen.getvalue()
    assert "1 of 4 rows" in drawn and "4 of 4 rows" in drawn and "left" in drawn
    assert "measuring speed" in drawn and "measuring start-up" in drawn


def test_elsewhere_long_work_prints_a_line_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr(output, "LINE_S", 0.01)

    def printed(line: str) -> bool:
        lines.extend(capsys.readouterr().err.splitlines())
        return line in lines

    lines: list[str] = []
    with progress_bar("rows") as watch:
        watch(1, 4)
        while not printed("trocar: 1 of 4 rows ..."):
            time.sleep(0.01)
    with progress_steps() as announce:
        announce("reading")
        while not printed("trocar: reading ..."):
            time.sleep(0.01)
    assert len(lines) == 2
    with progress_steps("measuring") as announce:
        announce("speed")
        assert printed("trocar: measuring speed ...")


def test_elsewhere_short_work_prints_nothing(capsys):
    with progress_bar("rows") as watch:
        watch(1, 4)
    with progress_steps() as announce:
        announce("reading")
    assert capsys.readouterr().err == ""


def test_a_number_is_no_option():
    numbers = ["-1", "-.5", "-1.2e-05", "-1E3", "-inf", "-nan"]
    assert keep_negative_numbers(numbers) == [f" {n}" for n in numbers]
    assert keep_negative_numbers(["-h", "--json", "--", "1e3"]) == ["-h", "--json", "--", "1e3"]
