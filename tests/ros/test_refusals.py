"""What cannot be used is refused with its reason, and nothing changes."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.asking import HOME, joints, pose, quaternion, setpoints, stamped, state, wrench, xyz
from tests.ros.served import Served
from trocar.ros.clock import StampCheck
from trocar.ros.core import topic_table

NAN = float("nan")
FAR = [0.3, *HOME[1:]]
GAINS = {name: xyz(0.0, 0.0, 0.0) for name in ("p", "d", "bias", "deadband")}
IMPEDANCE = {
    "force_position": xyz(0.0, 0.0, 0.0),
    "force_orientation": quaternion(),
    "torque_orientation": quaternion(w=0.0),
    **{
        f"{part}_{side}": GAINS
        for part in ("position", "orientation")
        for side in ("positive", "negative")
    },
}


def cartesian(pose_valid: bool, wrench_valid: bool) -> dict:
    return {
        **pose(xyz(0.0, 0.0, -0.1)),
        **wrench(xyz(0.0, 0.0, 1.0)),
        "pose_is_valid": {"data": pose_valid},
        "twist_is_valid": {"data": False},
        "wrench_is_valid": {"data": wrench_valid},
    }


BAD = [
    ("servo_jp", joints(0.1, 0.1), "got 2 numbers in position; allowed: 6, for yaw"),
    ("servo_jp", joints(*FAR[:5], NAN), "allowed: finite"),
    ("servo_jp", joints(*FAR, velocity=(0.0,)), "numbers in velocity"),
    ("servo_jp", joints(*FAR, velocity=(1e308,) * 6), "allowed: finite, magnitude up to"),
    ("servo_jr", {}, "position is missing"),
    ("servo_jf", joints(*FAR), "got 0 numbers in effort"),
    ("servo_cp", pose(xyz(0.0, 0.0, -0.1), quaternion(w=0.0)), "of norm 0; allowed: above 0"),
    ("servo_cp", pose(xyz(0.0, NAN, -0.1)), "pose.position.y nan"),
    ("servo_cr", {"pose": None}, "is missing"),
    ("servo_cs", cartesian(True, True), "allowed: one of them"),
    ("servo_cs", cartesian(False, False), "allowed: one of them"),
    ("servo_ci", IMPEDANCE, "torque_orientation of norm 0"),
    ("body/servo_cf", wrench(xyz(0.0, 0.0, NAN)), "wrench.force.z nan"),
    ("spatial/servo_cf", {}, "is missing"),
    ("move_jp", joints(*FAR, NAN), r"position[6] nan"),
    ("move_cp", {"pose": pose(xyz(0.0, 0.0, 0.0))}, "pose.orientation is missing"),
    ("state_command", state("fly"), "allowed: enable, disable, home, unhome, pause, resume"),
    ("state_command", {"string": 3}, "allowed: a string"),
    ("trajectory_j/set_ratio", {"data": 0.0}, "allowed: above 0, up to 1"),
    ("trajectory_j/set_ratio_v", {"data": 2.0}, "allowed: above 0, up to 1"),
    ("use_gravity_compensation", {"data": 1}, "allowed: true or false"),
    ("set_base_frame", pose(xyz(0.0, 0.0, 0.0), quaternion(w=0.0)), "of norm 0"),
    ("set_base_frame", pose(xyz(0.0, 0.0, 0.0), frame_id="x" * 300), "up to 256"),
    ("jaw/move_jp", joints(NAN), r"position[0] nan"),
    ("jaw/servo_jp", joints(), "got 0 numbers in position; allowed: 1, for jaw"),
    ("jaw/servo_jf", joints(0.1), "got 0 numbers in effort"),
    ("emulate_tool_present", {"data": "no"}, "allowed: true or false"),
]


@pytest.fixture(scope="module")
def served() -> Served:
    return Served(wanted=())


@pytest.mark.parametrize(("topic", "message", "reason"), BAD)
def test_a_bad_message_moves_nothing_and_is_reported_of_streams_once(
    served, topic, message, reason
):
    served.transport.received.clear()
    served.clock.time += 10.0  # the same reason is told again after a while
    before, base = setpoints(served), served.world.arm("PSM1").local.base_frame()[0]
    for _ in range(3):
        assert not served.core.receive(f"PSM1/{topic}", message)
    served.run(0.02)
    np.testing.assert_array_equal(setpoints(served), before)
    np.testing.assert_array_equal(served.world.arm("PSM1").local.base_frame()[0], base)
    warnings = [warning["data"] for warning in served.messages("PSM1/warning")]
    assert len(warnings) == (1 if "servo_" in topic else 3)
    assert all(reason in warning and topic in warning for warning in warnings)


def test_a_stamp_that_goes_back_is_refused_until_the_stream_was_silent():
    served = Served(wanted=())
    send = served.core.receive
    assert send("PSM1/servo_jp", stamped(joints(*HOME), (10, 0)), "a")
    assert send("PSM1/servo_jp", stamped(joints(*HOME), (10, 0)), "a")
    assert not send("PSM1/servo_jp", stamped(joints(*FAR), (9, 999_999_999)), "a")
    assert send("PSM1/servo_jp", stamped(joints(*HOME), (0, 0)), "a")  # says nothing of its time
    assert send("PSM1/servo_jp", stamped(joints(*HOME), (5, 0)), "b")  # somebody else's clock
    assert send("PSM1/move_jp", stamped(joints(*HOME), (5, 0)), "a")  # another topic
    served.run(0.02)
    np.testing.assert_allclose(setpoints(served), HOME)
    older, shared = (warning["data"] for warning in served.messages("PSM1/warning"))
    assert "older than" in older and shared.startswith("PSM1: b commands PSM1 beside a")
    served.clock.time += 10.0
    assert send("PSM1/servo_jp", stamped(joints(*FAR), (1, 0)), "a")


def test_a_client_whose_clock_is_set_back_an_hour_commands_again_within_three_seconds():
    served = Served(wanted=())
    send = served.core.receive
    assert send("PSM1/servo_jp", stamped(joints(*HOME), (7200, 0)), "a")
    accepted = []
    for k in range(60):  # it goes on at 20 Hz
        served.clock.time += 0.05
        accepted.append(send("PSM1/servo_jp", stamped(joints(*FAR), (3600 + k, 0)), "a"))
    assert not accepted[0] and not accepted[19]  # a second is no silence
    assert accepted[-1]


@pytest.mark.parametrize("stamp", [(-1, 0), (1.5, 0), "now", (1,), (10**30, True)])
def test_a_stamp_that_is_no_time_is_refused(stamp):
    served = Served(wanted=())
    assert not served.core.receive("PSM1/servo_jp", stamped(joints(*HOME), stamp))


def test_the_memory_of_streams_is_bounded():
    stamps = StampCheck()
    for k in range(3000):
        stamps.remember(("PSM1/servo_jp", f"peer {k}"), (k + 1, 0), 0.0)
    assert len(stamps) == 1024


def test_an_arm_that_is_not_ready_says_so_once():
    served = Served(wanted=(), world={"homed": False})
    before = setpoints(served)
    for _ in range(100):
        served.core.receive("PSM1/servo_jp", joints(*FAR))
        served.run()
    np.testing.assert_array_equal(setpoints(served), before)
    (warning,) = served.messages("PSM1/warning")
    assert "enable and home it first" in warning["data"]


@pytest.mark.parametrize("rig", ["full_cart_mtm", "psm"])
def test_every_topic_that_the_simulator_listens_to_is_obeyed(rig):
    from trocar.descriptions import load_rig

    rows = [t for t in topic_table(load_rig(rig)) if not t.later]
    assert {t.name for t in rows if t.direction == "sub" and t.read is None} == set()
    made = {t.name for t in rows if t.rate in ("state", "tf", "statistics")}
    assert {t.name for t in rows if t.make is not None} == made
