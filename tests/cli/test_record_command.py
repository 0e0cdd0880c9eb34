"""`trocar sim --record`, and what `trocar replay` makes of the file."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from trocar.simulation import World
from trocar.simulation.recording import open_recording

pytest.importorskip("mcap")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    world, file = World("psm"), tmp_path / "run.mcap"
    with world.record(file):
        world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
        world.step(900)
    return file


def test_a_headless_run_is_recorded_and_repeated(trocar, tmp_path):
    file = tmp_path / "run.mcap"
    words = ("sim", "--headless", "--rig", "psm", "--duration", "0.2", "--json", "--record", file)
    assert trocar(*words).status == 0
    assert open_recording(file).rows == 201
    document = trocar("replay", file, "--json").document
    assert document["identical"] is True
    assert (document["rig"], document["periods"]) == ("psm", 201)


def test_a_live_run_is_recorded(trocar, tmp_path):
    file = tmp_path / "run.mcap"
    live = (
        "sim",
        "--rig",
        "psm",
        "--port",
        "0",
        "--websocket-port",
        "0",
        "--speed",
        "max",
        "--duration",
        "0.1",
    )
    assert trocar(*live, "--record", file).status == 0
    recorded = open_recording(file)
    assert recorded.problem == "" and recorded.end == pytest.approx(0.1)


def test_people_are_told_that_the_motion_is_the_same(trocar, file):
    answer = trocar("replay", file)
    assert answer.status == 0
    assert "1 commands, 901 periods (0.900 s)" in answer.out
    assert "identical to the last bit (digest " in answer.out


def test_people_are_told_how_far_a_motion_is_off(trocar, tmp_path):
    file, world = tmp_path / "run.mcap", World("psm")
    with world.record(file):
        world._servos.table[0, 0] += 0.1
        world.step(900)
    answer = trocar("replay", file)
    assert answer.status == 1
    assert "the motion DIFFERS from 0.000 s on; largest difference: " in answer.out
    assert "of PSM1/yaw" in answer.out
    assert trocar("replay", file, "--json").document["difference"]["joint"] == "PSM1/yaw"


def test_a_truncated_file_is_repeated_with_a_warning(trocar, file):
    file.write_bytes(file.read_bytes()[:-20_000])
    answer = trocar("replay", file)
    assert answer.status == 0
    assert f"warning: {file}: it breaks off" in answer.err


def test_bad_input_is_one_line(trocar, file, tmp_path, monkeypatch):
    answer = trocar("replay", file, "--rig", "ecm")
    assert answer.status == 2
    assert "is a recording of rig 'psm'" in answer.complaint
    assert "here rig 'ecm' has" in answer.complaint
    answer = trocar("sim", "--headless", "--rig", "psm", "--record", tmp_path / "no" / "x.mcap")
    assert (answer.status, "cannot be written" in answer.complaint) == (2, True)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"\x89MCAP0\r\n" + bytes(30))
    assert trocar("replay", broken).status == 2
    monkeypatch.setitem(sys.modules, "mcap", None)
    answer = trocar("sim", "--headless", "--rig", "psm", "--record", tmp_path / "x.mcap")
    assert answer.status == 1
    assert "pip install 'trocar[record]'" in answer.complaint


def test_a_recording_is_drawn(trocar, file, tmp_path):
    pytest.importorskip("matplotlib")
    answer = trocar("plot", file)
    assert (answer.status, answer.out) == (0, f"{file.with_suffix('.png')}\n")
    assert trocar("plot", file, "-o", tmp_path / "x.html", "--joint", "yaw").status == 0
    answer = trocar("plot", file, "--arm", "PSM7")
    assert (answer.status, "known: PSM1" in answer.complaint) == (2, True)
