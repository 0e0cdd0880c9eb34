"""Who looks on at a loop, and complaints that are told limit."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.live import Command, Loop
from trocar.live.state import Elapsed
from trocar.simulation import World
from trocar.simulation.rate_limit import KINDS, RateLimit, suffix


class Onlooker:
    def __init__(self) -> None:
        self.seen: list[Elapsed] = []
        self.refusals: list[tuple[Command, str]] = []

    def ticked(self, elapsed: Elapsed) -> None:
        self.seen.append(elapsed)

    def patience(self) -> int:
        return 1

    def refused(self, command: Command, reason: str) -> None:
        self.refusals.append((command, reason))


@pytest.fixture
def loop() -> Loop:
    return Loop(World("psm"), tick_s=0.001)


def test_a_watcher_sees_every_tick_and_pauses_too(loop: Loop) -> None:
    onlooker = Onlooker()
    stop = loop.watch(onlooker)
    loop.tick()
    loop.tick()
    loop.post(Command("world", "pause"))
    loop.tick()
    assert [(e.simulated_s, e.paused) for e in onlooker.seen] == [
        (0.001, False),
        (0.002, False),
        (0.002, True),
    ]
    stop()
    loop.tick()
    assert len(onlooker.seen) == 3


def test_a_watcher_learns_of_commands_that_raise(
    loop: Loop, caplog: pytest.LogCaptureFixture
) -> None:
    onlooker = Onlooker()
    loop.watch(onlooker)
    command = Command("PSM1", "dance")
    for _ in range(3):
        loop.post(command)
    loop.post(Command("PSM1", "set_mode", {"mode": "effort"}))
    loop.tick()
    assert [c for c, _ in onlooker.refusals] == [command] * 3
    assert "dance" in onlooker.refusals[0][1]
    assert caplog.text.count("rejected: ") == 3


def test_the_same_complaint_is_due_once_in_two_seconds_with_how_many_were_left_out() -> None:
    limit = RateLimit()
    assert [limit.due("a", t) for t in (0.0, 0.5, 1.9)] == [0, None, None]
    assert limit.due("b", 1.9) == 0
    assert limit.due("a", 2.0) == 2
    assert suffix(2) == " (2 more such since)"
    assert suffix(0) == ""
    limit.forget()
    assert limit.due("a", 2.0) == 0


def test_a_burst_of_complaints_is_due_and_the_rest_counted() -> None:
    limit = RateLimit()
    assert [limit.due("a", 0.01 * k, 3) for k in range(5)] == [0, 0, 0, None, None]
    assert [limit.due("a", 2.0 + 0.01 * k, 3) for k in range(4)] == [2, 0, 0, None]


@given(times=st.lists(st.floats(0.0, 20.0), max_size=50).map(sorted))
def test_every_complaint_is_told_or_counted(times: list[float]) -> None:
    limit = RateLimit()
    told = [limit.due("kind", t) for t in times]
    end = limit.due("kind", 100.0)
    assert sum(1 + unsaid for unsaid in (*told, end) if unsaid is not None) == len(times) + 1


def test_kinds_of_complaints_are_bounded() -> None:
    limit = RateLimit()
    for kind in range(10 * KINDS):
        limit.due(kind, 0.0)
    assert len(limit) <= KINDS
