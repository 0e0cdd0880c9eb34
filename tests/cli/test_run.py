"""`trocar run` as a person types it: whose word is whose, what is printed, what the page shows."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import pytest

from trocar.cli import main

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "scripts.md"
TELL = "import sys, crtk\nprint(crtk.ral.parse_argv(sys.argv[1:]))\n"


@pytest.fixture
def script(tmp_path: Path) -> str:
    path = tmp_path / "tell.py"
    path.write_text(TELL, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("before", "after", "own"),
    [
        ("--speed max --rig psm", "-a PSM1 --rig ecm", ["-a", "PSM1", "--rig", "ecm"]),
        ("", "--speed max --rig=psm -p -0.01", ["-p", "-0.01"]),
        ("--speed max", "--rig psm -- --rig ecm", ["--rig", "ecm"]),
        ("--speed max --rig psm", "--help", ["--help"]),
        ("--speed max --rig psm", "", []),
        ("--speed max --rig psm --no-cameras", "-a PSM1", ["-a", "PSM1"]),
        ("--speed max --rig ecm --no-shadows --camera-rate 20", "-a ECM", ["-a", "ECM"]),
    ],
)
def test_the_first_word_that_is_no_option_is_the_scripts(
    script: str, capsys: pytest.CaptureFixture[str], before: str, after: str, own: list[str]
) -> None:
    assert main(["run", *before.split(), script, *after.split()]) == 0
    assert capsys.readouterr().out == f"{own}\n"


def test_the_last_line_tells_the_rig_and_how_long_it_took(
    script: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "--speed", "max", script, "PSM1"]) == 0
    said = capsys.readouterr().err.splitlines()[-1]
    assert re.fullmatch(r"trocar: tell\.py: rig psm, 0\.0 s simulated in \d+\.\d s", said)


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["nowhere.py"], 2, "nowhere.py: no such file"),
        ([], 2, "required: SCRIPT.py"),
        (["--speed"], 2, "--speed: expected one argument"),
        (["--timeout", "0", "SCRIPT"], 2, "--timeout: got 0; allowed: above 0 s"),
        (["--rig", "nope", "SCRIPT"], 2, "unknown rig 'nope'"),
        (["--rate", "2000", "--speed", "max", "--rig", "psm", "SCRIPT"], 2, "got 2000 Hz"),
    ],
)
def test_what_cannot_be_run_is_named(
    script: str, capsys: pytest.CaptureFixture[str], words: list[str], status: int, said: str
) -> None:
    assert main(["run", *(script if word == "SCRIPT" else word for word in words)]) == status
    assert said in capsys.readouterr().err


def test_a_script_that_takes_too_long_ends_with_status_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "late.py"
    path.write_text("import time\ntime.sleep(60)\n", encoding="utf-8")
    assert main(["run", "--speed", "max", "--rig", "psm", "--timeout", "2", str(path)]) == 1
    said = capsys.readouterr().err
    assert (
        said == "trocar: error: late.py: not finished after 2 s; it was at line 2: time.sleep(60)\n"
    )


def trocar(words: list[str], folder: Path) -> str:
    result = subprocess.run(
        [sys.executable, "-c", "from trocar.cli import main; raise SystemExit(main())", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.slow
def test_the_page_runs_as_written(tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="the extra `record` is not there")
    pytest.importorskip("matplotlib", reason="the extra `plot` is not there")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    page = PAGE.read_text(encoding="utf-8")
    blocks = re.findall(r"^```\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    first, printed, more, node, followed, *_ = blocks
    assert trocar(shlex.split(first)[1:], tmp_path) == printed
    assert trocar([*shlex.split(node)[1:]], tmp_path) == followed
    for line in more.splitlines():
        trocar(shlex.split(line)[1:], tmp_path)
    assert (tmp_path / "circle.png").stat().st_size > 50_000


def test_a_page_needs_the_wall_clock(script: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--page", "--speed", "max", script]) == 2
    assert "--page: got --speed max; allowed: --speed realtime" in capsys.readouterr().err


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_the_page_is_served_beside_the_script(tmp_path: Path, host: str) -> None:
    pytest.importorskip("viser", reason="the page's library is not there")
    path = tmp_path / "short.py"
    path.write_text("import time\nprint('PSM1', flush=True)\ntime.sleep(0.5)\n", encoding="utf-8")
    code = "from trocar.cli import main; raise SystemExit(main())"
    with subprocess.Popen(
        [sys.executable, "-c", code, "run", "--page", "--port", "0", "--host", host, str(path)],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src"), "XDG_RUNTIME_DIR": str(tmp_path)},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        said: list[str] = []
        for line in process.stderr:
            said.append(line)
            if line.startswith("http://127"):
                with urlopen(line.split()[0]) as page:
                    assert page.status == 200
            if "script finished" in line:
                process.terminate()
        assert process.wait(30.0) == 0, said
    assert said[0].startswith("http://127.0.0.1:")
    assert ("watch, request control" in said[1]) == (host == "0.0.0.0")
    assert said[-1].startswith("trocar: short.py: rig psm")


def test_the_script_on_the_page_is_short_and_says_what_one_sees() -> None:
    text = (ROOT / "examples" / "scripts" / "circle.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    assert "\nOne sees: " in text
