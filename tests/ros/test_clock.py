"""Stamps: they only go forward, are never zero, and follow one of two clocks."""

from __future__ import annotations

import sys
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.ros.served import Served, stamp_ns
from trocar.errors import UnknownNameError
from trocar.live import Command
from trocar.live.state import Elapsed
from trocar.ros.clock import Beat, Stamper

BEGIN = 1_700_000_000 * 1_000_000_000
MS = 1_000_000


def ns(stamp: tuple[int, int]) -> int:
    return stamp[0] * 1_000_000_000 + stamp[1]


@pytest.mark.parametrize("mode", ["wall", "sim"])
@given(steps=st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(-1.0, 2.0), st.booleans())))
def test_stamps_increase_strictly_whatever_time_does(mode, steps) -> None:
    stamper = Stamper(mode, lambda: BEGIN)
    last, wall = 0, 0.0
    for simulated, passed, paused in steps:
        wall += passed
        stamper.advance(Elapsed(simulated, 0.0, paused), wall)
        now = ns(stamper.stamp())
        assert now > last
        last = now


def test_by_default_stamps_are_the_wall_clock_at_the_start_plus_simulated_time() -> None:
    stamper = Stamper("wall", lambda: BEGIN)
    stamper.advance(Elapsed(0.0, 0.0, False), 16.0)
    stamper.advance(Elapsed(0.25, 0.0, False), 17.0)
    assert ns(stamper.stamp()) == BEGIN + 250 * MS


def test_what_clients_wait_for_is_not_stamped_before_their_command() -> None:
    wall = 16.0
    stamper = Stamper("wall", lambda: BEGIN + round((wall - 10.0) * 1000) * MS)
    wall = 18.0  # as long as it took until time began to pass
    stamper.advance(Elapsed(0.0, 0.0, False), wall)
    command = BEGIN + 8000 * MS + 300 * MS
    stamper.advance(Elapsed(0.25, 0.0, False), 18.3)  # 50 ms behind
    assert ns(stamper.stamp(18.3001)) > command
    assert ns(stamper.stamp()) > command  # and nothing goes back afterwards
    stamper.advance(Elapsed(0.5, 0.0, False), 18.5)
    assert ns(stamper.stamp()) == BEGIN + 8500 * MS


def test_simulated_time_begins_at_one_second() -> None:
    stamper = Stamper("sim", lambda: BEGIN)
    stamper.advance(Elapsed(0.0, 0.0, False), 5.0)
    assert stamper.stamp() == (1, 0)
    stamper.advance(Elapsed(0.5, 3.0, False), 9.0)
    assert stamper.stamp() == (1, 500 * MS)


def test_pauses_count_on_the_wall_clock_only() -> None:
    for stamper, expected in (
        (Stamper("wall", lambda: BEGIN), BEGIN + 3000 * MS),
        (Stamper("sim"), 2000 * MS),
    ):
        stamper.advance(Elapsed(0.0, 0.0, False), 9.0)
        stamper.advance(Elapsed(1.0, 0.0, False), 10.0)
        stamper.advance(Elapsed(1.0, 0.0, True), 12.0)
        assert ns(stamper.stamp()) == expected


def test_another_clock_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="clock"):
        Stamper("moon")  # type: ignore[arg-type]


@given(rate=st.floats(1.0, 1000.0), ticks=st.integers(1, 3000))
def test_a_beat_keeps_its_rate_and_is_late_by_a_tick_at_most(rate: float, ticks: int) -> None:
    beat = Beat(rate)
    times = [0.001 * k for k in range(ticks) if beat.due(0.001 * k)]
    count = int((0.001 * (ticks - 1) + Beat.SLACK_S) * rate) + 1
    assert len(times) == count
    late = np.array(times) - np.arange(count) / rate
    assert (late >= -2 * Beat.SLACK_S).all()
    assert (late < 0.001 + Beat.SLACK_S).all()


def test_a_pause_repeats_values_under_new_stamps_and_a_reset_turns_nothing_back() -> None:
    served = Served(wanted=["PSM1/measured_js"])
    served.run(0.2)
    before = len(served.messages("PSM1/measured_js"))
    served.loop.post(Command("world", "pause"))
    served.run(0.2)
    paused = served.messages("PSM1/measured_js")[before + 2 :]
    assert len(paused) > 40
    assert all(np.array_equal(m["position"], paused[0]["position"]) for m in paused)
    served.loop.post(Command("world", "resume"))
    served.loop.post(Command("world", "reset"))
    served.run(0.2)
    stamps = [stamp_ns(m) for m in served.messages("PSM1/measured_js")]
    assert (np.diff(stamps) > 0).all()
    assert np.diff(stamps).max() < 7 * MS  # 4.5 ms, whole ticks, no jump


def test_the_simulated_clock_is_told_and_stands_while_paused() -> None:
    served = Served(wanted=["clock", "PSM1/measured_js"], clock="sim")
    served.run(0.1)
    served.loop.post(Command("world", "pause"))
    served.run(0.1)
    times = [ns(m["clock"]) for m in served.messages("clock")]
    assert times == [stamp_ns(m) for m in served.messages("PSM1/measured_js")]
    assert (np.diff(times) > 0).all()
    assert 0 <= times[0] - 1001 * MS < 1000  # what came before it has nanoseconds of its own
    assert times[-1] < 1101 * MS


def test_without_simulated_time_there_is_no_clock() -> None:
    served = Served(wanted=["clock"])
    served.run(0.05)
    assert not served.messages("clock")


def test_what_is_stamped_after_a_look_at_the_time_is_later() -> None:
    """Clients wait for a state that is newer than the moment at which they sent a move."""
    stamper = Stamper("sim")
    stamper.advance(Elapsed(0.5, 0.0, False), 1.0)
    for _ in range(3):
        asked = stamper.now()
        assert stamper.stamp() > asked


def test_whoever_asks_for_the_time_turns_no_stamp_back() -> None:
    """Threads change every microsecond here, so that they meet within each other's reading."""
    stamper, over = Stamper("wall", lambda: BEGIN), threading.Event()
    stamper.advance(Elapsed(0.0, 0.0, False), 0.0)

    def ask() -> None:
        while not over.is_set():
            stamper.now()

    asks = threading.Thread(target=ask)
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        asks.start()
        stamps = [ns(stamper.stamp()) for _ in range(300_000)]
    finally:
        over.set()
        asks.join()
        sys.setswitchinterval(before)
    assert (np.diff(stamps) > 0).all()
