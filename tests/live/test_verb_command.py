"""Any verb can be posted; set-points supersede each other, moves and states keep their order."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.live import Command, Loop
from trocar.live.inbox import Inbox
from trocar.simulation import World
from trocar.viewer.panel import state_line


def test_a_posted_verb_reaches_the_arm_at_the_next_tick():
    world = World("psm", homed=False)
    loop = Loop(world, speed="max")
    for verb in ("enable", "home"):
        assert loop.post(Command("PSM1", verb))
    loop.tick()
    assert world.arm("PSM1").operating_state().state == "ENABLED"
    for _ in range(200):
        loop.tick()
    assert world.arm("PSM1").operating_state().ready
    goal = {"q": np.array([0.1, 0.0, 0.12, 0.0, 0.0, 0.0])}
    loop.post(Command("PSM1", "move_jp", goal))
    loop.post(Command("PSM1", "jaw.open"))
    loop.tick()
    assert world.arm("PSM1").operating_state().is_busy


@pytest.mark.parametrize("name", ["fly", "measured_js", "_stop", "jaw.fly"])
def test_what_is_no_verb_is_an_error(name):
    with pytest.raises(InputError, match="does not have"):
        Command("PSM1", name).apply(World("psm"))


def test_of_set_points_the_newest_counts_of_relative_ones_too_as_on_the_robot():
    inbox = Inbox()
    first, second = (
        Command("PSM1", "servo_cp", {"T": 1}),
        Command("PSM1", "servo_jf", {"effort": 2}),
    )
    move, jaw = Command("PSM1", "move_jp", {"q": 3}), Command("PSM1", "jaw.servo_jp", {"q": 4})
    steps = [Command("PSM1", "servo_jr", {"dq": k}) for k in range(3)]
    for command in (first, move, Command("PSM1", "servo_jp", {"q": (0.0,)}), second, jaw, *steps):
        inbox.post(command)
    assert inbox.drain() == [move, second, jaw, steps[-1]]


def test_moves_and_states_are_bounded():
    inbox = Inbox(capacity=2)
    assert inbox.post(Command("PSM1", "enable"))
    assert inbox.post(Command("PSM1", "jaw.move_jp", {"q": [0.0]}))
    assert not inbox.post(Command("PSM1", "home"))
    assert inbox.post(Command("PSM1", "servo_jp", {"q": [0.0]}))


def test_the_page_says_the_state_in_words():
    world = World("psm", homed=False)
    assert state_line(world.snapshot().arms["PSM1"]) == "DISABLED, not homed"
    world.arm("PSM1").enable()
    assert state_line(world.snapshot().arms["PSM1"]) == "ENABLED, not homed"
    world.arm("PSM1").home()
    assert state_line(world.snapshot().arms["PSM1"]) == "ENABLED, homed, busy"
    world.arm("PSM1").runtime.states.fault("a test")
    assert state_line(world.snapshot().arms["PSM1"]) == "FAULT, homed"
