"""The page on learning and the examples of learning run as they are written."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest

from trocar.learning.actions import KINDS
from trocar.learning.ids import ORBIT, SURROL
from trocar.learning.rewards import REWARDS
from trocar.learning.task_env import OBSERVATIONS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "learning.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
EXAMPLES = ROOT / "examples" / "learning"


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_the_page_runs(block: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(block, "learning.md", "exec"), {})
    said = capsys.readouterr().out
    assert said
    assert "False" not in said


def test_the_page_names_every_kind() -> None:
    for name in (*KINDS, *OBSERVATIONS, *REWARDS):
        assert f'"{name}"' in PAGE, name
    for name in SURROL:
        assert name in PAGE
    for name in ORBIT:
        assert re.sub("-IK-(Abs|Rel)", "", name) in PAGE
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(
        re.findall(r"examples/learning/(\w+\.py)", PAGE)
    )


def run(name: str, *arguments: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_the_script_for_surrol_reaches(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run("surrol.py", monkeypatch=monkeypatch)
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 3
    assert all(": success after" in line and line.endswith("reward 0") for line in said)


def test_the_script_for_stable_baselines3_trains(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("stable_baselines3", reason="the script trains with it")
    run("sac_her.py", "110", monkeypatch=monkeypatch)
    assert re.fullmatch(r"110 steps: \d+ of 10 episodes succeed\n", capsys.readouterr().out)
