"""Ten thousand random messages: no motion without power and homing, and never an exception."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import pytest

from tests.ros.rubbish import leaf, message
from tests.ros.served import Served
from trocar.ros.topic import Topic

COUNT = 10_000
#: A tick for so many messages.
BURST = 10
#: These change joints by other means than motion: another tool, brakes that give way.
OTHERWISE = {"set_tool_type", "emulate_tool_present", "emulate_adapter_present", "lock_brakes"}


@pytest.fixture(autouse=True)
def quiet():
    """Nobody reads thousands of warnings."""
    logging.getLogger("trocar").setLevel(logging.CRITICAL)
    yield
    logging.getLogger("trocar").setLevel(logging.NOTSET)


def flood(served: Served, rng: np.random.Generator, sent: Callable[[Topic, object], bool]) -> int:
    """Send messages that `sent` lets through; return how many were accepted."""
    refuse, reasons = served.core.refuse, set[str]()

    def noted(topic: Topic | None, name: str, reason: str, peer: str = "", kind: str = "") -> None:
        reasons.add(reason)
        refuse(topic, name, reason, peer, kind)

    served.core.refuse = noted
    names = [*served.core.topics, "nobody/servo_jp", "", "../../etc", "PSM1/servo_jp\x00"]
    accepted = left = 0
    while left < COUNT:
        name = names[rng.integers(len(names))]
        topic = served.core.topics.get(name)
        if topic is None or topic.direction == "pub":
            if rng.random() < 0.1:
                assert not served.core.receive(name, leaf(rng))  # type: ignore[arg-type]
                left += 1
            continue
        arm = served.world.arms.get(topic.arm)
        made = message(rng, topic, 0 if arm is None else arm.description.own_joints)
        if not sent(topic, made):
            continue
        peer = str(rng.integers(5000))
        accepted += served.core.receive(name, made, peer)  # type: ignore[arg-type]
        left += 1
        if left % BURST == 0:
            served.run()
    assert "cannot be read" not in reasons  # what the core says of errors that it did not expect
    return accepted


def check_bounds(served: Served) -> None:
    backlog, arms = served.core.backlog, len(served.world.arms)
    assert backlog["stamps"] <= 1024
    assert backlog["events"] <= 1024
    assert backlog["rejections"] <= 1000
    # orders, and the newest set-point of arm, jaw and servo_jr
    assert served.loop.pending <= (64 + 3) * arms + 64


def command(made: object) -> object:
    asked = made.get("string") if isinstance(made, dict) else None
    return asked if isinstance(asked, str) else None


@pytest.mark.parametrize("powered", [False, True])
def test_nothing_moves_without_power_and_homing(powered):
    served = Served("two_psm_ecm", wanted=(), world={"homed": False})
    before = {name: arm.joints.readings()[0] for name, arm in served.world.arms.items()}
    barred = {"home"} if powered else {"home", "enable"}

    def sent(topic: Topic, made: object) -> bool:
        if topic.key in OTHERWISE or topic.key.rpartition("/")[2] in {*barred, "power_on"}:
            return False
        if powered and topic.key == "use_gravity_compensation":
            return False  # without it an arm sags a little
        return command(made) not in barred

    if powered:
        for name in served.world.arms:
            served.core.receive(f"{name}/state_command", {"string": "enable"})
    assert flood(served, np.random.default_rng(int(powered)), sent) > 0.2 * COUNT
    for name, arm in served.world.arms.items():
        np.testing.assert_allclose(arm.joints.readings()[0], before[name], atol=2e-3)
        assert not arm.operating_state().is_homed
    check_bounds(served)


@pytest.mark.parametrize("rig", ["psm", pytest.param("full_cart_mtm", marks=pytest.mark.slow)])
def test_whatever_comes_the_core_goes_on(rig):
    served = Served(rig, wanted=())
    accepted = flood(served, np.random.default_rng(7), lambda topic, made: True)  # noqa: ARG005
    assert 0.2 * COUNT < accepted < 0.9 * COUNT
    assert served.core.refused > 0.2 * COUNT
    check_bounds(served)
    for arm in served.world.arms.values():
        assert np.isfinite(arm.joints.readings()[0]).all()


def test_a_flood_between_two_ticks_is_bounded():
    served = Served("two_psm_ecm", wanted=())
    rng = np.random.default_rng(3)
    topics = [t for t in served.core.topics.values() if t.direction == "sub" and not t.later]
    for _ in range(COUNT):
        topic = topics[rng.integers(len(topics))]
        served.core.receive(topic.name, message(rng, topic, 6), "flood")  # type: ignore[arg-type]
    check_bounds(served)
    assert served.loop.pending > 0
    served.run(0.05)
    check_bounds(served)
