"""What a recording holds is what the world did, and standard tools can read it."""

from __future__ import annotations

import errno
import gc
import io
import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.errors import InputError, LogError, RecordingError
from trocar.geometry.se3 import translation
from trocar.recording import is_recording, open_recording, record, recorder_of
from trocar.recording.entries import entry_from_json, entry_json
from trocar.recording.mcap_file import PackedRows, pack, unpack
from trocar.simulation import World
from trocar.simulation.journal import Entry

mcap_reader = pytest.importorskip("mcap.reader")
mcap_exceptions = pytest.importorskip("mcap.exceptions")
mcap_writer = pytest.importorskip("mcap.writer")
rosbags = pytest.importorskip("rosbags.typesys")
SRC = Path(__file__).parents[2] / "src"
STORE = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)


def drive(world: World, seconds: float = 1.0) -> None:
    """Give an arm something to do."""
    arm = world.arm(next(name for name, arm in world.arms.items() if arm.description.type == "PSM"))
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
    world.arm("PSM2").local.set_base_frame(translation(np.array([0.1, 0.0, 0.0])), "ECM")
    with record(world, file):
        for row in range(61):
            if row == 30:
                world.set_reference_arm("PSM1")
            if row == 1:
                world.arm("ECM").move_jp([0.1, 0.1, 0.1, 0.2])
                setup = world.arm("SUJ_PSM1")
                setup.brakes.release()
                setup.move_jp(setup.measured_js().position + 0.05)
                world.arm("PSM3").local.set_base_frame(
                    translation(np.array([0.1, 0.2, 0.3])), "table"
                )
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
        for m, s, p, (js, setpoint, cp) in zip(measured, setpoints, poses, rows, strict=True):
            assert tuple(m.name) == tuple(s.name) == js.name
            assert m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec == pytest.approx(js.time)
            np.testing.assert_allclose(m.position, js.position, atol=1e-12)
            np.testing.assert_allclose(m.velocity, js.velocity, atol=1e-12)
            np.testing.assert_allclose(m.effort, js.effort, atol=1e-9)
            np.testing.assert_allclose(s.position, setpoint.position, atol=1e-12)
            assert p.header.frame_id == cp.frame_id
            where = p.pose.position
            # MuJoCo's frames against the analytic ones, through a loop that gives a little
            np.testing.assert_allclose([where.x, where.y, where.z], cp.matrix[:3, 3], atol=1e-5)
            turn = p.pose.orientation
            R = rotation(turn.w, turn.x, turn.y, turn.z)
            np.testing.assert_allclose(R, cp.matrix[:3, :3], atol=1e-4)


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
    with record(world, file):
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
            seen[name].append((*arm.joints.readings(), arm.runtime.snapshot(None).setpoint))

    with record(world, file):
        note()
        for row in range(450):
            if row == 100:
                psm.move_jp([0.1, -0.2, 0.15, 0.4, 0.2, -0.3])
            if row == 200:
                psm.joints.set_gains("yaw", p=30.0)
            if row == 250:
                world.arm("PSM1").disable()
            if row == 403:
                psm.joints.set_mode("effort", ["roll"])
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


