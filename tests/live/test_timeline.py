"""The last minute of a world as saved states."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.live import Command, Loop
from trocar.live.timeline import PERIOD_S, SPAN_S, Timeline
from trocar.simulation import World
from trocar.simulation.journal import WORLD


def made(rig: str = "psm") -> tuple[World, Loop, Timeline]:
    world = World(rig)
    loop = Loop(world, speed="max")
    timeline = Timeline(world, loop.tick_s)
    loop.watch(timeline)
    return world, loop, timeline


def test_motion_goes_on_from_a_moment_as_it_went_before() -> None:
    world, loop, timeline = made()
    loop.post(Command("PSM1", "move_jp", {"q": (0.4, -0.2, 0.15, 0.5, 0.2, 0.1)}))
    loop.run(1.0)
    first = world.arm("PSM1").measured_js().position
    moment = timeline.at(0.52)
    assert moment is not None and moment.time == pytest.approx(0.5, abs=0.006)
    loop.post(Command(WORLD, "load", {"state": moment.state}))
    loop.run(1.0 - moment.time)
    assert world.time == pytest.approx(1.0)
    assert world.arm("PSM1").measured_js().position.tolist() == first.tolist()


def test_moments_are_a_tenth_of_a_second_apart_and_a_minute_at_most() -> None:
    _, loop, timeline = made()
    loop.run(SPAN_S + 2.0)
    times = np.array([moment.time for moment in timeline.moments])
    assert np.diff(times) == pytest.approx(np.full(len(times) - 1, PERIOD_S))
    assert times[-1] - times[0] == pytest.approx(SPAN_S)


def test_a_branch_forgets_what_came_after_its_moment() -> None:
    _, loop, timeline = made()
    loop.run(1.0)
    moment = timeline.at(0.4)
    assert moment is not None
    loop.post(Command(WORLD, "load", {"state": moment.state}))
    loop.run(loop.tick_s)
    assert [m.time for m in timeline.moments if m.time > moment.time] == []
    loop.run(0.3)
    assert timeline.moments[-1].time == pytest.approx(moment.time + 0.3)


def test_a_reset_forgets_everything() -> None:
    _, loop, timeline = made()
    loop.run(1.0)
    loop.post(Command(WORLD, "reset"))
    loop.run(0.02)
    assert all(moment.time <= 0.02 for moment in timeline.moments)


def test_keeping_moments_changes_no_motion() -> None:
    ends: list[list[float]] = []
    for watched in (True, False):
        world = World("psm")
        loop = Loop(world, speed="max")
        if watched:
            loop.watch(Timeline(world, loop.tick_s))
        loop.post(Command("PSM1", "move_jp", {"q": (0.4, -0.2, 0.15, 0.5, 0.2, 0.1)}))
        loop.run(0.7)
        ends.append(world.arm("PSM1").measured_js().position.tolist())
    assert ends[0] == ends[1]
