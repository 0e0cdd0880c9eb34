"""`python -m benchmarks`: its documents, tables and errors."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.experiments import EXPERIMENTS
from trocar.robot.experiments import BENCHED, VERIFIED, Experiment


def test_a_soak_is_one_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["soak", "--duration", "0.02", "--json"]) == 0
    printed = capsys.readouterr()
    assert "measuring soak: 0.02 of 0.02 s ..." in printed.err
    figures = json.loads(printed.out)["figures"]
    assert "soak: commands rejected or clipped" in [figure["name"] for figure in figures]
    assert {"name", "value", "unit", "tolerance", "met", "source"} <= set(figures[0])


def test_the_cost_of_recording_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mcap", reason="the extra record is not installed")
    assert main(["recording", "--duration", "0.5", "--passes", "1", "--json"]) == 0
    found = {f["name"]: f for f in json.loads(capsys.readouterr().out)["figures"]}
    assert found["recording: added in the stepping thread"]["tolerance"]["upper"] == 8.0
    minute = found["recording: a simulated minute"]
    assert 0.0 < minute["value"] <= minute["tolerance"]["upper"] == 40.0


def test_people_get_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["soak", "--duration", "0.01"]) == 0
    out = capsys.readouterr().out
    assert "soak: branch flips" in out and "<= 0" in out and "met" in out


def test_a_duration_of_nothing_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["soak", "--duration", "0"]) == 2
    assert "allowed: above 0" in capsys.readouterr().err


def test_a_soak_is_plotted(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra plot is not installed")
    assert main(["soak", "--duration", "0.02", "-o", str(tmp_path / "soak.png"), "--json"]) == 0
    assert (tmp_path / "soak.png").read_bytes()[:4] == b"\x89PNG"


def test_a_plot_of_another_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["startup", "-o", "x.png"]) == 2
    assert "--output: allowed with soak or assistance only" in capsys.readouterr().err


@pytest.mark.parametrize("row", [*EXPERIMENTS, *BENCHED, *VERIFIED], ids=lambda e: e.home)
def test_a_row_of_a_registry_names_a_function_that_takes_its_options(row: Experiment) -> None:
    parameters = inspect.signature(row.load()).parameters
    required = {n for n, p in parameters.items() if p.default is p.empty}
    assert {*row.options.values(), *row.defaults} <= parameters.keys()
    if row not in VERIFIED:
        assert required <= {"watch", *row.options.values()}


def test_an_option_of_none_of_the_experiments_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["startup", "--scene", "peg-board"]) == 2
    assert "--scene: allowed with tasks or random-actions only" in capsys.readouterr().err
    assert main(["laws", "--only", "tips"]) == 2
    assert "--only: allowed with learning or vision only" in capsys.readouterr().err


def test_a_part_of_another_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["vision", "--only", "reach"]) == 2
    assert "--only: got reach with vision; allowed: hand-eye" in capsys.readouterr().err
    assert main(["nothing"]) == 2
    assert "argument NAME: got 'nothing'; allowed: startup, recording" in capsys.readouterr().err