def test_poses_are_in_the_frames_of_a_loaded_state(tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    arm = world.arm("PSM1")
    arm.local.set_base_frame(translation(np.array([0.1, 0.2, 0.3])), "table")
    state = world.save()
    world.reset()
    with record(world, file):
        world.step(10)
        world.load(state)
        world.step(10)
        expected = arm.measured_cp()
    last = decoded(file, "/PSM1/measured_cp")[-1]
    place = last.pose.position
    assert last.header.frame_id == expected.frame_id == "table"
    # MuJoCo's frames against the analytic ones, through a loop that gives a little
    np.testing.assert_allclose([place.x, place.y, place.z], expected.matrix[:3, 3], atol=1e-5)


def test_recording_changes_nothing(tmp_path: Path) -> None:
    worlds = [World("psm"), World("psm")]
    with record(worlds[1], tmp_path / "run.mcap"):
        for world in worlds:
            drive(world)
    assert np.array_equal(worlds[0].mj_data.qpos, worlds[1].mj_data.qpos)
    assert np.array_equal(worlds[0].mj_data.qvel, worlds[1].mj_data.qvel)


def test_commands_and_events_are_told_with_their_period(tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    world.step(7)
    with record(world, file):
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


@pytest.mark.parametrize("text", ['{"$record": "State"}', '{"$tuple": 1}', '{"$bytes": "*"}'])
def test_a_damaged_state_is_rejected(text: str) -> None:
    entry = Entry(0, 0.0, "command", "world", "load", {"state": 0})
    data = entry_json(entry).replace(b'{"state": 0}', b'{"state": ' + text.encode() + b"}")
    with pytest.raises(InputError, match="a command or event is damaged"):
        entry_from_json(data)


def test_a_block_comes_back_bit_by_bit() -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(size=(4, 5, 33)).astype(np.float32)
    values[0, 0, :4] = [np.nan, np.inf, -np.inf, -0.0]
    block = unpack(pack(PackedRows(2, 400, np.arange(33.0), values, "abc")))
    assert np.array_equal(block.values.view(np.int32), values.view(np.int32))
    assert (block.layout, block.first, block.digest) == (2, 400, "abc")
    assert np.array_equal(block.times, np.arange(33.0))


def test_a_second_recording_of_the_same_world_is_rejected(tmp_path: Path) -> None:
    world = World("psm")
    with (
        record(world, tmp_path / "a.mcap") as recorder,
        pytest.raises(InputError, match=r"b\.mcap: the world is recorded into .*a\.mcap now"),
    ):
        record(world, tmp_path / "b.mcap")
    recorder.stop()
    with record(world, tmp_path / "b.mcap"):
        world.step()
    assert open_recording(tmp_path / "b.mcap").rows == 2


# ---------------------------------------------------------------- what goes wrong


KILLED = """
import sys, time
from trocar.recording import record
from trocar.simulation import World
world = World(sys.argv[2])
recorder = record(world, sys.argv[1])
world.arm("PSM1").move_jp([0.5, 0.3, 0.2, 1.0, 0.5, 0.5])
begun = time.monotonic()
while True:
    world.step(10)
    print(world.time, flush=True)
    time.sleep(max(0.0, begun + world.time - time.monotonic()))
"""


def last_time(file: Path) -> float:
    """Return the time of the last message as the mcap library's seeking reader reads it [s]."""
    with file.open("rb") as stream:
        reader = mcap_reader.SeekingReader(stream)
        return max(message.log_time * 1e-9 for *_, message in reader.iter_messages())


@pytest.mark.skipif(sys.platform == "win32", reason="has no SIGKILL")
@pytest.mark.parametrize("rig", ["psm", "full_cart"])
def test_a_killed_process_loses_at_most_0_6_s(tmp_path: Path, rig: str) -> None:
    file = tmp_path / "run.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(file), rig],
        env={**os.environ, "PYTHONPATH": str(SRC)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    reached = 0.0
    while reached < 1.57:  # most of a chunk is not written yet
        reached = float(child.stdout.readline())
    child.send_signal(signal.SIGKILL)
    reached = max([reached, *map(float, child.stdout.read().split())])
    child.stdout.close()
    child.wait(30)
    recorded = open_recording(file)
    assert reached - 0.6 <= recorded.end <= reached + 0.011
    assert [e.name for e in recorded.entries if e.kind == "command"] == ["move_jp"]
    assert "breaks off" in recorded.problem
    assert last_time(file) == pytest.approx(recorded.end)


def test_a_file_cut_anywhere_is_read_to_its_last_whole_block(tmp_path: Path) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    with record(world, file):
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
    world, file = World("psm", dynamics="cad"), tmp_path / "run.mcap"
    with record(world, file):
        drive(world)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    recorded = open_recording(file)
    assert "breaks off" in recorded.problem
    assert recorded.rows in (400, 800)


@pytest.mark.slow
def test_a_file_with_damaged_bytes_is_read_or_rejected(tmp_path: Path) -> None:
    world, file, rng = World("psm"), tmp_path / "run.mcap", np.random.default_rng(0)
    with record(world, file):
        world.step(50)
    whole, rejected = np.frombuffer(file.read_bytes(), np.uint8), 0
    for _ in range(3000):
        data = whole.copy()
        count = rng.choice((1, 4, 32))
        data[rng.integers(len(data), size=count)] = rng.integers(256, size=count)
        file.write_bytes(data.tobytes())
        try:
            open_recording(file)
        except LogError:
            rejected += 1
    assert 0 < rejected < 3000


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "is no recording; allowed: an MCAP file"),
        (b"0.1,0.2\n", "is no recording; allowed: an MCAP file"),
        (b"\x89MCAP0\r\n" + bytes(40), "is an MCAP file, but no recording of trocar's"),
    ],
)
def test_what_is_no_recording_is_rejected(tmp_path: Path, content: bytes, complaint: str) -> None:
    file = tmp_path / "x.mcap"
    file.write_bytes(content)
    with pytest.raises(LogError, match=complaint):
        open_recording(file)
    assert not is_recording(file)
    with pytest.raises(LogError, match="there is no such file; allowed: a recording"):
        open_recording(tmp_path / "none.mcap")
    with pytest.raises(LogError, match="is a folder"):
        open_recording(tmp_path)


