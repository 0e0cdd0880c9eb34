"""A world enters its commands into a journal, and the same commands make the same motion."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.simulation import World
from trocar.simulation.journal import Entry, apply_command


def entries_of(world: World) -> list[Entry]:
    entries: list[Entry] = []
    world.listen(entries.append)
    return entries


def test_every_verb_is_one_command_however_many_it_uses_itself():
    world = World("psm")
    entries = entries_of(world)
    arm = world.arm("PSM1")
    arm.move_to("home")
    assert arm.jaw is not None
    arm.jaw.open()
    arm.joints.set_mode("effort", ["yaw"])
    assert [(e.source, e.name) for e in entries if e.kind == "command"] == [
        ("PSM1", "move_to"),
        ("PSM1", "jaw.open"),
        ("PSM1", "set_mode"),
    ]


def test_a_command_keeps_copies_of_its_arguments_and_when_it_came():
    world = World("psm")
    entries = entries_of(world)
    world.step(7)
    goal = world.arm("PSM1").measured_js().position
    expected = goal.copy()
    world.arm("PSM1").servo_jp(goal)
    goal[:] = 9.0
    assert entries[0].period == 7
    assert entries[0].time == world.time
    np.testing.assert_array_equal(entries[0].values["q"], expected)


def test_a_warning_is_an_event_with_its_text():
    world = World("psm")
    entries = entries_of(world)
    world.arm("PSM1").servo_jp([np.nan] * 6)
    (warning,) = [e for e in entries if e.kind == "event"]
    assert warning.name == "warning"
    assert "finite" in warning.values["text"]


def test_who_stops_listening_hears_nothing_more():
    world = World("psm")
    entries: list[Entry] = []
    stop = world.listen(entries.append)
    stop()
    stop()
    world.arm("PSM1").hold()
    assert entries == []


def test_the_same_commands_before_the_same_periods_make_bit_identical_motion():
    first = World("psm")
    entries = entries_of(first)
    arm = first.arm("PSM1")
    arm.move_jp([0.3, -0.2, 0.14, 0.5, 0.1, 0.2])
    first.step(37)
    assert arm.jaw is not None
    arm.jaw.open()
    first.step(111)
    arm.joints.set_gains("yaw", p=80.0)
    arm.servo_jp([0.1, 0.0, 0.12, 0.0, 0.0, 0.0])
    first.step(50)
    table = np.tile([0.1, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0], (10, 1))
    first.play({"PSM1": table}, every=5)
    first.step(20)

    second = World("psm")
    for entry in (e for e in entries if e.kind == "command"):
        while second.periods < entry.period:
            second.step(1)
        apply_command(second, entry)
    second.step(first.periods - second.periods)
    np.testing.assert_array_equal(second.mj_data.qpos, first.mj_data.qpos)
    np.testing.assert_array_equal(second.mj_data.qvel, first.mj_data.qvel)


def streamed(by_verbs: bool) -> World:
    world = World("psm")
    arm = world.arm("PSM1")
    assert arm.jaw is not None
    for k in range(20):
        q, v = (arm.joints.setpoints() + 0.002 * k).tolist(), [0.2] * 7
        own = slice(6) if k % 3 == 2 else slice(7)  # the jaw rests in every third row
        q, v = q[own], v[own]
        if by_verbs or not arm.runtime.control.stream(q, v):
            arm.servo_jp(np.array(q[:6]), np.array(v[:6]))
            if len(q) > 6:
                arm.jaw.servo_jp(np.array(q[6:]), np.array(v[6:]))
        q[0] = v[0] = 9.0  # what is kept are copies
        world.step(10)
    return world


def test_a_row_of_set_points_is_those_of_the_arm_and_of_its_jaw():
    one, other = streamed(by_verbs=False), streamed(by_verbs=True)
    np.testing.assert_array_equal(one.mj_data.qpos, other.mj_data.qpos)
    np.testing.assert_array_equal(one.mj_data.ctrl, other.mj_data.ctrl)
    kept, expected = one.past.entries, other.past.entries
    assert [(e.period, e.source, e.name) for e in kept] == [
        (e.period, e.source, e.name) for e in expected
    ]
    for mine, its in zip(kept[1:], expected[1:], strict=True):
        np.testing.assert_array_equal(mine.values["q"], its.values["q"])
        np.testing.assert_array_equal(mine.values["v"], its.values["v"])


@pytest.mark.parametrize("why", ["beyond", "listened", "moving", "nan", "paused", "effort"])
def test_a_row_that_verbs_must_look_at_changes_nothing(why: str):
    world = World("psm")
    arm = world.arm("PSM1")
    q, v = arm.joints.setpoints(), [0.0] * 7
    assert arm.runtime.control.stream(q.tolist(), v)
    if why == "beyond":
        q[0] = 2.0 * arm.joints.upper[0]
    elif why == "nan":
        q[6] = np.nan
    elif why == "listened":
        entries_of(world)
    elif why == "moving":
        arm.move_jp(q[:6] + 0.1)
    elif why == "effort":
        arm.servo_jf(np.zeros(6))
    else:
        arm.state_command("pause")
    before, kept = world.mj_data.ctrl.copy(), len(world.past.entries)
    assert not arm.runtime.control.stream((q + 1e-3).tolist(), v)
    np.testing.assert_array_equal(world.mj_data.ctrl, before)
    assert len(world.past.entries) == kept


@pytest.mark.parametrize("name", ["measured_js", "motors.place", "nothing", "jaw._control.put"])
def test_only_verbs_can_be_repeated(name):
    world = World("psm")
    with pytest.raises(InputError, match="does not have"):
        apply_command(world, Entry(0, 0.0, "command", "PSM1", name, {}))
