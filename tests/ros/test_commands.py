"""What clients ask for happens, in their order, and the states tell of it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.asking import HOME, NEAR, joints, setpoints, state
from tests.ros.served import Served, stamp_ns
from trocar.simulation.journal import Entry
from trocar.simulation.rate_limit import BURST


def off(**world) -> Served:
    """Return a PSM as after power-on, and not at home."""
    served = Served(wanted=(), world={"homed": False, **world})
    served.world.set_state("PSM1", np.array([0.4, 0.2, 0.1, 0.0, 0.0, 0.0, 0.0]))
    return served


def transitions(served: Served, prefix: str = "PSM1") -> list[tuple[str, bool, bool]]:
    """Return the operating states that were told, each once, and check their stamps."""
    told = served.messages(f"{prefix}/operating_state")
    stamps = [stamp_ns(m) for m in told]
    assert stamps == sorted(set(stamps))
    seen: list[tuple[str, bool, bool]] = []
    for m in told:
        now = m["state"], m["is_homed"], m["is_busy"]
        if not seen or seen[-1] != now:
            seen.append(now)
    return seen


def test_enable_home_and_move_in_one_burst_are_all_obeyed_in_order():
    served = off()
    for name, message in (
        ("state_command", state("enable")),
        ("state_command", state("home")),
        ("move_jp", joints(*NEAR)),
        ("jaw/move_jp", joints(0.5)),
    ):
        assert served.core.receive(f"PSM1/{name}", message)
    served.run(8.0)
    np.testing.assert_allclose(setpoints(served), NEAR, atol=1e-9)
    jaw = served.world.arm("PSM1").jaw
    assert jaw is not None
    assert jaw.setpoint_js().position[0] == pytest.approx(0.5)
    assert served.messages("PSM1/warning") == []
    assert transitions(served) == [
        ("ENABLED", False, False),
        ("ENABLED", True, True),  # on the way home, and the move that waited keeps it busy
        ("ENABLED", True, False),
    ]


def test_what_waits_for_the_homing_keeps_its_order():
    served = off()
    arm = served.world.arm("PSM1")
    done: list[str] = []
    served.world.listen(lambda e: done.append(e.name) if e.kind == "command" else None)
    slow = {"data": 0.5}
    for name, message in (
        ("state_command", state("enable")),
        ("state_command", state("home")),
        ("trajectory_j/set_ratio", slow),
        ("move_jp", joints(*NEAR)),
        ("hold", {}),
        ("state_command", state("home")),
        ("move_jp", joints(*HOME)),
    ):
        assert served.core.receive(f"PSM1/{name}", message)
    served.run(8.0)
    assert done == ["enable", "home", "set_trajectory_ratio", "move_jp", "hold", "home", "move_jp"]
    assert arm.operating_state().ready


@pytest.mark.parametrize("topic", ["PSM1/state_command", "system/home"])
def test_an_arm_that_is_home_stays_where_it_is_when_asked_for_home_as_on_the_hardware(topic):
    served = Served(wanted=())
    served.core.receive("PSM1/move_jp", joints(*NEAR))
    served.run(0.2)
    on_the_way = setpoints(served)
    served.core.receive(topic, state("home") if topic.startswith("PSM1") else {})
    served.run(8.0)
    np.testing.assert_allclose(setpoints(served), NEAR, atol=1e-9)  # nor does it end a move
    assert not np.allclose(on_the_way, NEAR, atol=1e-3)
    assert transitions(served)[-1] == ("ENABLED", True, False)
    assert served.messages("PSM1/warning") == []


def test_a_home_that_changes_nothing_is_never_busy_so_that_no_client_takes_it_for_its_next_move():
    served = Served(wanted=())
    served.core.receive("PSM1/state_command", state("home"))
    served.run(0.01)
    served.core.receive("PSM1/move_jp", joints(*NEAR))
    served.run(8.0)
    assert transitions(served) == [
        ("ENABLED", True, False),
        ("ENABLED", True, True),  # the move
        ("ENABLED", True, False),
    ]


@pytest.mark.parametrize("stop", ["disable", "pause"])
def test_disable_and_pause_do_not_wait(stop):
    served = off()
    for name, message in (
        ("state_command", state("enable")),
        ("state_command", state("home")),
        ("move_jp", joints(*NEAR)),
    ):
        assert served.core.receive(f"PSM1/{name}", message)
    served.run(0.1)
    assert served.core.receive("PSM1/state_command", state(stop))
    served.run(0.01)
    where = setpoints(served)
    served.run(0.5)
    np.testing.assert_array_equal(setpoints(served), where)
    assert len(served.messages("PSM1/warning")) == 1  # of the move that came to nothing
    last = served.last("PSM1/operating_state")
    assert (last["is_homed"], last["is_busy"]) == (True, False)


def test_at_most_64_commands_wait_for_an_arm_and_the_rest_is_told():
    served = off()
    served.core.receive("PSM1/state_command", state("enable"))
    served.core.receive("PSM1/state_command", state("home"))
    for _ in range(4):
        for _ in range(50):
            served.core.receive("PSM1/move_jp", joints(*NEAR))
        served.run()
    served.run(0.1)
    assert served.core.refused == 200 - 64
    assert len(served.messages("PSM1/warning")) == BURST


def test_a_burst_that_no_tick_can_hold_is_refused_at_the_door():
    served = Served(wanted=())
    accepted = [served.core.receive("PSM1/move_jp", joints(*NEAR)) for _ in range(100)]
    assert accepted == [True] * 64 + [False] * 36
    served.run(0.01)
    assert "too many pending commands" in served.messages("PSM1/warning")[0]["data"]
    assert served.core.receive("PSM1/move_jp", joints(*NEAR))


def test_a_flood_for_one_arm_keeps_nobody_from_another():
    served = Served("two_psm_ecm", wanted=())
    for _ in range(100):
        served.core.receive("PSM1/move_jp", joints(*NEAR))
    assert served.core.receive("PSM2/move_jp", joints(*NEAR))


def test_of_set_points_the_newest_counts():
    served = Served(wanted=())
    for k in range(500):
        assert served.core.receive("PSM1/servo_jp", joints(1e-4 * k, *HOME[1:]))
    served.run()
    assert setpoints(served)[0] == pytest.approx(1e-4 * 499)


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("move_jp", joints(*HOME)),
        ("move_jr", joints(*[0.0] * 6)),
        ("jaw/move_jp", joints(0.3)),
        ("move_jp", joints(*NEAR)),
    ],
)
def test_every_move_makes_the_arm_busy_and_then_not(topic, message):
    served = Served(wanted=())
    served.core.receive("PSM1/move_jp", joints(*HOME))
    served.core.receive("PSM1/jaw/move_jp", joints(0.0))
    served.run(3.0)
    before = len(served.messages("PSM1/operating_state"))
    assert served.core.receive(f"PSM1/{topic}", message)
    served.run(3.0)
    told = served.messages("PSM1/operating_state")[before - 1 :]
    busy = [m["is_busy"] for m in told if not m["is_busy"] or m is told[1]]
    assert told[1]["is_busy"]
    assert not busy[-1]
    stamps = [stamp_ns(m) for m in told]
    assert stamps == sorted(set(stamps))


def test_a_move_for_an_arm_that_is_busy_is_told_too():
    served = Served(wanted=())
    served.core.receive("PSM1/move_jp", joints(*NEAR))
    served.run(0.1)
    before = len(served.messages("PSM1/operating_state"))
    served.core.receive("PSM1/move_jp", joints(*HOME))
    served.run(0.01)
    assert [m["is_busy"] for m in served.messages("PSM1/operating_state")[before:]] == [True]


def test_a_move_that_begins_and_ends_between_two_samples_is_told_too():
    served = Served(wanted=(), rate_hz=1.0)
    served.run(0.1)
    served.core.receive("PSM1/move_jp", joints(0.01, *HOME[1:]))
    served.run(0.05)
    served.core.receive("PSM1/jaw/move_jp", joints(0.0))
    served.run(2.0)
    told = [m["is_busy"] for m in served.messages("PSM1/operating_state")]
    assert told.count(True) == 2
    assert not told[-1]


def test_a_reset_drops_what_waits():
    served = off()
    served.core.receive("PSM1/state_command", state("enable"))
    served.core.receive("PSM1/state_command", state("home"))
    served.core.receive("PSM1/move_jp", joints(*NEAR))
    served.run(0.2)
    served.world.reset()
    served.run(1.0)
    assert "dropped" in served.messages("PSM1/warning")[0]["data"]
    assert served.last("PSM1/operating_state")["state"] == "DISABLED"
    assert not served.last("PSM1/operating_state")["is_busy"]


def test_the_whole_system_is_switched_and_homed_at_once():
    served = Served("two_psm_ecm", wanted=(), world={"homed": False})
    for verb in ("power_on", "home"):
        assert served.core.receive(f"system/{verb}", {})
    served.run(6.0)
    assert all(arm.operating_state().ready for arm in served.world.arms.values())
    assert served.core.receive("system/power_off", {})
    served.run(0.01)
    assert {a.operating_state().state for a in served.world.arms.values()} == {"DISABLED"}


def test_a_flood_that_can_be_obeyed_is_obeyed_in_its_order_and_does_not_stop_time():
    served = Served("two_psm_ecm", wanted=())
    done: list[tuple[str, float]] = []

    def slow(entry: Entry) -> None:
        if entry.kind == "command":
            served.clock.time += 0.002  # as long as the kinematics of a pose may take
            done.append((entry.source, entry.values.get("q", [0.0])[0]))

    served.world.listen(slow)
    for k in range(20):
        served.core.receive("PSM1/move_jp", joints(1e-3 * k, *HOME[1:]))
        served.core.receive("PSM2/move_jp", joints(1e-3 * k, *HOME[1:]))
    for ticks in range(1, 11):
        served.run()
        assert len(done) <= 1 + ticks / 3  # each takes four ticks' time
    served.run(0.25)
    for arm in ("PSM1", "PSM2"):
        assert [q for name, q in done if name == arm] == [1e-3 * k for k in range(20)]
    served.core.receive("PSM1/move_jp", joints(*NEAR))
    served.core.receive("PSM1/state_command", state("disable"))
    served.run()
    assert served.world.arm("PSM1").operating_state().state == "DISABLED"
