"""Parts of a world act when they are due, and cost nothing in between."""

from __future__ import annotations

import gc
import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trocar.descriptions import load_rig
from trocar.simulation import World
from trocar.simulation.schedule import Schedule, ScheduleEntry

CHUNKS = st.lists(st.integers(1, 40), min_size=1, max_size=12)


class Stepped:
    """Steps as a world does, and notes who acts when."""

    def __init__(self, periods: list[int]) -> None:
        self.count, self.seen = 0, list[tuple[str, int, int]]()
        self.schedule = Schedule(
            ScheduleEntry(every, self.note("before", k), self.note("look", k))
            for k, every in enumerate(periods)
        )

    def note(self, what: str, k: int) -> Any:
        return lambda: self.seen.append((what, k, self.count))

    def step(self, steps: int) -> None:
        end = self.count + steps
        while self.count < end:
            schedule = self.schedule
            due, schedule.due = schedule.due, ()
            for act in due:
                act()
            self.count += min(end - self.count, schedule.next - self.count)
            if self.count == schedule.next:
                looks, schedule.due, gap = schedule.phases[self.count % schedule.cycle]
                for look in looks:
                    look()
                schedule.next = self.count + gap


@given(periods=st.lists(st.integers(1, 12), min_size=1, max_size=4), chunks=CHUNKS)
def test_each_part_acts_at_its_multiples_however_steps_are_grouped(
    periods: list[int], chunks: list[int]
) -> None:
    stepped, total = Stepped(periods), sum(chunks)
    for chunk in chunks:
        stepped.step(chunk)
    for k, every in enumerate(periods):
        assert [n for what, j, n in stepped.seen if (what, j) == ("before", k)] == list(
            range(0, total, every)
        )
        assert [n for what, j, n in stepped.seen if (what, j) == ("look", k)] == list(
            range(every, total + 1, every)
        )


@given(periods=st.lists(st.integers(1, 6), min_size=2, max_size=4))
def test_parts_that_are_due_together_act_in_their_order(periods: list[int]) -> None:
    stepped = Stepped(periods)
    stepped.step(30)
    for what in ("before", "look"):
        for n in range(31):
            order = [k for w, k, m in stepped.seen if (w, m) == (what, n)]
            assert order == sorted(order)


def test_going_on_from_a_step_does_there_what_was_not_done_yet() -> None:
    stepped = Stepped([4])
    stepped.step(4)
    seen = list(stepped.seen)
    stepped.schedule.seek(4)  # as after a saved state was loaded
    stepped.step(1)
    assert stepped.seen[len(seen) :] == [("before", 0, 4)]


def calls_of(world: World, steps: int) -> Counter[str]:
    """Return which functions of Python so many calls of step(1) enter, and how often."""
    found = Counter[str]()

    def enter(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            found[frame.f_code.co_qualname] += 1

    before = sys.getprofile()
    gc.disable()  # a collection would call what others hang on to it
    sys.setprofile(enter)
    try:
        for _ in range(steps):
            world.step(1)
    finally:
        sys.setprofile(before)
        gc.enable()
    found.pop("calls_of", None)
    return found


def test_a_step_between_the_acts_enters_nothing_but_itself() -> None:
    world = World("full_cart")
    world.step(21)
    assert calls_of(world, 8) == {"World.step": 8}


def test_what_acts_enters_a_step_at_its_period_only() -> None:
    world = World("psm")
    world.step(1)
    found = calls_of(world, 400)
    assert found["World.step"] == 400
    assert found["Supervision.before_step"] == found["Supervision.balance"] == 20
    assert found["Drives.renew"] == 40
    assert found["ArmRuntime.follow"] == 0
    world.arm("PSM1").move_jp([0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert calls_of(world, 50)["ArmRuntime.follow"] == 50


def test_arms_are_looked_over_after_commands_alone() -> None:
    world = World("two_psm_ecm")
    world.step(1)
    assert calls_of(world, 100)["World._attend"] == 0
    world.arm("PSM1").servo_jp(world.arm("PSM1").joints.setpoints()[:6])
    assert calls_of(world, 100)["World._attend"] == 1


@pytest.mark.parametrize("errors", [None, "lab"])
def test_a_script_that_moves_an_arm_moves_it_alike_however_steps_are_grouped(
    errors: str | None, tmp_path: Path
) -> None:
    (tmp_path / "script.py").write_text(
        "def before_step(thing, world):\n"
        "    if world.periods == 7:\n"
        "        world.arm('ECM').move_jp([0.1, 0.1, 0.05, 0.1])\n"
    )
    thing = (
        '\n[[prop]]\nname = "thing"\nmovable = true\nmass_g = 4\nxyz_m = [2, 2, 2]\n'
        'before_step = "script.py"\n'
        'shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 10 }]\n'
    )
    rig = tmp_path / "scripted.toml"
    rig.write_text(Path(load_rig("ecm").file).read_text(encoding="utf-8") + thing)
    found: set[bytes] = set()
    for chunks in ([100], [1] * 100, [3, 40, 57]):
        world = World(rig, errors=errors)
        for chunk in chunks:
            world.step(chunk)
        assert world.arm("ECM").joints.setpoints()[0] > 0.002
        found.add(world.save().row.tobytes())
    assert len(found) == 1
