"""trocar import-dvrk from the command line."""

from __future__ import annotations

import json
from pathlib import Path

from tests.cli.conftest import Command

PSM = {"kinematic": "kinematic/PSM.json", "generation": "Classic", "hat": 1}
SYSTEM = {"arms": [{"name": "PSM1", "type": "PSM", "serial": "1", "IO": "IO1"}]}


def lab(folder: Path) -> str:
    (folder / "system-x.json").write_text(json.dumps(SYSTEM))
    (folder / "PSM1-1.json").write_text(json.dumps(PSM))
    return str(folder / "system-x.json")


def test_json_tells_all_of_it(trocar: Command, tmp_path: Path) -> None:
    target = str(tmp_path / "rig.toml")
    answer = trocar("import-dvrk", lab(tmp_path), "-o", target, "--json")
    assert answer.status == 0
    told = answer.document
    assert told["rig"] == target
    (arm,) = told["arms"]
    assert (arm["name"], arm["type"], arm["tool"]) == ("PSM1", "PSM", "LARGE_NEEDLE_DRIVER:400006")
    assert told["unknown"] == [f"{tmp_path / 'PSM1-1.json'}: hat"]
    assert told["not_simulated"] == [f"{tmp_path / 'system-x.json'}: arms[].IO"]
    assert {kind: gap["count"] for kind, gap in told["agreement"].items()} == dict.fromkeys(
        ("bases", "chains", "tips", "cameras", "setup_joints", "limits"), 0
    )  # a PSM that stands nowhere, of which no file is here
    assert "unknown key, ignored" in answer.err


def test_bad_input_is_one_line(trocar: Command, tmp_path: Path) -> None:
    (tmp_path / "PSM1-1.json").unlink(missing_ok=True)
    (tmp_path / "system-x.json").write_text(json.dumps(SYSTEM))
    answer = trocar("import-dvrk", str(tmp_path / "system-x.json"), "-o", str(tmp_path / "r.toml"))
    assert answer.status == 2
    assert "arms[0].serial: got 'PSM1-1.json', not found in" in answer.complaint
    answer = trocar("import-dvrk", lab(tmp_path), "-o", "x.toml", "--tool", "PSM1")
    assert answer.status == 2
    assert "allowed: PSM=TOOL" in answer.complaint
