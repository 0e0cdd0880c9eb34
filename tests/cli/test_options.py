"""Options that do nothing in a mode are refused: a walk through every option of every command."""

from __future__ import annotations

from argparse import Action, ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from trocar.cli import main
from trocar.cli.arguments import Parser
from trocar.cli.program import COMMANDS, build_parser

SOCKET = "--duration 0.05 --speed max --websocket-port 0"
#: Modes of each command, and a quick run in each; {s} are samples, {o} is a new folder.
MODES = {
    "sim --headless": "--rig psm --duration 0.05",
    "sim --headless --record {o}/a.mcap": "--rig psm --duration 0.05",
    "sim": f"--rig psm --port 0 {SOCKET}",
    "sim --no-page": f"--rig psm {SOCKET}",
    "sim --no-websocket": "--rig psm --port 0 --duration 0.05 --speed max",
    "play peg-board --headless": "--duration 0.02",
    "play peg-board --no-page": SOCKET,
    "play suturing --headless": "--duration 0.02",
    "run --speed max {o}/script.py": "--rig psm",
    "run {o}/script.py": "--rig psm",
    "teleop": "--rig psm --port 0 --websocket-port 0 --duration 0.05",
    "mirror --no-page --bag {s}/psm.bag": "--rig psm",
    "replay {s}/psm_log.csv.gz": "",
    "replay --mode effort {s}/psm_log.csv.gz": "",
    "replay {s}/psm.bag": "",
    "replay {s}/run.mcap": "",
    "view {s}/run.mcap": "--port 0 --duration 0.05",
    "view {s}/psm_log.csv.gz": "--port 0 --duration 0.05",
    "score {s}/run.mcap": "",
    "plot {s}/run.mcap": "-o {o}/a.html",
    "predict {s}/psm_log.csv.gz": "",
    "mocap --motion kinematic": "--arm psm -o {o}/a.csv --duration 6",
    "touches": "--arm PSM1=psm -o {o}/a.toml",
    "touches --boards": "--arm PSM1=psm -o {o}/a.toml",
    "views": "-o {o}/views --count 3",
    "excite": "-o {o}/a.csv --candidates 1",
    "calibrate {s}/tracks.csv": "--arm psm",
    "calibrate-bases {s}/touches.toml": "",
    "rcm {s}/tracks.csv": "--arm psm",
    "fk psm 0 0 0.1 0 0 0": "",
    "ik psm 0 0 -0.1 0 1 0 0": "",
    "list arms": "",
    "show psm": "",
    "export psm --format urdf": "-o {o}/urdf",
    "export psm --format mjcf": "-o {o}/mjcf",
    "import {s}/pointer.urdf": "-o {o}/pointer",
    "import {o}/block.obj": "-o {o}/block --hull",
    "sample": "{o}/samples",
    "verify": "--only closure --arm psm",
    "completion bash": "",
}
#: Modes that take longer.
SLOW = {
    "calibrate-paper": "--arm psm",
    "calibrate-plan": "--arm psm --duration 6",
    "bench core": "",
    "bench speed": "--duration 0.02 --passes 1",
    "tune psm": "--joint roll",
}
#: Modes that draw with OpenGL.
DRAWN = {
    "show psm --picture {o}/pictures": "",
    "render -o {o}/a.png": "--rig two_psm_ecm",
    "render -o {o}/a.png --show depth": "--rig two_psm_ecm",
}
#: Commands whose modes need files that are too large, or devices, or train for minutes.
ELSEWHERE = {"calibrate-camera", "conform", "identify", "import-dvrk", "track"}
ELSEWHERE |= {name for name in COMMANDS if name.startswith("learn-")}
#: Exclude each other and are required, so that argparse refuses them.
SOURCES = {"ros1", "ros2", "websocket", "bag"}
BLOCK = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


