"""Recordings that carry images: what standard tools find in them, and that they are repeated."""

from __future__ import annotations

import io
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.live.fake_renderer import FakeRenderer
from trocar.errors import InputError
from trocar.live import Loop
from trocar.live.images import Pictures
from trocar.messages import cdr_decode, message_type
from trocar.recording import Extra, open_recording, record
from trocar.robot.follow import repeat
from trocar.ros.images import RecordedImages, images_recorded
from trocar.simulation import World

reader = pytest.importorskip("mcap.reader", reason="the extra `record` is not there")

TOPICS = {
    f"/endoscope/{eye}/{what}"
    for eye in ("left", "right")
    for what in ("image_raw/compressed", "camera_info")
}


def found(file: Path) -> dict[str, list]:
    """{topic of a camera: its messages with their schemas}, as the mcap library reads them."""
    messages: dict[str, list] = {}
    with file.open("rb") as stream:
        for schema, channel, message in reader.make_reader(stream).iter_messages():
            if "endoscope" in channel.topic:
                messages.setdefault(channel.topic, []).append((schema, message))
    return messages


def test_every_picture_of_a_run_is_in_its_recording_and_the_run_is_repeated(tmp_path: Path) -> None:
    world, file = World("two_psm_ecm"), tmp_path / "run.mcap"
    with record(world, file), images_recorded(world, FakeRenderer, 25.0):
        world.arm("ECM").move_jp([0.2, 0.1, 0.12, 0.0])
        world.step(1000)
    messages = found(file)
    assert set(messages) == TOPICS
    for topic, each in messages.items():
        times = np.array([message.log_time for _, message in each]) * 1e-9
        assert len(times) == 26
        np.testing.assert_allclose(times[1:], np.arange(1, 26) / 25.0, atol=0.006)
        for schema, message in each:
            kind = message_type(schema.name)
            assert schema.data.decode() == kind.text_ros2
            read = cdr_decode(kind, message.data)
            seconds, rest = read["header"]["stamp"]
            assert seconds * 10**9 + rest == message.log_time
            if "compressed" in topic:
                assert Image.open(io.BytesIO(read["data"])).format == "JPEG"
    assert repeat(file).identical


def test_times_of_images_never_go_back_when_the_world_is_reset(tmp_path: Path) -> None:
    world, file = World("ecm"), tmp_path / "run.mcap"
    with record(world, file), images_recorded(world, FakeRenderer, 50.0):
        world.step(200)
        world.reset()
        world.step(200)
    messages = found(file)["/endoscope/left/camera_info"]
    logged = [message.log_time for _, message in messages]
    assert logged == sorted(logged)
    assert len(logged) > 15


def test_a_live_run_is_recorded_with_what_is_drawn_beside_it(tmp_path: Path) -> None:
    world, file = World("ecm"), tmp_path / "run.mcap"
    loop = Loop(world)
    pictures = Pictures(loop, FakeRenderer, 50.0)
    pictures.add(RecordedImages(world))
    pictures.start()
    with record(world, file):
        loop.start(0.5)
        loop.wait()
        end = time.monotonic() + 20
        while not pictures.idle:
            assert time.monotonic() < end
            time.sleep(0.01)
    drawn = pictures.made
    loop.run(0.1)  # nobody records any more
    pictures.close()
    assert pictures.made == drawn > 5
    assert {len(each) for each in found(file).values()} == {drawn}


def test_who_sends_faster_than_can_be_written_loses_messages_that_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, file = World("psm"), tmp_path / "run.mcap"
    monkeypatch.setattr("trocar.recording.recorder.MOST_WAITING", 0)
    extra = Extra("/mine", "std_msgs/msg/String", "string data\n", 0.0, b"\0\1\0\0")
    with record(world, file) as recorder:
        assert not recorder.add(extra)
        world.step(10)
    assert recorder.left_out == 1
    assert not recorder.add(extra)
    assert open_recording(file).rows == 11


def test_an_open_stream_takes_images_as_well(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    world = World("ecm")
    with (
        file.open("wb") as stream,
        record(world, stream),
        images_recorded(world, FakeRenderer, 25.0, "png"),
    ):
        world.step(100)
    _, message = found(file)["/endoscope/right/image_raw/compressed"][-1]
    assert cdr_decode("sensor_msgs/CompressedImage", message.data)["format"] == "png"


def test_a_rate_that_is_none_is_refused() -> None:
    with (
        pytest.raises(InputError, match="camera rate"),
        images_recorded(World("ecm"), FakeRenderer, 0.0),
    ):
        pass
