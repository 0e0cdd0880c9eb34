"""Each topic of an arm is one verb of the arm, with the numbers that were sent."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.asking import HOME, joints, quaternion, state, wrench, xyz
from tests.ros.served import Served
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform
from trocar.ros import message_builders as build
from trocar.ros.arm_topics import EVERY, EXTRA, MOVERS
from trocar.simulation.controllers import CartesianImpedance
from trocar.simulation.journal import Entry

Q = [0.05, 0.02, 0.13, 0.1, 0.05, 0.05]
T = transform(rotation_z(0.3), [0.01, -0.02, -0.1])
POSE = {"header": build.header((0, 0), "table"), "pose": build.pose(T)}
WRENCH = [0.1, 0.2, 0.3, 0.01, 0.02, 0.03]
PUSH = wrench(xyz(*WRENCH[:3]), xyz(*WRENCH[3:]))
VALID = {"pose_is_valid": {"data": True}, "twist_is_valid": {"data": True}}
SIDES = ("position_positive", "position_negative", "orientation_positive", "orientation_negative")
SPRING = {
    "force_position": xyz(0.1, 0.2, 0.3),
    "force_orientation": quaternion(),
    "torque_orientation": build.quaternion(T),
    **{
        side: {
            "p": xyz(-k, -k, -k),
            "d": xyz(-1.0, -1.0, -1.0),
            "bias": xyz(0.0, 0.0, float(k)),
            "deadband": xyz(0.0, 0.0, 0.0),
        }
        for k, side in enumerate(SIDES, 1)
    },
}

#: (topic, message, verb, its arguments)
VERBS = [
    ("servo_jp", joints(*Q), "servo_jp", {"q": Q}),
    ("servo_jp", joints(*Q, velocity=Q), "servo_jp", {"q": Q, "v": Q}),
    ("servo_jr", joints(*Q), "servo_jr", {"dq": Q}),
    ("servo_jv", joints(velocity=Q), "servo_jv", {"v": Q}),
    ("servo_jf", joints(effort=Q), "servo_jf", {"effort": Q}),
    ("move_jp", joints(*Q), "move_jp", {"q": Q}),
    ("move_jr", joints(*Q), "move_jr", {"dq": Q}),
    ("servo_cp", POSE, "servo_cp", {"T": T}),
    ("servo_cr", POSE, "servo_cr", {"T": T}),
    ("move_cp", POSE, "move_cp", {"T": T}),
    (
        "servo_cs",
        {**POSE, **PUSH, **VALID, "wrench_is_valid": {"data": False}},
        "servo_cp",
        {"T": T},
    ),
    (
        "servo_cs",
        {**PUSH, **VALID, "pose_is_valid": {"data": False}, "wrench_is_valid": {"data": True}},
        "servo_cf",
        {"wrench": WRENCH, "frame": "body"},
    ),
    ("body/servo_cf", PUSH, "servo_cf", {"wrench": WRENCH, "frame": "body"}),
    ("spatial/servo_cf", PUSH, "servo_cf", {"wrench": WRENCH, "frame": "spatial"}),
    ("hold", {}, "hold", {}),
    ("free", {}, "free", {}),
    ("use_gravity_compensation", {"data": False}, "use_gravity_compensation", {"on": False}),
    (
        "body/set_cf_orientation_absolute",
        {"data": True},
        "set_cf_orientation_absolute",
        {"on": True},
    ),
    ("trajectory_j/set_ratio", {"data": 0.5}, "set_trajectory_ratio", {"ratio": 0.5, "of": "both"}),
    (
        "trajectory_j/set_ratio_v",
        {"data": 0.5},
        "set_trajectory_ratio",
        {"ratio": 0.5, "of": "velocity"},
    ),
    (
        "trajectory_j/set_ratio_a",
        {"data": 1},
        "set_trajectory_ratio",
        {"ratio": 1.0, "of": "acceleration"},
    ),
    ("set_base_frame", POSE, "set_base_frame", {"T": T, "frame_id": "table"}),
    ("jaw/servo_jp", joints(0.2, name=["jaw"]), "jaw.servo_jp", {"q": [0.2]}),
    ("jaw/move_jp", joints(0.2), "jaw.move_jp", {"q": [0.2]}),
    ("jaw/servo_jf", joints(effort=[0.01]), "jaw.servo_jf", {"effort": [0.01]}),
    *(
        ("state_command", state(name), name, {})
        for name in ("enable", "disable", "home", "unhome", "pause", "resume")
    ),
]


def heard(served: Served, arm: str, topic: str, message: dict) -> Entry:
    """Return the one command that a message was to an arm."""
    entries: list[Entry] = []
    stop = served.world.listen(lambda e: entries.append(e) if e.kind == "command" else None)
    assert served.core.receive(f"{arm}/{topic}", message)
    served.run()
    stop()
    (entry,) = entries
    assert entry.source == arm
    return entry


@pytest.fixture(scope="module")
def served() -> Served:
    return Served(wanted=())


@pytest.mark.parametrize(("topic", "message", "verb", "values"), VERBS)
def test_a_topic_is_a_verb_with_the_numbers_that_were_sent(served, topic, message, verb, values):
    served.world.reset()
    entry = heard(served, "PSM1", topic, message)
    assert entry.name == verb
    assert set(entry.values) == set(values)
    for name, value in values.items():
        if isinstance(value, str):
            assert entry.values[name] == value
        else:
            np.testing.assert_allclose(entry.values[name], value, atol=1e-12)


def test_a_spring_is_told_side_by_side(served):
    served.world.reset()
    entry = heard(served, "PSM1", "servo_ci", SPRING)
    impedance = entry.values["impedance"]
    assert isinstance(impedance, CartesianImpedance)
    np.testing.assert_allclose(impedance.force_position, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(impedance.torque_orientation, T[:3, :3], atol=1e-12)
    for k, side in enumerate(SIDES, 1):
        gains = getattr(impedance, side)
        np.testing.assert_array_equal(gains.p, [-k] * 3)
        np.testing.assert_array_equal(gains.d, [-1.0] * 3)
        np.testing.assert_array_equal(gains.bias, [0.0, 0.0, k])


def test_a_masters_orientation_is_a_verb_too():
    served = Served("mtm", wanted=())
    entry = heard(served, "MTMR", "lock_orientation", build.quaternion(T))
    assert entry.name == "lock_orientation"
    np.testing.assert_allclose(entry.values["R"], T[:3, :3], atol=1e-12)
    assert heard(served, "MTMR", "unlock_orientation", {}).name == "unlock_orientation"


def test_fingers_hold_a_masters_gripper_and_let_it_go():
    served = Served("mtm", wanted=())
    wide = float(served.world.arm("MTML").joints.upper[-1])
    entry = heard(served, "MTML", "gripper/servo_jp", joints(0.3))
    assert (entry.name, entry.values["angle"]) == ("gripper.squeeze_to", 0.3)
    served.run(0.5)
    gripper = served.world.arm("MTML").gripper
    assert gripper is not None
    assert gripper.measured_js().position[0] == pytest.approx(0.3, abs=0.02)
    assert heard(served, "MTML", "gripper/servo_jp", joints(wide)).name == "gripper.release"
    for wrong in (-0.1, wide + 0.1):
        assert not served.core.receive("MTML/gripper/servo_jp", joints(wrong))


def test_every_topic_of_an_arm_is_in_a_test_of_these():
    told = {topic for topic, *_ in VERBS} | {"servo_ci", "gripper/servo_jp"}
    told |= {"lock_orientation", "unlock_orientation"}
    elsewhere = {  # test_console_and_tools.py
        "set_tool_type",
        "emulate_tool_present",
        "emulate_adapter_present",
        "set_endoscope_type",
        "lock_brakes",
    }
    rows = [row for own in (EVERY, MOVERS, *EXTRA.values()) for row in own]
    assert told | elsewhere == {row.key for row in rows if row.read is not None}


def test_a_pose_that_is_read_can_be_sent_back(served):
    served.world.reset()
    arm = served.world.arm("PSM1")
    served.core.receive("PSM1/servo_jp", joints(*HOME))
    served.run(0.2)
    there = {"header": build.header((0, 0)), "pose": build.pose(arm.setpoint_cp().matrix)}
    served.core.receive("PSM1/servo_cp", there)
    served.run()
    np.testing.assert_allclose(arm.setpoint_js().position, HOME, atol=1e-9)
