"""`trocar sim --record`, and what `trocar replay` makes of the file."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from trocar.recording import open_recording, record
from trocar.simulation import World

mcap_writer = pytest.importorskip("mcap.writer")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    world, file = World("psm"), tmp_path / "run.mcap"
    with record(world, file):
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


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that something else listens on."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        yield other.getsockname()[1]


SCRIPT = "import crtk\ncrtk.ral('idle')\n"


@pytest.mark.parametrize(
    "words",
    [
        ("sim", "--no-page", "--websocket-port"),
        ("sim", "--no-websocket", "--port"),
        ("teleop", "--websocket-port", "0", "--port"),
        ("run", "--page", "--port"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_a_start_that_is_refused_for_its_port_leaves_a_recording_alone(
    trocar, file, taken, tmp_path, words
):
    command, *more = words
    (tmp_path / "idle.py").write_text(SCRIPT)
    script = [tmp_path / "idle.py"] if command == "run" else []
    rig = ("--rig", "psm") if command != "teleop" else ("--rig", "two_psm_ecm")
    before = file.read_bytes()
    record = ("--record", file, "--overwrite")
    answer = trocar(command, *rig, *record, *more, taken, *script)
    assert (answer.status, "port" in answer.err) == (2, True)
    assert file.read_bytes() == before


@pytest.mark.parametrize("way", [("--headless",), ("--port", "0", "--websocket-port", "0")])
def test_a_file_that_exists_is_replaced_only_with_overwrite(trocar, file, way):
    before = file.read_bytes()
    words = ("sim", "--rig", "psm", "--duration", "0.1", *way, "--record", file)
    answer = trocar(*words)
    assert answer.status == 2
    assert f"{file}: exists already; allowed: a new file" in answer.err
    assert "--overwrite" in answer.err
    assert file.read_bytes() == before
    assert trocar(*words, "--overwrite").status == 0
    assert open_recording(file).end == pytest.approx(0.1)


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of file sizes")
@pytest.mark.parametrize(
    ("way", "seconds", "room"),
    [
        (("--headless",), 10, 400_000),  # the table of its trajectory takes half of it
        (("--no-page", "--websocket-port", "0"), 60, 100_000),
    ],
    ids=["headless", "live"],
)
def test_a_run_whose_recording_fails_ends_with_1_and_says_from_when(
    trocar, tmp_path, way, seconds, room
):
    import resource

    file = tmp_path / "run.mcap"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        words = ("sim", "--rig", "psm", "--speed", "max", "--duration", seconds, "--record", file)
        answer = trocar(*words, *way)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert answer.status == 1
    until = open_recording(file).end
    assert 0.3 < until < seconds
    last = answer.err.splitlines()[-1]
    assert last.startswith(f"trocar: error: {file}: nothing is recorded after t = {until:.3f} s: ")


def test_people_are_told_that_the_motion_is_the_same(trocar, file):
    answer = trocar("replay", file)
    assert answer.status == 0
    assert "1 commands, 901 steps (0.900 s)" in answer.out
    assert "identical to the last bit (digest " in answer.out


def test_people_are_told_how_far_a_motion_is_off(trocar, tmp_path):
    file, world = tmp_path / "run.mcap", World("psm")
    with record(world, file):
        world.servos.setpoint[0, 0] += 0.1
        world.step(900)
    answer = trocar("replay", file)
    assert answer.status == 1
    assert "motion DIFFERS from 0.000 s on; largest difference: " in answer.out
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


def test_a_recording_of_an_older_format_is_refused_with_both_formats(trocar, tmp_path):
    old = tmp_path / "old.mcap"
    with old.open("wb") as stream:
        writer = mcap_writer.Writer(stream)
        writer.start("ros2", "trocar 0.1.0")
        writer.add_metadata("trocar", {"format": "2", "trocar": "0.1.0", "rig": "psm"})
        writer.finish()
    for command in ("replay", "plot"):
        answer = trocar(command, old)
        assert (answer.status, answer.out) == (2, "")
        assert f"{old}: got recording format 2, written by trocar 0.1.0" in answer.complaint
        assert answer.complaint.endswith("allowed: format 3")


def test_a_recording_is_drawn(trocar, file, tmp_path):
    pytest.importorskip("matplotlib")
    answer = trocar("plot", file)
    assert (answer.status, answer.out) == (0, f"{file.with_suffix('.png')}\n")
    assert trocar("plot", file, "-o", tmp_path / "x.html", "--joint", "yaw").status == 0
    answer = trocar("plot", file, "--arm", "PSM7")
    assert (answer.status, "known: PSM1" in answer.complaint) == (2, True)
