"""Images in Foxglove: live as ROS 2 has them, and in a file when they are asked for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.live.fake_renderer import FakeRenderer
from tests.ros.foxglove.viewer import until, viewer
from trocar.live import Loop
from trocar.live.images import Pictures
from trocar.live.loop import SERVER_TICK_S
from trocar.messages import cdr_decode
from trocar.ros import Core
from trocar.simulation import World

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")

from trocar.ros.transports.foxglove import FoxgloveTransport

RAW, PACKED = "/endoscope/left/image_raw", "/endoscope/left/image_raw/compressed"


@contextmanager
def shown(record: Path | None = None, **options: bool) -> Iterator[tuple[Core, FoxgloveTransport]]:
    loop = Loop(World("ecm"), tick_s=SERVER_TICK_S)
    pictures = Pictures(loop, FakeRenderer)
    core = Core(loop, pictures=pictures)
    transport = FoxgloveTransport(0, None if record is None else str(record), **options)
    core.attach(transport)
    pictures.start()
    core.start()
    loop.start()
    try:
        yield core, transport
    finally:
        core.close()
        loop.close()
        pictures.close()


def test_a_viewer_gets_images_as_ros_2_has_them() -> None:
    with shown() as (core, transport):
        count = sum(t.direction == "pub" and not t.later for t in core.topics.values())
        with viewer(transport.port, count) as client:
            assert client.channels[RAW]["schemaName"] == "sensor_msgs/msg/Image"
            client.subscribe(RAW, PACKED)
            until(lambda: {RAW[1:], PACKED[1:]} <= transport.wanted())
            kinds: dict[str, dict] = {}
            while len(kinds) < 2:
                topic, log_ns, data = client.message()
                kinds[topic] = cdr_decode(core.topics[topic[1:]].type, data)
                seconds, rest = kinds[topic]["header"]["stamp"]
                assert log_ns == seconds * 10**9 + rest
    raw = kinds[RAW]
    assert len(raw["data"]) == raw["height"] * raw["step"]
    assert bytes(kinds[PACKED]["data"]).startswith(b"\xff\xd8")


@pytest.mark.parametrize("images", [False, True])
def test_a_file_has_images_only_on_request_and_packed(images: bool, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader", reason="the extra `record` is not there")
    file = tmp_path / "run.mcap"
    with shown(file, images=images) as (core, _):
        wanted = {"endoscope/left/camera_info"} if images else {"ECM/measured_js"}
        end = time.monotonic() + 20
        while core.loop.latest.time < 0.5:
            assert time.monotonic() < end
            time.sleep(0.05)
        assert wanted <= core.topics.keys()
    with file.open("rb") as stream:
        topics = {c.topic for _, c, _ in reader.make_reader(stream).iter_messages()}
    assert "/ECM/measured_js" in topics
    assert RAW not in topics
    assert (PACKED in topics) == images
    assert ("/endoscope/left/camera_info" in topics) == images
