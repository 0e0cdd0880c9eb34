"""Laws of the operating state, as a client sees them, whatever it sends in whichever order."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.ros.asking import HOME, NEAR, joints, setpoints, state
from tests.ros.served import Served, stamp_ns

COMMANDS = ("enable", "disable", "home", "unhome", "pause", "resume")
OTHER = {
    "move": ("PSM1/move_jp", joints(*NEAR)),
    "back": ("PSM1/move_jp", joints(*HOME)),
    "servo": ("PSM1/servo_jp", joints(0.05, *HOME[1:])),
    "jaw": ("PSM1/jaw/move_jp", joints(0.5)),
    "hold": ("PSM1/hold", {}),
    "free": ("PSM1/free", {}),
    "slow": ("PSM1/trajectory_j/set_ratio", {"data": 0.5}),
    "rubbish": ("PSM1/move_jp", joints(1.0)),
}
#: (from, to) of the operating state alone. Source: collaborative-robotics documentation, robot
#: operating states.
STEPS = {
    ("DISABLED", "ENABLED"), ("ENABLED", "DISABLED"), ("ENABLED", "PAUSED"),
    ("PAUSED", "ENABLED"), ("PAUSED", "DISABLED"), ("ENABLED", "FAULT"),
    ("FAULT", "DISABLED"),
}  # fmt: skip
POWERED = {"ENABLED", "PAUSED"}
asked = st.lists(
    st.tuples(st.sampled_from([*COMMANDS, *COMMANDS, *OTHER]), st.integers(0, 40)), max_size=14
)


def send(served: Served, name: str) -> None:
    topic, message = OTHER.get(name, ("PSM1/state_command", state(name)))
    served.core.receive(topic, message)


def check_still(served: Served, ticks: int) -> None:
    """Run, and check that set-points move only while the arm may move."""
    arm = served.world.arm("PSM1")
    for _ in range(ticks):
        before, was = setpoints(served), arm.operating_state()
        served.run()
        now = arm.operating_state()
        may = any(s.state == "ENABLED" and (s.is_homed or s.is_busy) for s in (was, now))
        if not may:  # power on and off take set-points to where joints are, which sag a little
            switched = (was.state in POWERED) != (now.state in POWERED)
            wanted = arm.measured_js().position if switched else before
            np.testing.assert_allclose(setpoints(served), wanted, atol=2e-3)


@settings(max_examples=5, deadline=None)
@example([("servo", 0), ("unhome", 1), ("disable", 1)], True)
@example([("servo", 0), ("unhome", 2)], True)
@given(asked, st.booleans())
def test_states_follow_from_each_other_and_nothing_moves_in_between(commands, homed):
    served = Served(wanted=(), world={"homed": homed})
    for name, ticks in commands:
        send(served, name)
        check_still(served, ticks)
    served.run(5.0)  # longer than homing and every move that may wait
    told = served.messages("PSM1/operating_state")
    stamps = [stamp_ns(m) for m in told]
    assert stamps == sorted(set(stamps))
    for last, m in pairwise(told):
        assert last["state"] == m["state"] or (last["state"], m["state"]) in STEPS
        if m["state"] == "ENABLED" and m["is_homed"] and not last["is_homed"]:
            assert m["is_busy"] or last["state"] == "PAUSED", "a homing makes an arm homed"
    assert not told[-1]["is_busy"], "what is asked for ends"
    assert served.loop.held == frozenset()


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(st.lists(st.sampled_from(["enable", "home", "move", "back", "jaw", "slow"]), max_size=3))
def test_a_burst_does_the_same_as_the_same_commands_one_after_the_other(names):
    ends: list[np.ndarray] = []
    for wait in (0.0, 2.0):
        served = Served(wanted=(), world={"homed": False})
        for name in (*names, "home", "back", "slow", "move"):
            send(served, name)
            served.run(wait)
        served.run(4.0)
        ends.append(setpoints(served))
        ratio = served.world.arm("PSM1").joints.trajectory_ratio
        assert ratio == (0.5, 0.5)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
