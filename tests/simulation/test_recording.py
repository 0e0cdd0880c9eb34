"""What a recording holds is what the world did, and standard tools can read it."""

from __future__ import annotations

import errno
import io
import json
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.errors import InputError, LogError
from trocar.geometry.se3 import translation
from trocar.simulation import World
from trocar.simulation.journal import Entry
from trocar.simulation.recording import is_recording, open_recording
from trocar.simulation.recording.blocks import PackedBlock, pack, unpack
from trocar.simulation.recording.values import entry_from_json, entry_json

mcap_reader = pytest.importorskip("mcap.reader")
rosbags = pytest.importorskip("rosbags.typesys")
SRC = Path(__file__).parents[2] / "src"
STORE = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)


def drive(world: World, seconds: float = 1.0) -> None:
    """Give an arm something to do."""
    arm = world.arm(next(name for name, arm in world.arms.items() if arm.type == "PSM"))
    arm.move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
    if arm.jaw is not None:
        arm.jaw.open()
    world.step(round(seconds / world.timestep))


def decoded(file: Path, topic: str) -> list[Any]:
    """Read every message of a topic with tools that know nothing of trocar."""
    with file.open("rb") as stream:
        reader = mcap_reader.make_reader(stream)
        return [
            STORE.deserialize_cdr(message.data, schema.name)
            for schema, _, message in reader.iter_messages(topics=[topic])
        ]


def test_standard_tools_read_joint_states_and_poses(tmp_path: Path) -> None:
    world, file = World("full_cart"), tmp_path / "run.mcap"
    expected: dict[str, list[Any]] = {name: [] for name in world.arms}
    world.arm("PSM2").set_base_frame(translation(np.array([0.1, 0.0, 0.0])), "ECM")
    with world.record(file):
        for row in range(61):
            if row == 30:
                world.set_reference_arm("PSM1")
            if row == 1:
                world.arm("ECM").move_jp([0.1, 0.1, 0.1, 0.2])
                setup = world.arm("SUJ_PSM1")
                setup.release_brakes()
                setup.move_jp(setup.measured_js().position + 0.05)
                world.arm("PSM3").set_base_frame(translation(np.array([0.1, 0.2, 0.3])), "table")
                world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
            if row % 20 == 0:
                for name, arm in world.arms.items():
                    expected[name].append((arm.measured_js(), arm.setpoint_js(), arm.measured_cp()))
            if row < 60:
                world.step()
    for name, rows in expected.items():
        measured = decoded(file, f"/{name}/measured_js")
        setpoints = decoded(file, f"/{name}/setpoint_js")
        poses = decoded(file, f"/{name}/measured_cp")
        assert len(measured) == len(setpoints) == len(poses) == len(rows) == 4
        for m, s, p, (js, told, cp) in zip(measured, setpoints, poses, rows, strict=True):
            assert tuple(m.name) == tuple(s.name) == js.name
            assert m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec == pytest.approx(js.time)
            np.testing.assert_allclose(m.position, js.position, atol=1e-12)
            np.testing.assert_allclose(m.velocity, js.velocity, atol=1e-12)
            np.testing.assert_allclose(m.effort, js.effort, atol=1e-9)
            np.testing.assert_allclose(s.position, told.position, atol=1e-12)
            assert p.header.frame_id == cp.frame_id
            where = p.pose.position
            # MuJoCo's frames against the analytic ones, through a loop that gives a little
            np.testing.assert_allclose([where.x, where.y, where.z], cp.T[:3, 3], atol=1e-5)
            turn = p.pose.orientation
            R = rotation(turn.w, turn.x, turn.y, turn.z)
            np.testing.assert_allclose(R, cp.T[:3, :3], atol=1e-4)


def rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_the_jaw_has_its_own_topics(tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    with world.record(file):
        world.step(20)
    (first, _) = decoded(file, "/PSM1/jaw/measured_js")
    assert first.name == ["jaw"] and len(first.position) == 1
    assert len(decoded(file, "/PSM1/measured_js")[0].name) == 6


@pytest.mark.parametrize("setup_joints", ["braked", "locked"])
def test_every_period_of_every_joint_is_kept(tmp_path: Path, setup_joints: Any) -> None:
    world, file = World("full_cart", setup_joints=setup_joints), tmp_path / "run.mcap"
    seen: dict[str, list[Any]] = {name: [] for name in world.arms}
    psm = world.arm("PSM2")

    def note() -> None:
        for name, arm in world.arms.items():
            seen[name].append((*arm.readings(), arm.snapshot(None).setpoint))

    with world.record(file):
        note()
        for row in range(450):
            if row == 100:
                psm.move_jp([0.1, -0.2, 0.15, 0.4, 0.2, -0.3])
            if row == 200:
                psm.set_gains("yaw", p=30.0)
            if row == 250:
                world.arm("PSM1").disable()
            if row == 403:
                psm.set_mode("effort", ["roll"])
            world.step()
            note()
    recorded = open_recording(file)
    assert (recorded.rows, recorded.problem) == (451, "")
    for name, rows in seen.items():
        columns = recorded.columns(name)
        assert columns is not None
        states = recorded.states(columns)
        for k, got in enumerate((states.position, states.velocity, states.effort, states.setpoint)):
            expected = np.array([row[k] for row in rows])
            # float32 keeps seven digits
            np.testing.assert_allclose(got, expected, rtol=2e-7, atol=1e-7, err_msg=f"{name} {k}")
        np.testing.assert_allclose(states.time, np.arange(451) * world.timestep, atol=1e-12)


def test_recording_changes_nothing(tmp_path: Path) -> None:
    worlds = [World("psm"), World("psm")]
    with worlds[1].record(tmp_path / "run.mcap"):
        for world in worlds:
            drive(world)
    assert np.array_equal(worlds[0]._data.qpos, worlds[1]._data.qpos)
    assert np.array_equal(worlds[0]._data.qvel, worlds[1]._data.qvel)


def test_commands_and_events_are_told_with_their_period(tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    world.step(7)
    with world.record(file):
        world.step(3)
        world.arm("PSM1").servo_jp([0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
        world.arm("PSM1").servo_jp([np.nan] * 6)
        world.step(2)
    found = [(e.kind, e.name, e.period) for e in open_recording(file).entries]
    assert ("command", "servo_jp", 10) in found
    assert [kind for kind, name, _ in found if name == "warning"] == ["event"]


def test_numbers_of_commands_survive_to_the_last_digit() -> None:
    numbers = np.random.default_rng(1).normal(size=(40, 7)) * 1e-5
    values = {
        "q": numbers,
        "v": [0.1, np.nan, -np.inf],
        "short": np.array([1 / 3, 2]),
        "name": "yaw",
        "on": True,
        "none": None,
        "tables": {"PSM1": numbers},
    }
    back = entry_from_json(entry_json(Entry(3, 0.003, "command", "PSM1", "x", values)))
    assert np.array_equal(back.values["q"], numbers)
    assert np.array_equal(back.values["tables"]["PSM1"], numbers)
    assert np.array_equal(back.values["short"], values["short"])
    assert np.array_equal(back.values["v"], values["v"], equal_nan=True)
    assert (back.values["name"], back.values["on"], back.values["none"]) == ("yaw", True, None)
    assert (back.period, back.time, back.kind, back.source) == (3, 0.003, "command", "PSM1")


def test_a_block_comes_back_bit_by_bit() -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(size=(4, 5, 33)).astype(np.float32)
    values[0, 0, :4] = [np.nan, np.inf, -np.inf, -0.0]
    block = unpack(pack(PackedBlock(2, 400, np.arange(33.0), values, "abc")))
    assert np.array_equal(block.values.view(np.int32), values.view(np.int32))
    assert (block.layout, block.first, block.digest) == (2, 400, "abc")
    assert np.array_equal(block.times, np.arange(33.0))


def test_a_second_recording_of_the_same_world_is_refused(tmp_path: Path) -> None:
    world = World("psm")
    with (
        world.record(tmp_path / "a.mcap") as recorder,
        pytest.raises(InputError, match=r"b\.mcap: the world is recorded into .*a\.mcap now"),
    ):
        world.record(tmp_path / "b.mcap")
    recorder.stop()
    with world.record(tmp_path / "b.mcap"):
        world.step()
    assert open_recording(tmp_path / "b.mcap").rows == 2


# ---------------------------------------------------------------- what goes wrong


def test_a_writer_that_is_gone_is_said_once_and_the_simulation_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = World("psm")
    with world.record(tmp_path / "run.mcap") as recorder:
        world.step(500)
        writer: Any = recorder._writer
        writer._child.kill()
        writer._child.wait(30)
        world.step(2000)
    assert world.time == pytest.approx(2.5)
    assert recorder.failure
    said = [r for r in caplog.records if "cannot be written any further" in r.getMessage()]
    assert len(said) == 1


KILLED = """
import sys, time
from trocar.simulation import World
world = World("psm")
print(world.record(sys.argv[1])._writer._child.pid, flush=True)
arm = world.arm("PSM1")
arm.move_jp([0.5, 0.3, 0.2, 1.0, 0.5, 0.5])
while True:
    world.step(100)
    print(world.time, flush=True)
    time.sleep(0.02)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc for the process")
@pytest.mark.parametrize("writer", ["goes on", "is killed too"])
def test_a_killed_process_loses_less_than_its_last_second(tmp_path: Path, writer: str) -> None:
    file = tmp_path / "run.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(file)],
        env={**os.environ, "PYTHONPATH": str(SRC)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    pid = int(child.stdout.readline())
    reached = 0.0
    while reached < 2.5:
        reached = float(child.stdout.readline())
    if writer == "is killed too":
        os.kill(pid, signal.SIGKILL)
    child.send_signal(signal.SIGKILL)
    reached = max([reached, *map(float, child.stdout.read().split())])
    child.stdout.close()
    child.wait(30)
    if writer == "goes on":  # until it finds that nothing more comes
        wait_until_gone(pid)
    recorded = open_recording(file)
    assert reached - 1.0 <= recorded.end <= reached + 0.1
    assert [e.name for e in recorded.entries if e.kind == "command"] == ["move_jp"]
    assert bool(recorded.problem) == (writer == "is killed too")
    if not recorded.problem:
        return
    with file.open("rb") as stream:  # no summary: read from its beginning
        reader = mcap_reader.NonSeekingReader(stream)
        with pytest.raises(Exception):  # noqa: B017, PT011  the library's own end of file
            list(reader.iter_messages(log_time_order=False))


def wait_until_gone(pid: int) -> None:
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        state = Path(f"/proc/{pid}/stat")
        if not state.exists() or state.read_text().rsplit(")", 1)[1].split()[0] == "Z":
            return
        time.sleep(0.05)
    raise AssertionError("the writer is still there")


def test_a_file_cut_anywhere_is_read_to_its_last_whole_block(tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    with world.record(file):
        drive(world)
    whole = file.read_bytes()
    rows: list[int] = []
    for end in np.linspace(0, len(whole) - 1, 40).astype(int):
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(whole[:end])
        try:
            recorded = open_recording(cut)
        except LogError:  # nothing was written yet
            continue
        assert "breaks off" in recorded.problem
        rows.append(recorded.rows)
        assert sum(len(block.times) for block in recorded.blocks()) == recorded.rows
    assert rows == sorted(rows)
    assert {400, 800, 1001} == set(rows)


def test_a_damaged_block_is_said_and_what_lies_before_is_read(tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    with world.record(file):
        drive(world)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    recorded = open_recording(file)
    assert "breaks off" in recorded.problem
    assert recorded.rows in (400, 800)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "is no recording; allowed: an MCAP file"),
        (b"0.1,0.2\n", "is no recording; allowed: an MCAP file"),
        (b"\x89MCAP0\r\n" + bytes(40), "is an MCAP file, but no recording of trocar's"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, complaint: str) -> None:
    file = tmp_path / "x.mcap"
    file.write_bytes(content)
    with pytest.raises(LogError, match=complaint):
        open_recording(file)
    assert not is_recording(file)
    with pytest.raises(LogError, match="there is no such file; allowed: a recording"):
        open_recording(tmp_path / "none.mcap")
    with pytest.raises(LogError, match="is a folder"):
        open_recording(tmp_path)


def test_a_file_that_cannot_be_written_is_refused_before_anything_moves(tmp_path: Path) -> None:
    world = World("psm")
    with pytest.raises(InputError, match=r"no/run\.mcap: cannot be written: No such file"):
        world.record(tmp_path / "no" / "run.mcap")
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        world.record(tmp_path)
    assert world.recorder is None
    world.step()


class Full(io.BytesIO):
    """A disk with so much room."""

    name = "full.mcap"

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room = room
        self.kept = b""

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > self.room:
            super().write(data[: self.room - self.tell()])
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


def test_a_full_disk_stops_the_recording_not_the_simulation(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world, disk = World("psm"), Full(60_000)
    with caplog.at_level(logging.WARNING, "trocar"), world.record(disk) as recorder:
        drive(world, 3.0)
    assert world.time == pytest.approx(3.0)
    assert recorder.failure == "No space left on device"
    said = [r.getMessage() for r in caplog.records if "full.mcap" in r.getMessage()]
    assert len(said) == 1 and "No space left on device" in said[0]
    file = tmp_path / "full.mcap"
    file.write_bytes(disk.kept)
    recorded = open_recording(file)
    assert recorded.problem and 0 < recorded.rows < 3001


def test_a_disk_that_is_full_from_the_start_is_refused() -> None:
    with pytest.raises(InputError, match=r"full\.mcap: cannot be written: No space left"):
        World("psm").record(Full(20))


def test_another_format_is_refused_with_both_versions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trocar.simulation.recording.recorder.FORMAT", 99)
    world = World("psm")
    with world.record(tmp_path / "run.mcap"):
        world.step()
    with pytest.raises(LogError, match=r"got format 99, written by trocar \S+; allowed: 2"):
        open_recording(tmp_path / "run.mcap")


def test_without_the_library_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(Exception, match=r"recording needs mcap.*pip install 'trocar\[record\]'"):
        World("psm").record(tmp_path / "run.mcap")


def test_the_file_says_what_the_world_was_built_with(tmp_path: Path) -> None:
    world, file = World("psm", tip_load_n=1.0, seed=5), tmp_path / "run.mcap"
    with world.record(file):
        world.step()
    about = open_recording(file).about
    arguments = json.loads(about["arguments"])
    assert (arguments["tip_load_n"], arguments["seed"]) == (1.0, 5)
    assert (about["rig"], about["repeatable"]) == ("psm", "yes")
