"""Every command with extreme values: rejected or carried out, and the simulation goes on."""

from __future__ import annotations

from operator import attrgetter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.attack import Tally
from benchmarks.attack.commands import EXTREME, SCENES, arguments, attack, outcome, quiet, verbs
from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError
from trocar.live import Command, Loop
from trocar.simulation import World
from trocar.simulation.controllers import CartesianImpedance, HalfPlaneGains

WORLD = World("psm")
VERBS = [name for name, *_ in verbs(WORLD) if not name.endswith(("_tool", "_tool_type"))]
calls = st.lists(
    st.tuples(st.sampled_from(VERBS), st.integers(0, 2**32 - 1), st.integers(1, 20)), max_size=6
)


def check_calls(given_calls: list[tuple[str, int, int]]) -> None:
    WORLD.reset()
    methods = {name: (owner, verb) for name, owner, verb in verbs(WORLD)}
    with quiet():
        for name, seed, steps in given_calls:
            owner, verb = methods[name]
            values = arguments(np.random.default_rng(seed), WORLD, owner, verb)
            assert outcome(WORLD, verb, values, steps) == ""


@settings(max_examples=30, deadline=None, derandomize=True)
@given(calls)
def test_commands_with_extreme_values_leave_the_simulation_finite(given_calls):
    check_calls(given_calls)


@pytest.mark.slow
@settings(max_examples=2_000, deadline=None)  # other ones each run
@given(calls)
def test_fresh_commands_with_extreme_values_leave_the_simulation_finite(given_calls):
    check_calls(given_calls)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.sampled_from(VERBS), st.integers(0, 2**32 - 1)), max_size=8))
def test_no_command_with_extreme_values_ends_the_loop(given_calls):
    WORLD.reset()
    loop = Loop(WORLD, speed="max")
    owners = {name: (owner, verb) for name, owner, verb in verbs(WORLD)}
    with quiet():
        for name, seed in given_calls:
            arm, _, verb = name.partition(".")
            values = arguments(np.random.default_rng(seed), WORLD, *owners[name])
            loop.post(Command(arm, verb, values))
            loop.tick()
    assert np.isfinite(WORLD.mj_data.qpos).all()


def test_the_attack_on_commands_counts_its_cases():
    tally = attack(seed=3, seconds=0.5)
    assert isinstance(tally, Tally)
    assert tally.failed == []
    assert tally.clean == tally.tried > 0


@pytest.mark.parametrize("name", SCENES)
def test_the_attack_makes_arguments_of_every_command(name):
    scene = load_scene(name)
    world = World(scene.rig, welded=scene.welded)
    for _, owner, verb in verbs(world):
        for seed in range(8):  # each leaves out some
            arguments(np.random.default_rng(seed), world, owner, verb)


# ---------------------------------------------------------------------- found by the attack


def test_an_arm_that_is_welded_refuses_what_its_motors_would_do():
    arm = World("psm", welded=["PSM1"]).arm("PSM1")
    with pytest.raises(InputError, match=r"PSM1: is welded into the model; .* gravity"):
        arm.joints.use_gravity_compensation(True)
    with pytest.raises(InputError, match=r"PSM1: is welded into the model; .* torque"):
        arm.joints.use_computed_torque(True)


@pytest.fixture
def arm():
    WORLD.reset()
    return WORLD.arm("PSM1")


@pytest.mark.parametrize("value", [v for v in EXTREME if abs(v) > 1e6])
@pytest.mark.parametrize(
    "verb", ["servo_jp", "servo_jr", "servo_jv", "servo_jf", "forces.servo_cf"]
)
def test_a_number_beyond_a_million_is_rejected(arm, verb, value):
    assert not attrgetter(verb)(arm)([value, 0.0, 0.1, 0.0, 0.0, 0.0])
    assert "magnitude up to 1e+06" in arm.rejections.last
    WORLD.step(20)


def test_tables_and_states_that_are_far_too_fast_are_rejected():
    WORLD.reset()
    here = WORLD.arm("PSM1").joints.setpoints()
    fast = np.array([joint.velocity_max for joint in WORLD.arm("PSM1").description.joints])
    fast[1] *= 1e3
    with pytest.raises(InputError, match=r"PSM1: got velocities .* in row 1; allowed: up to"):
        WORLD.play({"PSM1": np.tile(here, (2, 1))}, {"PSM1": np.array([0.0 * fast, fast])})
    with pytest.raises(InputError, match=r"PSM1: got velocities .*; allowed: "):
        WORLD.set_state("PSM1", here, fast)
    with pytest.raises(InputError, match=r"PSM1: got positions .*; allowed: "):
        WORLD.set_state("PSM1", here + 9.0)
    with pytest.raises(InputError, match=r"efforts must be finite, .* up to 1e"):
        WORLD.play({"PSM1": here[None]}, efforts={"PSM1": 1e12 * np.eye(7)[1:2]})
    assert WORLD.time == 0.0


@pytest.mark.parametrize("verb", ["servo_cp", "servo_cr", "move_cp"])
@pytest.mark.parametrize("far", [1e4, 1.7e308, -1e200])
def test_a_pose_far_away_is_rejected(arm, verb, far):
    T = np.eye(4)
    T[0, 3] = far
    answer = getattr(arm, verb)(T)
    assert not (answer if isinstance(answer, bool) else answer.goal_reached)
    assert "allowed: up to 1000 m away" in arm.rejections.last


@pytest.mark.parametrize("bad", [{}, "pose", None, 10**400, 1j, np.full((4, 4), 1e200)])
def test_what_is_no_pose_is_rejected(arm, bad):
    for verb in ("servo_cp", "servo_cr", "move_cp"):
        assert not getattr(getattr(arm, verb)(bad), "goal_reached", False)
    assert arm.rejections.count


def springs(**values):
    return CartesianImpedance(np.zeros(3), **values)


@pytest.mark.parametrize(
    ("impedance", "reason"),
    [
        ([], "a CartesianImpedance"),
        (CartesianImpedance(np.array([0.0, 0.0, 1e200])), "force_position: got"),
        (springs(position_positive=HalfPlaneGains(p=np.array([np.nan, 0, 0]))), "positive.p: got"),
        (springs(position_negative=HalfPlaneGains(d=np.full(3, 1e300))), "negative.d: got"),
        (springs(orientation_positive=HalfPlaneGains(bias=np.zeros(2))), "positive.bias: got"),
        (springs(orientation_negative=HalfPlaneGains(deadband=-np.ones(3))), "0 or more"),
        (springs(torque_orientation=1e200 * np.eye(3)), "torque_orientation: not orthonormal"),
    ],
)
def test_springs_that_cannot_be_are_rejected(arm, impedance, reason):
    assert not arm.forces.servo_ci(impedance)
    assert reason in arm.rejections.last
    assert arm.joints.mode("yaw") == "position"
