"""Every kind of bag is read from front to back, with the memory of a chunk."""

from __future__ import annotations

import gc
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from tests.robot.follow.motions import BEGIN, KINDS, motion, rows, write, write_many
from trocar.errors import LogError
from trocar.recording import record
from trocar.robot.follow import open_bag
from trocar.simulation import World

TOPICS = ("PSM1/measured_js", "PSM1/jaw/measured_js")


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_tells_what_was_recorded_in_its_order(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "a.bag", kind, rows(["PSM1", "ECM"], 2.0))
    bag = open_bag(path)
    assert set(bag.topics) == {*TOPICS, "ECM/measured_js"}
    assert set(bag.topics.values()) == {"sensor_msgs/msg/JointState"}
    heard = list(bag.messages(TOPICS))
    assert len(heard) == 800
    assert [h.topic for h in heard[:2]] == list(TOPICS)
    for h in heard[::2]:
        t = h.time - BEGIN
        np.testing.assert_allclose(h.fields["position"], motion("PSM1", t), atol=1e-6)
    times = [h.time for h in heard]
    assert times == sorted(times)


def test_a_single_mcap_file_and_a_recording_of_trocar_s_own_are_bags_too(tmp_path: Path) -> None:
    folder = write(tmp_path / "a.bag", "mcap", rows(["ECM"], 0.5))
    (file,) = folder.glob("*.mcap")
    assert len(list(open_bag(file).messages(["ECM/measured_js"]))) == 100
    world = World("psm")
    with record(world, tmp_path / "own.mcap"):
        world.arm("PSM1").servo_jp(np.array([0.1, 0.1, 0.13, 0.0, 0.0, 0.0]))
        world.step(300)
    own = open_bag(tmp_path / "own.mcap")
    last = list(own.messages(["PSM1/measured_js"]))[-1]
    np.testing.assert_allclose(last.fields["position"][0], 0.1, atol=0.02)


def test_a_topic_that_begins_late_is_known_and_a_file_without_a_summary_is_read(
    tmp_path: Path,
) -> None:
    late = [row for row in rows(["PSM1", "ECM"], 1.0) if "ECM" not in row[1] or row[0] > 0.8]
    (file,) = write(tmp_path / "a.bag", "mcap", late).glob("*.mcap")
    assert "ECM/measured_js" in open_bag(file).topics
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) - 400])  # its writer was killed
    assert "PSM1/measured_js" in open_bag(file).topics


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ros1", "sqlite", "mcap"])
def test_a_long_bag_takes_no_more_memory_than_a_short_one(tmp_path: Path, kind: str) -> None:
    peaks: list[int] = []
    for count in (3_000, 15_000):
        path = write_many(tmp_path / f"{count}.bag", kind, count)
        gc.collect()
        tracemalloc.start()
        assert sum(1 for _ in open_bag(path).messages(TOPICS)) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # five times as long; rosbag 1's index alone would take 2 MB more
    assert peaks[1] - peaks[0] < 400_000, peaks


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file; allowed: rosbag 1"):
        open_bag(tmp_path / "no.bag")
    (tmp_path / "text.bag").write_text("hello")
    with pytest.raises(LogError, match=r"is not a bag; allowed: rosbag 1 \(.bag\), rosbag 2, MCAP"):
        open_bag(tmp_path / "text.bag")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="contains no rosbag 2 file"):
        open_bag(tmp_path / "empty")
    (tmp_path / "empty" / "a.db3.zstd").write_bytes(b"x")
    with pytest.raises(LogError, match="is compressed"):
        open_bag(tmp_path / "empty")


def test_a_bag_that_breaks_off_is_told(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", "ros1", rows(["ECM"], 1.0))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(LogError, match="cannot be read as a bag"):
        list(open_bag(path).messages(["ECM/measured_js"]))


@pytest.mark.parametrize("kind", ["ros1", "bz2", "lz4"])
def test_a_bag_that_was_not_closed_is_read_up_to_where_it_breaks_off(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "a.bag", kind, rows(["ECM"], 1.0))
    whole = list(open_bag(path).messages(["ECM/measured_js"]))
    left_open(path)
    bag = open_bag(path)
    assert "was not closed; read up to where it breaks off" in caplog.text
    found = list(bag.messages(["ECM/measured_js"]))
    assert [m.time for m in found] == [m.time for m in whole]


def test_of_a_chunk_that_was_still_being_written_the_whole_messages_are_read(
    tmp_path: Path,
) -> None:
    path = write(tmp_path / "a.bag", "ros1", rows(["ECM"], 1.0))
    content = left_open(path)
    size = len(b"#ROSBAG V2.0\n")
    for _ in range(3):  # header and content of the bag's record, header of the chunk's
        size += 4 + int.from_bytes(content[size : size + 4], "little")
    content[size : size + 4] = bytes(4)  # of the chunk: written when it is complete
    path.write_bytes(content[: size + len(content[size:]) // 2])
    found = list(open_bag(path).messages(["ECM/measured_js"]))
    assert 50 < len(found) < 200
    for m in found:
        t = m.time - BEGIN
        np.testing.assert_allclose(m.fields["position"], motion("ECM", t), atol=1e-6)


def left_open(path: Path) -> bytearray:
    """Make a rosbag 1 as its recorder leaves it when it is killed, and return its bytes."""
    content = bytearray(path.read_bytes())
    at = content.index(b"index_pos=") + len(b"index_pos=")
    end = int.from_bytes(content[at : at + 8], "little")
    content[at : at + 8] = bytes(8)
    path.write_bytes(content[:end])
    return content[:end]
