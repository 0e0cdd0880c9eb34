"""Bytes and objects from outside: whatever they are, a message or a MessageError."""

from __future__ import annotations

import random
import tracemalloc
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.messages.content import ALL, each_type, plain, random_message
from trocar.messages import (
    MessageError,
    MessageType,
    blank,
    cdr_decode,
    cdr_encode,
    from_json,
    message_type,
    ros1_decode,
    ros1_encode,
    to_json,
)

WIRES = {"ros1": (ros1_encode, ros1_decode), "cdr": (cdr_encode, cdr_decode)}
each_wire = pytest.mark.parametrize("wire", WIRES)
# Random strings of bytes in all, over every type.
TRIES = 10_000


def carried(kind: str | MessageType, message: Any) -> None:
    """Fail unless both wires carry a message and give it back."""
    for encode, decode in WIRES.values():
        assert plain(decode(kind, encode(kind, message))).keys() == message.keys()


def tried(decode: Any, kind: MessageType, data: bytes) -> bool:
    """Whether bytes are a message; either wire can carry what is accepted."""
    try:
        message = decode(kind, data)
    except MessageError as error:
        told = error
    else:
        carried(kind, message)
        return True
    assert told.kind == kind.name
    assert len(str(told)) < 300
    return False


@each_wire
def test_random_bytes_are_a_message_or_an_error(wire: str) -> None:
    rng, accepted = random.Random(wire), 0
    for index in range(TRIES):
        kind = ALL[index % len(ALL)]
        data = rng.randbytes(rng.randrange(200))
        if wire == "cdr" and index % 8:
            data = b"\0\1\0\0" + data
        if index % 3 == 0:
            data = bytes(value & rng.choice([0, 1, 7, 255]) for value in data)
        accepted += tried(WIRES[wire][1], kind, data)
    assert accepted < TRIES // 10


@each_wire
@each_type()
def test_broken_messages_are_a_message_or_an_error(kind: MessageType, wire: str) -> None:
    rng = random.Random(kind.name)
    encode, decode = WIRES[wire]
    for _ in range(100):
        data = bytearray(encode(kind, random_message(kind, rng)))
        for _ in range(rng.randrange(1, 4)):
            if data:
                data[rng.randrange(len(data))] = rng.choice([0, 1, 127, 255, rng.randrange(256)])
        tried(decode, kind, bytes(data))


@each_wire
@each_type()
def test_no_prefix_of_a_message_is_one_and_nothing_may_follow_it(
    kind: MessageType, wire: str
) -> None:
    encode, decode = WIRES[wire]
    data = encode(kind, random_message(kind, random.Random(kind.name)))
    for size in range(len(data)):
        assert not tried(decode, kind, data[:size])
    assert tried(decode, kind, data)
    assert not tried(decode, kind, data + bytes(4))
    assert tried(decode, kind, data + bytes(3)) == (wire == "cdr")


@each_wire
def test_a_count_that_the_bytes_do_not_justify_allocates_nothing(wire: str) -> None:
    encode, decode = WIRES[wire]
    for kind in ALL:
        data = bytearray(encode(kind, blank(kind)))
        start = 4 if wire == "cdr" else 0
        for at in range(start, len(data) - 3, 4):
            huge = bytes(data[:at]) + b"\xff\xff\xff\x7f" + bytes(data[at + 4 :])
            tracemalloc.start()
            tried(decode, kind, huge)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert peak < 1_000_000, kind.name


def test_only_little_endian_cdr_is_read() -> None:
    for prefix in ("0000", "0003", "0007", "000b"):
        with pytest.raises(MessageError, match="little endian"):
            cdr_decode("std_msgs/Bool", bytes.fromhex(prefix) + b"\0\0\1")
    assert cdr_decode("std_msgs/Bool", b"\0\1\0\3\1\0\0\0") == {"data": True}
    with pytest.raises(MessageError, match="nothing"):
        cdr_decode("std_msgs/Bool", b"")


def test_errors_of_bytes_say_which_field() -> None:
    message = blank("sensor_msgs/JointState") | {"name": ["yaw"], "position": [1.0]}
    data = ros1_encode("sensor_msgs/JointState", message)
    with pytest.raises(MessageError, match="JointState: effort: "):
        ros1_decode("sensor_msgs/JointState", data[:-4])
    with pytest.raises(MessageError, match=r"JointState: position: .*entries"):
        ros1_decode("sensor_msgs/JointState", data.replace(b"yaw\1\0\0\0", b"yaw\1\0\0\1"))
    with pytest.raises(MessageError, match=r"JointState: name: .*utf-8"):
        ros1_decode("sensor_msgs/JointState", data.replace(b"yaw", b"\xff\xff\xff"))
    late = data[:8] + (10**9).to_bytes(4, "little") + data[12:]
    with pytest.raises(MessageError, match=r"JointState: header\.stamp: "):
        ros1_decode("sensor_msgs/JointState", late)
    with pytest.raises(
        MessageError, match=r"String: data: .*a string of 5 bytes, but only 2 remain"
    ):
        ros1_decode("std_msgs/String", b"\5\0\0\0ab")
    with pytest.raises(MessageError, match=r"String: data: .*without terminator"):
        cdr_decode("std_msgs/String", b"\0\1\0\0\2\0\0\0ab")
    with pytest.raises(MessageError, match="ends after"):
        ros1_decode("std_msgs/Bool", b"\0\0")


ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["data", "header", "stamp", "secs", "name", "position", "x", "layout"]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(given_object=ANY_JSON, name=st.sampled_from([kind.name for kind in ALL]))
@settings(max_examples=400, deadline=None)
def test_any_json_is_a_message_or_an_error(given_object: Any, name: str) -> None:
    try:
        message = from_json(name, given_object)
    except MessageError:
        return
    carried(name, message)


@each_type()
def test_json_with_one_wrong_value_is_a_message_or_an_error(kind: MessageType) -> None:
    rng = random.Random(kind.name)
    wrong: list[Any] = [None, True, -1, 2**70, 10**400, 0.5, float("nan"), "x", [], {}, [[]], "==="]
    for _ in range(100):
        given_object = to_json(kind, random_message(kind, rng))
        spoil(given_object, rng, rng.choice(wrong))
        try:
            carried(kind, from_json(kind, given_object))
        except MessageError:
            continue


def spoil(value: Any, rng: random.Random, wrong: Any) -> None:
    """Put something else into one place of an object."""
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    if not keys:
        return
    key = rng.choice(keys)
    if isinstance(value[key], dict | list) and rng.random() < 0.7:
        spoil(value[key], rng, wrong)
    else:
        value[key] = wrong


def test_a_type_of_one_page_has_no_way_to_nest_without_end() -> None:
    deep: Any = {}
    for _ in range(5000):
        deep = {"header": deep}
    with pytest.raises(MessageError):
        from_json(message_type("sensor_msgs/JointState"), deep)
