"""`python -m benchmarks`: its documents, tables and errors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.__main__ import main


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
