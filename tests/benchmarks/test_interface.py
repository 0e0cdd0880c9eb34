"""Lost and late are judged against a schedule that nothing shifts, by what a subscriber saw."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from benchmarks.client import Peer, flood, sleep
from benchmarks.interface import (
    TRANSPORTS,
    arrivals,
    busy_rig,
    interface,
    state_topics,
    together,
)
from trocar.errors import UnknownNameError
from trocar.simulation import World

RATE = 200.0
PERIOD = 5_000_000
RNG = np.random.default_rng(6)


def schedule(count: int = 1000) -> np.ndarray:
    return 1_700_000_000_000_000_000 + PERIOD * np.arange(count, dtype=np.int64)


def test_a_constant_delay_is_no_lateness() -> None:
    stamps = schedule()
    seen = arrivals(stamps, stamps + 40_000_000, RATE)
    assert (seen.received, seen.lost, seen.late) == (1000, 0, 0)
    assert seen.factor == pytest.approx(1.0) and seen.worst_s == pytest.approx(0.0)


def test_what_comes_more_than_two_milliseconds_behind_is_late() -> None:
    stamps = schedule()
    behind = np.zeros(1000, dtype=np.int64)
    behind[100:110], behind[200] = 2_100_000, 1_900_000
    seen = arrivals(stamps, stamps + behind, RATE)
    assert seen.late == 10 and seen.worst_s == pytest.approx(2.1e-3)
    assert seen.late_percent == pytest.approx(1.0)


def test_a_delay_that_grows_is_lateness_and_a_factor_below_one() -> None:
    stamps = schedule()
    seen = arrivals(stamps, stamps + np.arange(1000) * 50_000, RATE)
    assert seen.late > 900 and seen.factor == pytest.approx(1 / 1.01)


def test_what_never_came_is_counted_wherever_it_is_missing() -> None:
    stamps = schedule()
    keep = np.ones(1000, dtype=bool)
    keep[RNG.choice(np.arange(1, 999), 37, replace=False)] = False
    assert arrivals(stamps[keep], stamps[keep], RATE).lost == 37


def test_stamps_of_whole_ticks_are_told_apart_at_220_hertz() -> None:
    due = np.arange(2200) / 220.0
    stamps = (np.ceil(due * 1000 - 1e-6) * 1_000_000).astype(np.int64)
    seen = arrivals(stamps, stamps, 220.0)
    assert (seen.lost, seen.late) == (0, 0)


def test_streams_add_up_and_a_silent_one_is_seen() -> None:
    stamps = schedule()
    some = arrivals(stamps, stamps, RATE)
    none = arrivals(stamps[:0], stamps[:0], RATE)
    both = together([some, none])
    assert both.received == 1000 and both.factor == 0.0


def test_a_subscriber_in_another_process_sees_a_running_simulator() -> None:
    topics, transport = ["PSM1/measured_js", "PSM1/measured_cp"], TRANSPORTS["websocket"]
    with transport.serve("--rig", "psm", "--rate", "50") as server:
        seen, _ = transport.listen(server, 50.0, topics, 0.5)
        assert server.processor_s() > 0.0 and server.memory_mb() > 0.0
    assert seen.received > 10 and seen.factor > 0.0


def test_a_flood_is_as_many_commands_as_it_says_and_half_of_them_are_none(monkeypatch) -> None:
    sent: list[list[float]] = []
    monkeypatch.setattr("benchmarks.client.SETTLE_S", 0.0)
    rate = flood(cast(Peer, SimpleNamespace(servo=sent.append)), 2000.0, 0.1)
    assert 0 < rate <= 2100.0 and len(sent) <= 201
    lost = [not np.isfinite(position).all() for position in sent]
    assert lost == [k % 2 == 1 for k in range(len(lost))]


def test_a_process_that_only_sleeps_keeps_its_schedule_in_number_and_never_wakes_early(
    monkeypatch,
) -> None:
    monkeypatch.setattr("benchmarks.client.SETTLE_S", 0.0)
    noted = np.array(sleep(500.0, 0.2)[""])
    assert len(noted) == 100
    assert set(np.diff(noted[:, 0])) == {2_000_000}
    assert (noted[:, 1] >= noted[:, 0]).all()


def test_all_77_states_of_the_full_cart_are_made_and_timed() -> None:
    figure = state_topics(periods=3)
    assert figure.name.startswith("all 77 state topics") and figure.unit == "ms a period"
    assert figure.value > 0.0 and figure.upper == 1.5


def test_a_transport_that_is_none_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="websocket, ros1"):
        interface(["pigeon"], 1.0, lambda _: None)


def test_the_rig_has_six_arms_to_listen_to_and_twenty_objects_at_rest(tmp_path) -> None:
    world = World(busy_rig(str(tmp_path)))
    assert {"PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR"} <= set(world.arms)
    before = [world.object(name).measured_cp().matrix[:3, 3] for name in world.objects]
    world.step(300)
    after = [world.object(name).measured_cp().matrix[:3, 3] for name in world.objects]
    assert len(before) == 20
    np.testing.assert_allclose(after, before, atol=1e-4)
