"""Whatever verbs come, an arm that is not ready does not move, and none breaks."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trocar.simulation import World
from trocar.simulation.arm import Arm
from trocar.simulation.controllers import CartesianImpedance

STATES = {"DISABLED", "ENABLED", "PAUSED", "FAULT"}


def numbers(rng: np.random.Generator, count: int) -> object:
    """Mostly useful joint numbers, sometimes rubbish."""
    kind = rng.integers(12)
    if kind == 0:
        return np.full(count, np.nan)
    if kind == 1:
        return np.zeros(count + 1)
    if kind == 2:
        return "abc"
    if kind == 3:
        return 10.0 * rng.standard_normal(count)
    return 0.1 * rng.standard_normal(count)


def pose(rng: np.random.Generator, arm: Arm) -> object:
    kind = rng.integers(6)
    if kind == 0:
        return np.full((4, 4), np.nan)
    if kind == 1:
        return np.eye(3)
    T = arm.setpoint_cp().matrix
    T[:3, 3] += 0.01 * rng.standard_normal(3) if kind < 5 else 1.0
    return T


#: These read the set-points anew from what is measured.
READ_ANEW = {"enable", "disable", "home", "unhome", "pause", "state_command", "set_mode"}
VERBS = {
    "enable": lambda a, _: a.enable(),
    "disable": lambda a, _: a.disable(),
    "pause": lambda a, _: a.state_command("pause"),
    "resume": lambda a, _: a.state_command("resume"),
    "home": lambda a, _: a.home(),
    "unhome": lambda a, _: a.state_command("unhome"),
    "state_command": lambda a, r: a.state_command(["home", "fly", "disable"][r.integers(3)]),
    "servo_jp": lambda a, r: a.servo_jp(numbers(r, 6)),
    "servo_jp_v": lambda a, r: a.servo_jp(a.setpoint_js().position, numbers(r, 6)),
    "servo_jr": lambda a, r: a.servo_jr(numbers(r, 6)),
    "servo_jf": lambda a, r: a.servo_jf(numbers(r, 6)),
    "servo_cp": lambda a, r: a.servo_cp(pose(r, a)),
    "servo_cr": lambda a, _: a.servo_cr(np.eye(4)),
    "servo_cf": lambda a, r: a.forces.servo_cf(
        numbers(r, 6), ["body", "spatial", "tool"][r.integers(3)]
    ),
    "servo_ci": lambda a, _: a.forces.servo_ci(CartesianImpedance(a.measured_cp().matrix[:3, 3])),
    "move_jp": lambda a, r: a.move_jp(numbers(r, 6)),
    "move_jr": lambda a, r: a.move_jr(numbers(r, 6)),
    "move_cp": lambda a, r: a.move_cp(pose(r, a)),
    "hold": lambda a, _: a.hold(),
    "free": lambda a, _: a.free(),
    "set_mode": lambda a, r: a.joints.set_mode(["position", "effort", "set"][r.integers(3)]),
    "jaw.move_jp": lambda a, r: a.jaw.move_jp(numbers(r, 1)),
    "jaw.servo_jp": lambda a, r: a.jaw.servo_jp(numbers(r, 1)),
    "jaw.servo_jf": lambda a, r: a.jaw.servo_jf(numbers(r, 1)),
    "jaw.close": lambda a, _: a.jaw.close(),
    "gravity": lambda a, r: a.joints.use_gravity_compensation(bool(r.integers(2))),
}


WORLD = World("psm", homed=False)


def check_sequence(names: list[str], seed: int, ready: bool) -> None:
    """Give an arm verbs and look after each of them."""
    rng = np.random.default_rng(seed)
    world, arm = WORLD, WORLD.arm("PSM1")
    world.reset()
    if ready:
        arm.runtime.begin(arm.joints.readings()[0], ready=True)
    for name in names:
        was_ready = arm.operating_state().ready
        before, setpoint = arm.joints.readings()[0], arm.setpoint_js().position
        VERBS[name](arm, rng)
        now = arm.operating_state()
        assert now.state in STATES
        assert not (now.ready and not was_ready) or name in ("enable", "resume")
        world.step(int(rng.integers(1, 3)))
        assert arm.operating_state().state in STATES
        if not was_ready and not now.is_busy and name not in READ_ANEW:
            np.testing.assert_array_equal(arm.setpoint_js().position, setpoint)
        if now.state in ("DISABLED", "FAULT") and not now.is_busy and not was_ready:
            # a jaw that was pressed into its stop comes back out of it
            np.testing.assert_allclose(arm.joints.readings()[0][:6], before[:6], atol=1e-6)
        assert np.isfinite(arm.joints.readings()[0]).all()


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    log = logging.getLogger("trocar")
    log.setLevel(logging.CRITICAL)
    yield
    log.setLevel(logging.NOTSET)


sequences = given(
    names=st.lists(st.sampled_from(sorted(VERBS)), min_size=1, max_size=10),
    seed=st.integers(0, 2**32 - 1),
    ready=st.booleans(),
)


@settings(max_examples=300, deadline=None, derandomize=True)
@sequences
def test_verbs_in_any_order_never_move_an_arm_that_is_not_ready(names, seed, ready):
    check_sequence(names, seed, ready)


@pytest.mark.slow
@settings(max_examples=2_000, deadline=None)  # other ones each run
@sequences
def test_fresh_orders_of_verbs_never_move_an_arm_that_is_not_ready(names, seed, ready):
    check_sequence(names, seed, ready)
