"""What clients send becomes a frozen record or one clear error, whatever it is."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from trocar.ros.transports.websocket.protocol import (
    OPERATIONS,
    UNSUPPORTED,
    Advertise,
    AnyRequest,
    Auth,
    CallService,
    Publish,
    RequestError,
    SetLevel,
    Subscribe,
    Unadvertise,
    Unsubscribe,
    read_request,
)


def read(**document: Any) -> AnyRequest:
    return read_request(json.dumps(document))


@pytest.mark.parametrize(
    ("document", "request_"),
    [
        (
            {"op": "advertise", "id": "1", "topic": "/a", "type": "std_msgs/Empty", "latch": False},
            Advertise(id="1", topic="/a", type="std_msgs/Empty"),
        ),
        ({"op": "unadvertise", "topic": "/a"}, Unadvertise(topic="/a")),
        ({"op": "publish", "topic": "/a", "msg": {"b": 1}}, Publish(topic="/a", msg={"b": 1})),
        ({"op": "subscribe", "topic": "/a"}, Subscribe(topic="/a")),
        (
            {
                "op": "subscribe",
                "id": "s",
                "topic": "a",
                "type": "x/Y",
                "throttle_rate": 250,
                "queue_length": 3,
                "compression": "cbor",
            },
            Subscribe(id="s", topic="a", type="x/Y", throttle_rate=250.0),
        ),
        ({"op": "subscribe", "topic": "/a", "compression": "png"}, Subscribe(topic="/a")),
        ({"op": "unsubscribe", "id": "s", "topic": "/a"}, Unsubscribe(id="s", topic="/a")),
        ({"op": "call_service", "service": "/s"}, CallService(service="/s")),
        ({"op": "call_service", "service": "/s", "args": [1]}, CallService(service="/s", args=[1])),
        ({"op": "set_level", "level": "none"}, SetLevel(level="none")),
        ({"op": "auth", "mac": "..."}, Auth()),
    ],
)
def test_a_request_is_read(document: dict[str, Any], request_: AnyRequest) -> None:
    assert read(**document) == request_


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "invalid JSON"),
        ("{", "invalid JSON"),
        ("[" * 100_000, "invalid JSON"),
        ("9" * 10_000, "invalid JSON"),
        (b"{}", "got a binary message"),
        ("3", "got 3; allowed: an object with an 'op'"),
        ("{}", "op: got None; allowed: advertise, unadvertise, publish"),
        ('{"op": "shutdown"}', "op: got 'shutdown'; allowed"),
        ('{"op": ["publish"]}', r"op: got \['publish'\]"),
        (
            '{"op": "publish", "topic": 3, "msg": {}}',
            "publish: topic: got 3; allowed: up to 256 printable",
        ),
        ('{"op": "publish", "topic": "", "msg": {}}', "publish: topic: got ''"),
        ('{"op": "publish", "topic": "/a"}', "publish: msg: got nothing; allowed: an object"),
        ('{"op": "publish", "topic": "/a", "msg": [1]}', r"publish: msg: got \[1\]"),
        ('{"op": "subscribe"}', "subscribe: topic: got nothing"),
        ('{"op": "subscribe", "topic": "/a", "throttle_rate": -1}', "throttle_rate: got -1"),
        ('{"op": "subscribe", "topic": "/a", "throttle_rate": NaN}', "throttle_rate: got nan"),
        ('{"op": "subscribe", "topic": "/a", "throttle_rate": true}', "throttle_rate: got True"),
        ('{"op": "call_service", "service": "/s", "args": "x"}', "args: got 'x'; allowed: an ob"),
        ('{"op": "set_level", "level": "loud"}', "level: got 'loud'; allowed: none, error"),
        ('{"op": "publish", "id": 3}', "id: got 3; allowed: up to 256 printable"),
        ('{"op": "subscribe", "topic": "\\ud800"}', r"topic: got '\\ud800'"),
        ('{"op": "subscribe", "id": "a\\nb"}', r"id: got 'a\\nb'"),
        ('{"op": "advertise_service"}', "offered by clients are not supported"),
        ('{"op": "fragment"}', "send the message in one piece"),
        ('{"op": "send_action_goal"}', "actions are not supported"),
    ],
)
def test_what_cannot_be_read_is_one_clear_error(text: str, words: str) -> None:
    with pytest.raises(RequestError, match=words) as caught:
        read_request(text)
    assert len(str(caught.value)) < 400


def test_an_error_names_the_request() -> None:
    with pytest.raises(RequestError) as caught:
        read(op="publish", id="mine")
    assert caught.value.id == "mine"


plain = st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5)
anything = plain | st.lists(plain, max_size=2) | st.dictionaries(st.text(max_size=3), plain)
fields = st.sampled_from(
    ["id", "topic", "type", "msg", "service", "args", "throttle_rate", "compression", "level"]
)


@given(st.sampled_from([*OPERATIONS, *UNSUPPORTED]), st.dictionaries(fields, anything))
@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # the machine may be busy
def test_any_fields_are_read_or_refused(op: str, document: dict[str, Any]) -> None:
    with contextlib.suppress(RequestError):
        read(op=op, **document)


@given(st.text() | st.binary())
@settings(deadline=None)
def test_any_text_is_read_or_refused(text: str | bytes) -> None:
    with pytest.raises(RequestError):
        read_request(text)
