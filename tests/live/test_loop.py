"""The real-time loop: when ticks happen, what they apply, and how they end."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

import numpy as np
import pytest

from tests.live.fake_world import FakeWorld
from trocar.errors import DivergedError, InputError, UnknownNameError
from trocar.live import Command, Loop
from trocar.live.inbox import Inbox
from trocar.live.pace import GIVE_UP_S, Pace, Speedometer
from trocar.simulation.records import Snapshot

GOAL = (0.3, -0.2, 0.1, 0.5)


class FakeClock:
    """Time that passes only by sleeping, or by `late` extra seconds at each look."""

    def __init__(self) -> None:
        self.time = 100.0
        self.sleeps: list[float] = []

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float, until: threading.Event | None = None) -> None:  # noqa: ARG002
        self.sleeps.append(seconds)
        self.time += max(seconds, 0.0)


class SlowWorld(FakeWorld):
    """A world whose calls of `step` take wall time, one of them more than the others.

    Args:
        hiccup: (simulated time at which it comes, how long it takes)
    """

    def __init__(self, clock: FakeClock, cost_s: float, hiccup=(np.inf, 0.0)) -> None:
        super().__init__()
        self.clock, self.cost_s, self.hiccup = clock, cost_s, hiccup

    def step(self, n: int = 1) -> None:
        super().step(n)
        self.clock.time += self.cost_s
        when, extra = self.hiccup
        if self.time - n * self.timestep < when <= self.time:
            self.clock.time += extra


def loop_of(world: Any, clock: FakeClock | None = None, **options: Any) -> Loop:
    return Loop(world, clock=clock or FakeClock(), **options)


def threaded(world: Any, **options: Any) -> Loop:
    return Loop(world, speed="max", **options)


def test_realtime_keeps_to_the_wall_clock():
    world, clock = FakeWorld(), FakeClock()
    loop_of(world, clock).run(duration_s=2.0)
    assert world.time == pytest.approx(2.0)
    assert clock.time - 100.0 == pytest.approx(2.0 - 0.005, abs=1e-9)


def test_a_late_tick_is_caught_up_without_drift():
    clock = FakeClock()
    world = SlowWorld(clock, cost_s=0.001, hiccup=(1.0, 0.3))
    loop_of(world, clock).run(duration_s=2.0)
    assert clock.time - 100.0 == pytest.approx(2.0 - 0.005 + 0.001, abs=1e-9)


def test_time_too_far_behind_is_let_go_with_a_warning(caplog):
    clock = FakeClock()
    pace = Pace(clock, 0.005)
    pace.wait()
    clock.time += 3600.0
    with caplog.at_level(logging.WARNING, "trocar"):
        pace.wait()
    assert pace.let_go_s == pytest.approx(3600.0 - 0.005)
    assert "behind real time" in caplog.text
    before = clock.time
    pace.wait()
    assert clock.time - before == pytest.approx(0.005)
    assert GIVE_UP_S < 5.0


def test_a_machine_that_is_always_too_slow_is_told_of_once_a_minute_with_how_often(caplog):
    clock = FakeClock()
    pace = Pace(clock, 0.005)
    with caplog.at_level(logging.WARNING, "trocar"):
        for _ in range(80):
            clock.time += 1.3
            pace.wait()
    assert [r.getMessage() for r in caplog.records] == [
        "1.3 s behind real time: skipping the delay",
        "1.3 s behind real time: skipping the delay (46 more such since)",
    ]


def test_max_speed_never_sleeps():
    world, clock = FakeWorld(), FakeClock()
    loop_of(world, clock, speed="max").run(duration_s=1.0)
    assert clock.sleeps == []
    assert world.time == pytest.approx(1.0)


def test_the_speedometer_measures_the_last_seconds():
    meter = Speedometer()
    for k in range(50):
        meter.mark(0.1 * k, 0.3 * k)
    assert meter.factor == pytest.approx(3.0)
    for k in range(50, 100):
        meter.mark(0.1 * k, 0.3 * 49)
    assert meter.factor == 0.0


def test_commands_are_applied_at_tick_boundaries_only():
    world = FakeWorld()
    loop = loop_of(world)
    loop.post(Command("PSM1", "servo_jp", {"q": GOAL}))
    assert world.arms["PSM1"].calls == []
    loop.tick()
    assert world.arms["PSM1"].calls == [("servo_jp", GOAL)]


def run_with(cost_s: float, speed: str) -> np.ndarray:
    clock = FakeClock()
    world = SlowWorld(clock, cost_s)
    loop = loop_of(world, clock, speed=speed)
    script = {
        3: Command("PSM1", "move_jp", {"q": GOAL}),
        40: Command("PSM1", "jaw.move_jp", {"q": [0.4]}),
        60: Command("PSM2", "move_to", {"name": "start"}),
    }
    for tick in range(100):
        if tick in script:
            loop.post(script[tick])
        loop.run(duration_s=0.005)
    return np.concatenate([world.arms["PSM1"].q, world.arms["PSM2"].q])


def test_motion_is_bit_identical_for_the_same_commands_at_the_same_ticks():
    reference = run_with(0.0, "realtime")
    assert np.any(reference != FakeWorld().arms["PSM1"].q[0])
    for cost_s, speed in ((0.0, "max"), (0.004, "realtime"), (0.02, "realtime")):
        assert np.array_equal(reference, run_with(cost_s, speed))


def test_a_record_of_applied_commands_replays_the_motion():
    script: list = []
    world = FakeWorld()
    loop = threaded(world, on_apply=lambda tick, command: script.append((tick, command)))
    loop.start(duration_s=20.0)
    for k in range(20):
        loop.post(Command("PSM1", "move_jp", {"q": (0.01 * k, 0.0, 0.05, 0.0)}))
        assert loop.latest.time >= 0  # a reader changes nothing
    assert loop.wait(30.0)
    again = FakeWorld()
    replay = loop_of(again)
    for tick in range(loop.state.ticks):
        for due, command in script:
            if due == tick:
                replay.post(command)
        replay.tick()
    assert np.array_equal(world.arms["PSM1"].q, again.arms["PSM1"].q)


def test_the_newest_servo_of_an_arm_wins():
    inbox = Inbox()
    for k in range(1000):
        assert inbox.post(Command("PSM1", "servo_jp", {"q": (float(k),)}))
        assert inbox.post(Command("PSM2", "servo_jp", {"q": (-float(k),)}))
    assert inbox.drain() == [
        Command("PSM1", "servo_jp", {"q": (999.0,)}),
        Command("PSM2", "servo_jp", {"q": (-999.0,)}),
    ]
    assert inbox.drain() == []


def test_moves_and_states_keep_their_order_and_a_servo_its_place():
    inbox = Inbox()
    posted = [
        Command("PSM1", "servo_jp", {"q": (1.0,)}),
        Command("world", "pause"),
        Command("PSM1", "move_jp", {"q": (2.0,)}),
        Command("PSM1", "servo_jf", {"effort": (3.0,)}),
        Command("PSM1", "move_jp", {"q": (4.0,)}),
        Command("world", "resume"),
    ]
    for command in posted:
        inbox.post(command)
    assert inbox.drain() == posted[1:]


def test_a_full_inbox_refuses_moves_with_a_warning_but_takes_servos(caplog):
    inbox = Inbox()
    accepted = [inbox.post(Command("PSM1", "move_jp", {"q": (float(k),)})) for k in range(70)]
    assert accepted == [True] * 64 + [False] * 6
    assert inbox.rejected == 6
    assert "64 commands pending" in caplog.text
    assert inbox.post(Command("PSM1", "servo_jp", {"q": (0.0,)}))
    assert len(inbox.drain()) == 65


def test_many_threads_may_post():
    inbox = Inbox(capacity=10_000)
    threads = [
        threading.Thread(target=lambda: [inbox.post(Command("PSM1", "hold")) for _ in range(500)])
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(inbox.drain()) == 4000


def test_pause_stops_time_but_not_commands():
    world = FakeWorld()
    loop = loop_of(world)
    loop.tick()
    loop.post(Command("world", "pause"))
    loop.post(Command("PSM1", "set_gains", {"joint": "yaw", "p": 7.0}))
    loop.tick()
    loop.tick()
    assert world.steps == 5
    assert world.arms["PSM1"].joints.gains("yaw") == (7.0, 0.0, 5.0)
    loop.post(Command("world", "resume"))
    loop.tick()
    assert world.steps == 10


def test_reset_puts_the_world_back():
    world = FakeWorld()
    loop = loop_of(world)
    loop.post(Command("PSM1", "servo_jp", {"q": GOAL}))
    for _ in range(10):
        loop.tick()
    loop.post(Command("world", "reset"))
    loop.tick()
    assert world.time == pytest.approx(0.005)
    assert np.array_equal(world.arms["PSM1"].q, FakeWorld().arms["PSM1"].q)


def test_each_command_calls_its_method():
    world = FakeWorld()
    loop = loop_of(world)
    for command in (
        Command("PSM1", "set_mode", {"mode": "effort", "joints": ("yaw",)}),
        Command("PSM1", "use_gravity_compensation", {"on": False}),
        Command("SUJ1", "release_brakes"),
        Command("PSM1", "servo_jf", {"effort": (0.1, 0.0, 0.0, 0.0)}),
        Command("PSM1", "jaw.move_jp", {"q": [0.2]}),
    ):
        loop.post(command)
    loop.tick()
    arm = world.arms["PSM1"]
    assert arm.modes[0] == "effort" and arm.modes[1] == "position"
    assert arm.joints.gravity_compensation is False
    assert world.arms["SUJ1"].brakes == {"lift": False, "swing": False}
    assert arm.effort[0] == 0.1 and arm.goal[-1] == 0.2


def test_an_unknown_arm_is_refused_where_it_is_posted():
    with pytest.raises(UnknownNameError, match=r"unknown arm 'PSM9'.*PSM1"):
        loop_of(FakeWorld()).post(Command("PSM9", "hold"))


def test_a_bad_command_is_refused_with_a_warning_and_the_loop_goes_on(caplog):
    world = FakeWorld()
    loop = loop_of(world)
    loop.post(Command("PSM1", "move_to", {"name": "nowhere"}))
    loop.post(Command("SUJ1", "jaw.move_jp", {"q": [0.1]}))
    loop.run(duration_s=0.1)
    assert world.time == pytest.approx(0.1)
    assert "unknown pose 'nowhere'" in caplog.text and "SUJ1: got the command" in caplog.text
    assert loop.state.refused == 2


def test_an_exception_that_no_command_should_raise_is_logged_once_and_the_loop_goes_on(caplog):
    world = FakeWorld()
    loop = loop_of(world)
    for _ in range(3):
        loop.post(Command("PSM1", "move_jp", {"no_such_argument": GOAL}))
    loop.run(duration_s=0.1)
    assert world.time == pytest.approx(0.1)
    assert loop.state.refused == 3
    assert [r.exc_info is not None for r in caplog.records if "rejected" in r.message] == [True]


def test_a_diverged_world_stops_the_loop_and_tells_whoever_waits():
    loop = loop_of(FakeWorld(fail_at=0.05), speed="max")
    loop.start()
    for ask in (lambda: loop.wait(10.0), loop.stop):
        with pytest.raises(DivergedError, match="PSM1/yaw"):
            ask()
    assert not loop.running


def test_the_loop_runs_in_a_thread_until_it_is_stopped():
    world = FakeWorld()
    loop = threaded(world)
    loop.start()
    assert loop.running and not loop.wait(0.05)
    with pytest.raises(InputError, match="already running"):
        loop.start()
    loop.stop()
    assert not loop.running and loop.wait()
    assert loop.latest.time == world.time > 0


def test_a_question_is_answered_between_ticks():
    loop = loop_of(FakeWorld(), speed="max")
    answer = loop.ask(lambda world: world.arm("PSM1").joints.gains("yaw"))
    wrong = loop.ask(lambda world: world.arm("PSM7"))
    assert not answer.done()
    loop.tick()
    assert answer.result(0) == (100.0, 0.0, 5.0)
    with pytest.raises(UnknownNameError):
        wrong.result(0)


def test_nobody_waits_for_an_answer_from_a_loop_that_has_ended():
    loop = loop_of(FakeWorld(fail_at=0.0), speed="max")
    loop.start()
    with pytest.raises(DivergedError):
        loop.wait(10.0)
    assert loop.ask(lambda world: world.time).cancelled()


@pytest.mark.parametrize("read", [True, False])
def test_snapshots_are_made_at_a_monitors_rate_at_most_and_only_for_readers(read: bool):
    clock = FakeClock()
    world = FakeWorld()
    looks: list[float] = []
    take = world.snapshot

    def seen(*, arms: bool = True) -> Snapshot:
        looks.append(clock.time)
        return take(arms=arms)

    world.snapshot = seen
    loop = loop_of(world, clock)
    step = world.step

    def look(n: int = 1) -> None:
        step(n)
        _ = read and loop.state

    world.step = look
    loop.run(duration_s=1.0)
    low, high = (40, 63) if read else (1, 20)  # a reader's interest lasts a quarter of a second
    assert low <= len(looks) <= high


def test_who_looks_again_after_a_while_sees_what_is_new():
    loop = Loop(FakeWorld())  # pyright: ignore[reportArgumentType]
    loop.start(duration_s=1.2)
    time.sleep(0.6)
    first = loop.latest.time
    time.sleep(0.5)
    assert loop.latest.time - first > 0.4
    loop.close()


def test_a_command_that_arrives_while_ticks_wait_meets_the_last_of_them():
    met: list[int] = []
    loop = loop_of(FakeWorld(), tick_s=0.001, on_apply=lambda tick, _: met.append(tick))
    loop.tick(3)
    loop.post(Command("PSM1", "move_jp", {"q": GOAL}))
    loop.tick(4)
    assert met == [6]


def test_a_pace_waits_for_several_ticks_and_ends_the_wait_when_it_is_told():
    clock, told = FakeClock(), threading.Event()
    pace = Pace(clock, 0.001)
    assert pace.wait() == 1
    assert pace.wait(5) == 5
    assert clock.time == pytest.approx(100.005)

    def interrupted(seconds: float, until: threading.Event | None = None) -> None:
        clock.time += max(0.0, seconds) if until is None else 0.0022

    clock.sleep = interrupted
    assert pace.wait(5, told) == 2
    assert pace.wait(5, told) == 2  # the next are due a tick after those
    clock.time += 0.003
    assert pace.wait(2, told) == 2  # late: at once, but no more than asked for


def test_a_pace_tells_when_the_last_tick_was_due_however_late_it_was():
    clock = FakeClock()
    pace = Pace(clock, 0.001)
    pace.wait()
    assert pace.due_s == 100.0
    assert pace.wait(3) == 3
    assert pace.due_s == pytest.approx(100.003)
    clock.time += 0.0025
    assert pace.wait(2) == 2
    assert pace.due_s == pytest.approx(100.005)


def test_the_state_shows_the_real_time_factor():
    clock = FakeClock()
    loop = loop_of(SlowWorld(clock, 0.010), clock)
    loop.run(duration_s=1.0)
    assert loop.real_time_factor == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("tick_s", [0.0015, 0.0, -0.005, 0.0004])
def test_a_tick_must_be_a_whole_multiple_of_the_timestep(tick_s):
    with pytest.raises(InputError, match="whole multiple"):
        loop_of(FakeWorld(), tick_s=tick_s)


@pytest.mark.parametrize(
    ("timestep_s", "ticks"), [(0.001, 200), (0.002, 250), (0.0005, 200), (0.01, 100)]
)
def test_the_usual_tick_suits_the_timestep(timestep_s: float, ticks: int) -> None:
    loop = loop_of(FakeWorld(timestep_s=timestep_s))
    loop.run(duration_s=1.0)
    assert loop.state.ticks == ticks
    assert loop.latest.time == pytest.approx(1.0)


def test_an_unknown_speed_is_refused():
    with pytest.raises(UnknownNameError, match="realtime"):
        loop_of(FakeWorld(), speed="fast")