def test_a_file_that_cannot_be_written_is_rejected_before_anything_moves(tmp_path: Path) -> None:
    world = World("psm")
    with pytest.raises(InputError, match=r"no/run\.mcap: cannot be written: No such file"):
        record(world, tmp_path / "no" / "run.mcap")
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        record(world, tmp_path)
    assert recorder_of(world) is None
    world.step()


class Full(io.BytesIO):
    """A disk with so much room; with `taken`, others fill what is given back when it is full."""

    name = "full.mcap"

    def __init__(self, room: int, taken: bool = False) -> None:
        super().__init__()
        self.room, self.taken = room, taken
        self.kept = b""
        self.error: Exception = OSError(errno.ENOSPC, "No space left on device")

    def write(self, data: Any) -> int:
        begin = self.tell()
        if begin + len(data) > self.room:
            super().write(data[: max(0, self.room - begin)])
            self.room = begin - 1 if self.taken else self.room
            raise self.error
        return super().write(data)

    def close(self) -> None:
        self.kept = self.getvalue()
        super().close()


@pytest.mark.parametrize("taken", [False, True], ids=["full", "fuller a moment later"])
def test_a_full_disk_ends_the_run_and_leaves_a_file_that_standard_tools_read(
    tmp_path: Path, taken: bool
) -> None:
    world, disk = World("psm", dynamics="cad"), Full(60_000, taken)
    recorder = record(world, disk)
    message = r"full\.mcap: nothing is recorded after t = \d\.\d+ s: No space left on device"
    with pytest.raises(RecordingError, match=message) as caught:
        drive(world, 3.0)
    with pytest.raises(RecordingError, match=message):
        recorder.stop()
    world.step()  # the world itself is sound
    file = tmp_path / "full.mcap"
    file.write_bytes(disk.kept)
    recorded = open_recording(file)
    assert "breaks off" in recorded.problem
    assert recorded.end == pytest.approx(caught.value.until) == pytest.approx(last_time(file))
    # rows on their way, a chunk that did not fit, and one that made room for the end
    assert 0.0 < world.time - recorded.end < 1.5


def test_a_writer_that_dies_ends_the_run_with_its_error(tmp_path: Path) -> None:
    world, disk = World("psm"), Full(60_000)
    disk.error = ZeroDivisionError("a defect")
    with pytest.raises(RecordingError, match=r"ZeroDivisionError\('a defect'\)"):
        record_all(world, disk)
    file = tmp_path / "full.mcap"
    file.write_bytes(disk.kept)
    assert last_time(file) == pytest.approx(open_recording(file).end)


def record_all(world: World, disk: Full) -> None:
    with record(world, disk):
        drive(world, 3.0)


