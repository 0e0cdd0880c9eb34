"""Messages as rosbridge has them."""

from __future__ import annotations

import base64
import json
import math
import random
from typing import Any

import numpy as np
import pytest

from tests.messages.content import each_type, plain, random_message
from trocar.messages import MessageError, MessageType, blank, from_json, to_json
from trocar.ros.transports.websocket.protocol import as_json

STAMPED = "crtk_msgs/StringStamped"


def finite(value: Any) -> Any:
    """What JSON can carry: infinities come back as NaN, which equals nothing, so None here."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@each_type()
def test_a_message_comes_back_from_strict_json(kind: MessageType) -> None:
    rng = random.Random(kind.name)
    for _ in range(20):
        message = random_message(kind, rng)
        text = json.dumps(to_json(kind, message), allow_nan=False)
        again = from_json(kind, json.loads(text))
        assert finite(plain(again)) == finite(plain(message))


@each_type()
def test_a_writer_that_takes_arrays_writes_the_same_text(kind: MessageType) -> None:
    rng = random.Random(kind.name)
    for _ in range(20):
        message = random_message(kind, rng)
        text = as_json(to_json(kind, message, arrays=True))
        assert json.loads(text) == to_json(kind, message)


def test_a_time_has_both_editions_names_and_may_have_either() -> None:
    message = blank(STAMPED) | {"header": {"stamp": (3, 4), "frame_id": "PSM1"}, "string": "home"}
    sent = to_json(STAMPED, message)
    assert sent["header"]["stamp"] == {"secs": 3, "nsecs": 4, "sec": 3, "nanosec": 4}
    for stamp in ({"secs": 3, "nsecs": 4}, {"sec": 3, "nanosec": 4}):
        header = {"stamp": stamp, "frame_id": "PSM1"}
        assert from_json(STAMPED, {"header": header, "string": "home"}) == message
    header = {"seq": 7, "stamp": {"secs": 3, "nsecs": 4}, "frame_id": "PSM1"}
    assert from_json(STAMPED, {"header": header, "string": "home"}) == message


def test_what_is_not_there_is_zero() -> None:
    message = from_json("sensor_msgs/JointState", {"position": [1, 2]})
    assert message["header"] == {"stamp": (0, 0), "frame_id": ""}
    assert message["position"].dtype == float
    assert message["position"].tolist() == [1.0, 2.0]
    assert message["name"] == []
    assert from_json("std_msgs/Empty", {}) == {}


def test_bytes_are_base64_and_may_be_numbers() -> None:
    kind = "sensor_msgs/CompressedImage"
    message = blank(kind) | {"data": bytes([0, 255, 7])}
    assert to_json(kind, message)["data"] == base64.b64encode(bytes([0, 255, 7])).decode()
    assert from_json(kind, {"data": [0, 255, 7]})["data"] == bytes([0, 255, 7])
    assert from_json(kind, {"data": "AP8H"})["data"] == bytes([0, 255, 7])
    array = np.array([0, 255, 7], dtype=np.uint8)
    assert to_json(kind, message | {"data": array}) == to_json(kind, message)


def test_no_number_is_null() -> None:
    kind = "std_msgs/Float64MultiArray"
    sent = to_json(kind, blank(kind) | {"data": [1.0, math.nan, math.inf]})
    assert sent["data"] == [1.0, None, None]
    again = from_json(kind, sent)["data"]
    assert again[0] == 1.0
    assert np.isnan(again[1:]).all()
    assert to_json("std_msgs/Float64", {"data": math.nan}) == {"data": None}


def test_a_camera_has_both_editions_names() -> None:
    kind = "sensor_msgs/CameraInfo"
    sent = to_json(kind, blank(kind) | {"k": [float(i) for i in range(9)]})
    assert sent["k"] == sent["K"] == list(range(9))
    del sent["k"]
    assert from_json(kind, sent)["k"].tolist() == list(range(9))
    assert from_json(kind, {})["k"].tolist() == [0.0] * 9
    assert from_json(kind, {})["d"].tolist() == []


@pytest.mark.parametrize(
    ("given", "path", "problem"),
    [
        ({"position": [1, "x"]}, "position[1]", "got 'x', expected `float`"),
        ({"position": {"0": 1}}, "position", "got dict of 1, expected `array`"),
        ({"positions": []}, "", "unknown field `positions`; known: header, name"),
        ({"header": {"stamp": 3}}, "header.stamp", "got 3, expected `object`"),
        ({"header": {"stamp": {"s": 3}}}, "header.stamp", "unknown field `s`"),
        ({"header": {"stamp": {"secs": 0.5}}}, "header.stamp.secs", "got 0.5, expected `int`"),
        ({"name": [1]}, "name[0]", "got 1, expected `str`"),
        ([], "", "got list of 0, expected `object`"),
    ],
)
def test_an_error_says_which_field(given: Any, path: str, problem: str) -> None:
    with pytest.raises(MessageError) as caught:
        from_json("sensor_msgs/JointState", given)
    assert caught.value.path == path
    assert problem in caught.value.problem


def test_bytes_that_are_no_base64_are_refused() -> None:
    with pytest.raises(MessageError, match=r"data: got 'a!', invalid base64"):
        from_json("sensor_msgs/Image", {"data": "a!"})
    with pytest.raises(MessageError, match=r"data: got 'AP8H!', invalid base64"):
        from_json("sensor_msgs/Image", {"data": "AP8H!"})
    with pytest.raises(MessageError, match=r"data\[0\]: got 256, expected `int` <= 255"):
        from_json("sensor_msgs/Image", {"data": [256]})
