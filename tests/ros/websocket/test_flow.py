"""Rates and queues: bounded, in order, and the newest state counts."""

from __future__ import annotations

import json

import pytest
from websockets.frames import Frame, Opcode

from trocar.ros.transports.websocket.protocol import as_json, frame
from trocar.ros.transports.websocket.server import Bucket, Outbox, Throttle


def test_a_burst_passes_and_then_the_rate() -> None:
    bucket = Bucket(rate=100.0)
    assert sum(bucket.take(1.0, 5.0) for _ in range(500)) == 100
    passed = sum(bucket.take(1.0, 5.0 + 0.001 * k) for k in range(1, 1001))
    assert 99 <= passed <= 100


def test_what_is_larger_than_the_burst_never_passes() -> None:
    assert not Bucket(rate=100.0).take(101.0, 1e6)


def test_a_throttle_lets_as_many_pass_as_asked_on_average() -> None:
    throttle = Throttle(1 / 60)
    assert 600 <= sum(throttle.passes(10.0 + k / 220) for k in range(2200)) <= 601


def test_a_throttle_does_not_catch_up_after_a_rest() -> None:
    throttle = Throttle(1.0)
    assert throttle.passes(0.0)
    assert throttle.passes(100.0)
    assert not throttle.passes(100.5)


def test_what_waits_leaves_in_order_and_the_oldest_goes_beyond_the_capacity() -> None:
    outbox = Outbox(capacity=3)
    for k in range(5):
        outbox.put(b"%d" % k)
    assert outbox.lost == 2
    assert [outbox.take(), outbox.take()] == [b"2", b"3"]
    outbox.put(b"56")
    assert [outbox.take(), outbox.take()] == [b"4", b"56"]
    assert not outbox


def test_what_is_larger_than_the_capacity_does_not_wait() -> None:
    outbox = Outbox(capacity=3)
    outbox.put(b"much too long")
    assert not outbox
    assert outbox.lost == 1


@pytest.mark.parametrize("size", [0, 125, 126, 65_535, 65_536, 200_000])
def test_frames_are_those_of_the_library(size: int) -> None:
    payload = b"x" * size
    assert frame(payload) == Frame(Opcode.TEXT, payload).serialize(mask=False)


def test_half_a_character_is_written_as_it_came() -> None:
    assert json.loads(as_json({"data": "\ud800"})) == {"data": "\ud800"}