def test_a_disk_that_is_full_at_the_last_chunk_is_an_error_too() -> None:
    world, disk = World("psm"), Full(1 << 30)
    recorder = record(world, disk)
    world.step(10)
    disk.room = disk.tell()
    with pytest.raises(RecordingError, match=r"nothing is recorded after t = 0\.000 s"):
        recorder.stop()


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of file sizes")
def test_a_real_file_that_cannot_grow_is_read_by_standard_tools(tmp_path: Path) -> None:
    import resource

    world, file = World("psm"), tmp_path / "run.mcap"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = record(world, file)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
    try:
        with pytest.raises(RecordingError, match=r"run\.mcap: nothing .* after .*: File too large"):
            drive(world, 3.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    with pytest.raises(RecordingError):
        recorder.stop()
    assert 0.3 < last_time(file) == pytest.approx(open_recording(file).end)


def test_a_disk_that_is_full_from_the_start_is_rejected() -> None:
    with pytest.raises(InputError, match=r"full\.mcap: cannot be written: No space left"):
        record(World("psm"), Full(20))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no device that is always full")
def test_a_full_device_is_rejected_and_closed() -> None:
    with pytest.raises(InputError, match="/dev/full: cannot be written: No space left"):
        record(World("psm"), "/dev/full")
    gc.collect()  # a file that is left open warns, which is an error here


class Stuck(io.BytesIO):
    """A disk that takes nothing until it is freed."""

    name = "stuck.mcap"

    def __init__(self) -> None:
        super().__init__()
        self.free = threading.Event()
        self.free.set()

    def write(self, data: Any) -> int:
        self.free.wait()
        return super().write(data)

    def close(self) -> None:
        """Stay readable."""


def test_the_simulation_waits_for_a_disk_that_cannot_follow_and_loses_nothing(
    tmp_path: Path,
) -> None:
    world, disk = World("psm"), Stuck()
    with record(world, disk):
        disk.free.clear()
        stepping = threading.Thread(target=world.step, args=(5000,), daemon=True)
        stepping.start()
        stepping.join(2.0)
        waited = stepping.is_alive() and world.periods < 5000
        disk.free.set()
        stepping.join()
    assert waited
    file = tmp_path / "run.mcap"
    file.write_bytes(disk.getvalue())
    assert open_recording(file).rows == 5001


def test_a_recording_of_the_old_format_is_rejected_with_both_formats(tmp_path: Path) -> None:
    file = tmp_path / "old.mcap"
    with file.open("wb") as stream:
        old = mcap_writer.Writer(stream)
        old.start("ros2", "trocar 0.1.0")
        old.add_metadata("trocar", {"format": "2", "trocar": "0.1.0", "rig": "psm"})
        old.add_message(old.register_channel("/trocar/states", "trocar.states", 0), 0, b"", 0)
        old.finish()
    complaint = r"got recording format 2, written by trocar 0\.1\.0; allowed: format 3"
    with pytest.raises(LogError, match=complaint):
        open_recording(file)


def test_without_the_library_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(Exception, match=r"recording needs mcap.*pip install 'trocar\[record\]'"):
        record(World("psm"), tmp_path / "run.mcap")


def test_the_file_says_what_the_world_was_built_with(tmp_path: Path) -> None:
    world, file = World("psm", tip_load_n=1.0, seed=5), tmp_path / "run.mcap"
    with record(world, file):
        world.step()
    about = open_recording(file).about
    arguments = json.loads(about["arguments"])
    assert (arguments["tip_load_n"], arguments["seed"]) == (1.0, 5)
    assert (about["rig"], about["repeatable"]) == ("psm", "yes")


def test_a_recording_has_what_robots_with_errors_report(tmp_path: Path) -> None:
    world = World("psm", errors="lab", seed=1)
    goal = [0.3, 0.2, 0.14, 0.4, -0.3, 0.2]
    with record(world, tmp_path / "run.mcap"):
        world.arm("PSM1").servo_jp(goal)
        world.step(200)
    recorded = open_recording(tmp_path / "run.mcap")
    columns = recorded.columns("PSM1")
    assert columns is not None
    states = recorded.states(columns)
    np.testing.assert_allclose(
        states.position[-1], world.arm("PSM1").joints.readings()[0], atol=1e-7
    )
    np.testing.assert_allclose(states.setpoint[-1][:6], goal, atol=1e-7)
    assert np.abs(states.position[-1] - world.true_state("PSM1").q).max() > 1e-3


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("calibration", '{"PSM1": ["a.toml", "\x01"'),
        ("calibration", "[]"),
        ("calibration", '{"PSM1": 1}'),
        ("calibration", '{"PSM1": ["a.toml", "schema = "]}'),
        ("arguments", "\x01"),
        ("arguments", "[1]"),
    ],
)
def test_damaged_metadata_are_said(tmp_path: Path, key: str, text: str) -> None:
    file = tmp_path / "a.mcap"
    with record(World("psm"), file):
        pass
    recorded = open_recording(file)
    damaged = replace(recorded, about={**recorded.about, key: text})
    with pytest.raises(LogError, match=rf"a\.mcap: cannot be understood: {key}: "):
        damaged.overlays() if key == "calibration" else damaged.arguments()
