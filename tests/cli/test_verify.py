"""`trocar verify`: one document or tables, and a status that says whether all is well."""

from __future__ import annotations

from pathlib import Path

import pytest

KEYS = ["part", "arm", "name", "value", "unit", "paper", "paper_simulation", "hardware",
        "nominal", "tolerance", "met", "source", "command"]  # fmt: skip


def test_one_document_has_every_figure(trocar) -> None:
    said = trocar("verify", "--only", "axes,formats", "--arm", "psm", "--json")
    assert said.status == 0
    assert list(said.document) == [
        "met",
        "judged",
        "stated",
        "missed",
        "figures",
        "parts",
        "report",
    ]
    assert said.document["met"] is True
    first = said.document["figures"][0]
    assert list(first) == KEYS
    assert first["part"] == "axes" and first["arm"] == "psm"
    assert first["value"] == pytest.approx(0.096)
    assert (first["unit"], first["paper"]) == ("m", 0.0958)
    assert first["tolerance"]["upper"] == pytest.approx(0.0958 + 1.31e-3)
    assert first["command"] == "trocar verify --only axes --arm psm"
    assert "trocar: verifying psm: formats ..." in said.err
    assert [p["part"] for p in said.document["parts"]] == ["axes", "formats"]


def test_people_read_tables(trocar) -> None:
    said = trocar("verify", "--only", "axes", "--arm", "ecm")
    assert said.status == 0
    for text in ("ecm: Axis distances: Table 6 of the paper", "3-6: in motion", "304.7", "met",
                 "16 of 16 figures with a tolerance are within it."):  # fmt: skip
        assert text in said.out


def slow_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave one speed to measure, beside a paper's that no machine reaches."""
    one = (("PSM", "psm", "braked", 1e9, 1e9),)
    monkeypatch.setattr("trocar.robot.verification.tracking.CONFIGURATIONS", one)
    monkeypatch.setattr("trocar.robot.verification.tracking.PAPER_CAMERA", 1e9)
    monkeypatch.setattr("trocar.robot.verification.tracking.REALTIME_S", 0.05)


def test_figures_without_a_tolerance_are_counted_apart(trocar, monkeypatch) -> None:
    slow_machine(monkeypatch)
    words = ("verify", "--only", "axes,realtime", "--arm", "psm")
    document = trocar(*words, "--json").document
    without = sum(figure["tolerance"] is None for figure in document["figures"])
    assert without > 0
    assert (document["met"], document["judged"], document["stated"]) == (True, 16, without)
    last = trocar(*words).out.splitlines()[-1]
    assert last == f"16 of 16 figures with a tolerance are within it; {without} more have none."


def test_nothing_is_met_where_no_figure_has_a_tolerance(trocar, monkeypatch) -> None:
    slow_machine(monkeypatch)
    document = trocar("verify", "--only", "realtime", "--json").document
    assert (document["met"], document["judged"]) == (None, 0)
    last = trocar("verify", "--only", "realtime").out.splitlines()[-1]
    assert last == f"No figure has a tolerance; {document['stated']} are stated without."


def test_a_figure_out_of_tolerance_ends_with_status_1(trocar, monkeypatch) -> None:
    monkeypatch.setattr("trocar.robot.verification.linkage.TABLE6_SPREAD_M", 1e-4)
    said = trocar("verify", "--only", "axes", "--arm", "psm", "--json")
    assert said.status == 1
    assert said.document["met"] is False
    assert "3-6: description" in said.document["missed"]
    assert "MISSED" in trocar("verify", "--only", "axes", "--arm", "psm").out


def test_a_machine_too_slow_for_real_time_does_not_change_the_status(trocar, monkeypatch) -> None:
    slow_machine(monkeypatch)
    said = trocar("verify", "--only", "realtime", "--json")
    assert said.status == 0 and said.document["missed"] == []
    speed = said.document["figures"][0]
    assert 0.0 < speed["value"] < speed["paper_simulation"] == 1e9


def test_a_report_is_named(trocar, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    said = trocar("verify", "--only", "formats", "--arm", "psm", "--report", tmp_path / "r")
    assert said.status == 0
    assert said.out.splitlines()[-1] == str(tmp_path / "r" / "index.html")
    assert (tmp_path / "r" / "index.html").is_file()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--only", "axes,speed"], "argument --only: got 'speed'; allowed: closure, rcm, axes"),
        (["--arm", "pms"], "unknown arm 'pms'"),
        (["--only", "tracking", "--arm", "ecm"], "nothing of tracking applies to ecm"),
        (["--calibration", "none.toml"], "none.toml: cannot be read"),
    ],
)
def test_bad_input_is_one_line(trocar, words: list[str], complaint: str) -> None:
    said = trocar("verify", *words)
    assert said.status == 2
    assert said.out == ""
    assert complaint in said.err.splitlines()[-1]
