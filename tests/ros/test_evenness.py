"""Samples go out as evenly as their rate says, however the ticks that they show fall."""

from __future__ import annotations

import queue
import threading
from typing import Literal

import numpy as np
import pytest

from tests.ros.served import HandClock
from trocar.live import Loop
from trocar.live.inbox import Command
from trocar.live.state import Elapsed
from trocar.ros import Core, sampler
from trocar.ros.clock import Stamper
from trocar.ros.core import Batch
from trocar.ros.sample import Sample
from trocar.ros.sampler import READY_S, Sampler, behind_s
from trocar.ros.transports.memory import MemoryTransport
from trocar.simulation import World

TICK_S, BEGIN_S = 0.001, 100.0


class Busy(HandClock):
    """The clock of a machine that is busy: each wait takes a little too long."""

    def __init__(self, most_s: float) -> None:
        super().__init__()
        self._chance, self._most_s = np.random.default_rng(5), most_s

    def sleep(self, seconds: float, until: object = None) -> None:
        late = self._chance.uniform(0.0, self._most_s) if self._most_s else 0.0
        super().sleep(max(seconds, 0.0) + late, until)


def taken(
    rate: float,
    late_s: float = 0.0,
    speed: Literal["realtime", "max"] = "realtime",
) -> list[Sample]:
    """Return the samples of 0.3 s of a loop."""
    loop = Loop(World("psm"), speed=speed, tick_s=TICK_S, clock=Busy(late_s))
    samples: queue.SimpleQueue[Sample | None] = queue.SimpleQueue()
    watch = Sampler(loop, {"PSM1": "PSM1"}, Stamper(), rate, samples, lambda *_: None)
    watch.wanted = frozenset({"PSM1/measured_js"})
    watch.start()
    loop.run(0.3)
    found = [samples.get() for _ in range(samples.qsize())]
    return [sample for sample in found if sample is not None]


@pytest.mark.parametrize("late_s", [0.0, 0.004])
@pytest.mark.parametrize("rate", [50.0, 220.0, 250.0])
def test_samples_go_out_on_schedule_and_leave_time_to_make_them(rate: float, late_s: float) -> None:
    samples = taken(rate, late_s)
    out = np.array([sample.due_s for sample in samples])
    periods = (out - out[0]) * rate
    assert len(out) > 0.4 * 0.3 * rate
    assert periods == pytest.approx(np.rint(periods), abs=1e-6)
    assert (np.diff(np.rint(periods)) >= 1).all()
    tick = np.array([BEGIN_S - TICK_S + sample.elapsed for sample in samples])
    held = (out - tick)[1:]  # the first is due when time begins, a tick before there is one
    longest = behind_s(rate, TICK_S)
    assert longest is not None
    assert (held >= READY_S - 1e-5).all()
    assert (held <= longest + 1e-5).all()


@pytest.mark.parametrize("rate", [250.0, 100.0])
def test_where_every_tick_is_as_far_from_its_sample_none_waits_longer(rate: float) -> None:
    assert behind_s(rate, TICK_S) == READY_S
    assert behind_s(rate - 1.0, TICK_S) == READY_S + TICK_S


@pytest.mark.parametrize("rate", [333.0, 1000.0])
def test_at_high_rates_messages_go_out_as_soon_as_they_are_made(rate: float) -> None:
    assert behind_s(rate, TICK_S) is None
    assert {sample.due_s for sample in taken(rate)} == {None}


def test_nothing_is_held_back_where_nobody_keeps_time() -> None:
    assert {sample.due_s for sample in taken(220.0, speed="max")} == {None}


@pytest.mark.parametrize(("speed", "asked", "ticks"), [
    ("realtime", True, {1, 2, 3, 4}), ("realtime", False, {1, 2, 3, 4, 5}),
    ("max", True, {1, 2, 3, 4, 5}),
])  # fmt: skip
def test_ticks_may_follow_each_other_up_to_the_one_before_a_sample_that_somebody_waits_for(
    speed: Literal["realtime", "max"], asked: bool, ticks: set[int]
) -> None:
    loop = Loop(World("psm"), speed=speed, tick_s=TICK_S, clock=HandClock())
    watch = Sampler(loop, {}, Stamper(), 220.0, queue.SimpleQueue(), lambda *_: None)
    watch.wanted = frozenset({"PSM1/measured_js"} if asked else ())
    watch.start()
    found: set[int] = set()
    for _ in range(50):
        loop.tick()
        found.add(watch.patience())
    assert found == ticks


@pytest.mark.parametrize(("rate", "most"), [(50.0, 5.0), (220.0, 2.0), (1000.0, 1.0)])
def test_a_tick_that_a_sample_shows_runs_alone_and_those_before_it_together(
    rate: float, most: float
) -> None:
    class Grouped(Loop):
        def tick(self, due: int = 1) -> None:
            before = samples.qsize()
            super().tick(due)
            groups.append((due, samples.qsize() > before))

    groups: list[tuple[int, bool]] = []
    loop = Grouped(World("psm"), tick_s=TICK_S, clock=HandClock())
    samples: queue.SimpleQueue[Sample | None] = queue.SimpleQueue()
    watch = Sampler(loop, {}, Stamper(), rate, samples, lambda *_: None)
    watch.wanted = frozenset({"PSM1/measured_js"})
    watch.start()
    loop.run(0.2)
    assert {due for due, sampled in groups if sampled} == {1}
    assert len(groups) <= most * 0.2 * rate + 2


def test_who_steps_a_paused_world_gets_what_comes_of_it_at_once() -> None:
    loop = Loop(World("psm"), tick_s=TICK_S, clock=HandClock())
    samples: queue.SimpleQueue[Sample | None] = queue.SimpleQueue()
    Sampler(loop, {}, Stamper(), 1.0, samples, lambda *_: None).start()
    loop.post(Command("world", "pause"))
    loop.tick()
    while not samples.empty():
        samples.get()
    loop.post(Command("world", "step", {"periods": 1}))
    loop.tick()
    sample = samples.get_nowait()
    assert sample is not None
    assert sample.due_s is None


def test_no_message_leaves_before_it_is_due(monkeypatch: pytest.MonkeyPatch) -> None:
    class Timed(MemoryTransport):
        def send(self, batch: Batch) -> None:
            if batch:
                sent.append(loop.now)
                enough.set()

    class Onlooker:
        def ticked(self, elapsed: Elapsed) -> None:
            if elapsed.due_s is not None:
                due_s.append(elapsed.due_s)

        def patience(self) -> int:
            return 1

        def refused(self, command: Command, reason: str) -> None:
            raise AssertionError(command, reason)

    monkeypatch.setattr(sampler, "READY_S", 0.2)
    sent: list[float] = []
    due_s: list[float] = []
    enough = threading.Event()
    loop = Loop(World("psm"), tick_s=TICK_S)
    core = Core(loop, rate_hz=1.0)
    core.attach(Timed(["PSM1/measured_js"]))
    loop.watch(Onlooker())
    core.start()
    loop.start()
    assert enough.wait(30.0)
    loop.close()
    core.close()
    assert sent[0] >= due_s[0] + 0.2 - TICK_S
