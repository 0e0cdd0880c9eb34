"""Images on the WebSocket: what a page or roslib gets, and that a slow one holds nobody up."""

from __future__ import annotations

import base64
import io
import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from websockets.sync.client import connect

from tests.live.fake_renderer import FakeRenderer
from trocar.live import Loop
from trocar.live.images import Pictures
from trocar.live.loop import SERVER_TICK_S
from trocar.ros import Core
from trocar.ros.transports.websocket import WebSocketTransport
from trocar.simulation import World

LEFT = "/endoscope/left"
PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    loop = Loop(World("ecm"), tick_s=SERVER_TICK_S)
    pictures = Pictures(loop, FakeRenderer)
    core, transport = Core(loop, pictures=pictures), WebSocketTransport(port=0)
    core.attach(transport)
    pictures.start()
    core.start()
    loop.start()
    yield transport.address
    core.close()
    loop.close()
    pictures.close()


def heard(url: str, *topics: str, count: int = 3) -> dict[str, list[dict[str, Any]]]:
    """The first messages of some topics."""
    found: dict[str, list[dict[str, Any]]] = {topic: [] for topic in topics}
    with connect(url, compression=None, max_size=None) as socket:
        for topic in topics:
            socket.send(json.dumps({"op": "subscribe", "topic": topic}))
        while any(len(each) < count for each in found.values()):
            said = json.loads(socket.recv(timeout=PATIENCE_S))
            if said["op"] == "publish":
                found[said["topic"]].append(said["msg"])
    return found


def test_a_compressed_image_is_a_jpeg_in_base64_with_the_camera_info_of_its_stamp(url: str) -> None:
    packed, told = f"{LEFT}/image_raw/compressed", f"{LEFT}/camera_info"
    found = heard(url, packed, told, "/ECM/measured_js", count=8)
    infos = {json.dumps(m["header"]["stamp"]): m for m in found[told]}
    states = {json.dumps(m["header"]["stamp"]) for m in found["/ECM/measured_js"]}
    matched = 0
    for message in found[packed]:
        assert message["format"] == "jpeg"
        image = Image.open(io.BytesIO(base64.b64decode(message["data"])))
        info = infos.get(json.dumps(message["header"]["stamp"]))
        if info is not None:
            matched += 1
            assert image.size == (info["width"], info["height"])
            assert info["K"] == info["k"]
            assert len(info["P"]) == 12
    assert matched >= 4
    assert states


def test_a_raw_image_comes_whole(url: str) -> None:
    (message, *_) = heard(url, f"{LEFT}/image_raw", count=1)[f"{LEFT}/image_raw"]
    pixels = np.frombuffer(base64.b64decode(message["data"]), np.uint8)
    assert pixels.size == message["height"] * message["step"]


@pytest.mark.slow
def test_who_does_not_read_images_keeps_nobody_from_theirs(url: str) -> None:
    with connect(url, compression=None, max_size=None) as deaf:
        deaf.send(json.dumps({"op": "subscribe", "topic": f"{LEFT}/image_raw"}))
        time.sleep(0.5)
        began = time.monotonic()
        heard(url, f"{LEFT}/image_raw/compressed", count=10)
        assert time.monotonic() - began < PATIENCE_S


def test_topics_of_cameras_are_listed(url: str) -> None:
    with connect(url, compression=None, max_size=None) as socket:
        socket.send(json.dumps({"op": "call_service", "service": "/rosapi/topics", "id": "1"}))
        answer = json.loads(socket.recv(timeout=PATIENCE_S))["values"]
    types = dict(zip(answer["topics"], answer["types"], strict=True))
    assert types[f"{LEFT}/image_raw/compressed"] == "sensor_msgs/CompressedImage"
    assert types[f"{LEFT}/camera_info"] == "sensor_msgs/CameraInfo"