class Arguments(Namespace):
    """Arguments of a command that note which of them are read."""

    reads: set[str] = set()  # noqa: RUF012  of all instances

    def __getattribute__(self, name: str) -> Any:
        Arguments.reads.add(name)
        return super().__getattribute__(name)


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("samples")
    assert main(["sample", str(folder)]) == 0
    words = ["--rig", "psm", "--duration", "0.1", "--record", str(folder / "run.mcap")]
    assert main(["sim", "--headless", *words]) == 0
    return folder


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Return the set of arguments that a command reads, filled as it runs."""

    def parse(self: ArgumentParser, words: list[str]) -> Namespace:
        found, rest = self.parse_known_args(words)
        assert not rest
        return Arguments(**vars(found))

    monkeypatch.setattr(Parser, "parse_args", parse)
    monkeypatch.setattr(Arguments, "reads", set())
    return Arguments.reads


def arguments_of(command: str) -> list[Action]:
    return build_parser().commands[command].arguments


def given(action: Action) -> list[str]:
    """Return an option with a value that its parser accepts."""
    if action.nargs == 0:
        return [action.option_strings[-1]]
    value = str(list(action.choices)[-1]) if action.choices else "1"
    for example in ("1", "PSM1=x", "1@x", "0.5,2", "0,0,0"):
        if action.type is None or action.choices:
            break
        try:
            action.type(example)  # type: ignore[operator]
        except Exception:  # noqa: BLE001  what a type raises is argparse's matter
            continue
        value = example
        break
    return [
        action.option_strings[-1],
        *[value] * (action.nargs if type(action.nargs) is int else 1),
    ]


def unread(command: str, words: list[str], read: set[str]) -> Iterator[Action]:
    """Yield the options that are not on the command line and that a run did not read."""
    for action in arguments_of(command):
        names = action.option_strings
        if names and not set(names) & set(words) and action.dest not in {*read, "help", *SOURCES}:
            yield action


def walk(mode: str, more: str, folders: dict[str, Path], read: set[str], capsys: Any) -> None:
    words, rest = (text.format(**folders).split() for text in (mode, more))
    assert main([*words, *rest]) == 0, capsys.readouterr().err
    options = list(unread(words[0], [*words, *rest], read))
    taken: list[str] = []
    for action in options:
        capsys.readouterr()
        status = main([*words, *rest, *given(action)])
        complaint = capsys.readouterr().err.splitlines()[-1]
        name = action.option_strings[-1]
        if status != 2 or name not in complaint or f"argument {name}" in complaint:
            taken.append(f"{name} ({complaint})")
    assert not taken, "\n".join(taken)


@pytest.fixture
def folders(samples: Path, tmp_path: Path) -> dict[str, Path]:
    (tmp_path / "script.py").write_text("pass\n")
    (tmp_path / "block.obj").write_text(BLOCK)
    return {"s": samples, "o": tmp_path}


@pytest.mark.parametrize("mode", MODES)
def test_an_option_that_a_mode_does_not_read_is_refused(
    mode: str, folders: dict[str, Path], read: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    walk(mode, MODES[mode], folders, read, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("mode", SLOW)
def test_an_option_that_a_slow_mode_does_not_read_is_refused(
    mode: str, folders: dict[str, Path], read: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    walk(mode, SLOW[mode], folders, read, capsys)


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("mode", DRAWN)
def test_an_option_that_a_drawing_mode_does_not_read_is_refused(
    mode: str, folders: dict[str, Path], read: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    walk(mode, DRAWN[mode], folders, read, capsys)


def test_every_command_is_walked_through() -> None:
    walked = {mode.split()[0] for mode in (*MODES, *SLOW, *DRAWN)}
    assert walked | ELSEWHERE == set(COMMANDS)


@pytest.mark.parametrize(
    ("words", "option", "allowed"),
    [
        ("sim --rig psm --no-page --websocket-port 0 --port 1", "--port", "without --no-page"),
        ("sim --rig psm --no-websocket --port 0 --websocket-port 1", "--websocket-port", "without"),
        ("sim --rig psm --no-websocket --port 0 --rate 10", "--rate", "with a client"),
        ("sim --rig psm --port 0 --foxglove-port 1", "--foxglove-port", "with --foxglove"),
        ("sim --rig two_psm_ecm --no-cameras --port 0 --jpeg 5", "--jpeg", "with cameras"),
        ("sim --headless --rig psm --no-page", "--no-page", "without --headless"),
        ("sim --headless --ros1", "--ros1", "with --no-page in place of --headless"),
        ("sim --headless --ros2", "--ros2", "with --no-page in place of --headless"),
        ("sim --headless --foxglove", "--foxglove", "with --no-page in place of --headless"),
        ("play peg-board --headless --port 8080", "--port", "without --headless"),
        (
            "play peg-board --headless --noise 0",
            "--noise",
            "without --headless, or with --record-i",
        ),
        ("play peg-board --headless --register points", "--register", "with the scene suturing"),
        ("play peg-board --episodes 1", "--episodes", "with --headless"),
        (
            "play peg-board --headless --cluster a:1 --workers 1",
            "--workers",
            "without --cluster HO",
        ),
        ("run script.py --overwrite", "--overwrite", "with --record"),
        ("bench core --passes 2", "--passes", "with PART speed"),
        ("bench fidelity --robots 2", "--robots", "with PART calibration"),
        ("calibrate-paper --arm psm --overwrite", "--overwrite", "with --output"),
        ("track --camera 0 --calibration dvrk --left a", "--left", "with --bag"),
        ("calibrate-camera views.toml --overwrite", "--overwrite", "with --output or --ros"),
        ("verify --overwrite", "--overwrite", "with --report"),
    ],
)
def test_the_refusal_names_the_option_and_when_it_is_allowed(
    words: str,
    option: str,
    allowed: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("script.py").write_text("pass\n")
    assert main(words.split()) == 2
    complaint = capsys.readouterr().err.splitlines()[-1]
    assert complaint.startswith(f"trocar: error: {option}: has no effect here; allowed {allowed}")


def test_a_default_that_is_given_is_refused_as_any_value_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["sim", "--headless", "--rig", "psm", "--port", "8080"]) == 2
    assert "--port: has no effect here; allowed without --headless only" in capsys.readouterr().err
