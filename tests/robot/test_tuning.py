"""`trocar tune`: what is read off a step, and that tuning never makes it worse."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.descriptions.inertial import apparent_inertias, holding_efforts
from trocar.descriptions.records import Gains
from trocar.errors import DivergedError, InputError, UnknownNameError
from trocar.robot.tuning import StepBench, StepResponse, TuneSettings, step_response, tune
from trocar.robot.tuning.gains import MOST_FACTOR, bounds, cost, search

Array = NDArray[np.float64]

OMEGA = 20.0
TIME: Array = np.linspace(0.0, 4.0, 4001)


def second_order(zeta: float, time: Array, omega: float = OMEGA) -> Array:
    """Return the textbook's answer of omega^2 / (s^2 + 2 zeta omega s + omega^2) to a unit step."""
    if zeta == 1.0:
        return 1.0 - (1.0 + omega * time) * np.exp(-omega * time)
    if zeta > 1.0:
        root = omega * math.sqrt(zeta**2 - 1.0)
        slow, fast = zeta * omega - root, zeta * omega + root
        return 1.0 - (fast * np.exp(-slow * time) - slow * np.exp(-fast * time)) / (fast - slow)
    damped = omega * math.sqrt(1.0 - zeta**2)
    swing = np.cos(damped * time) + zeta * omega / damped * np.sin(damped * time)
    return 1.0 - np.exp(-zeta * omega * time) * swing


@pytest.mark.parametrize("zeta", [0.2, 0.4, 0.5, 0.7])
def test_the_overshoot_is_that_of_the_textbook(zeta: float) -> None:
    found = step_response(TIME, second_order(zeta, TIME), 1.0)
    # The peak lies within half a sample of one: omega^2 dt^2 / 8 = 5e-5.
    assert found.overshoot == pytest.approx(
        math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), abs=1e-4
    )


@pytest.mark.parametrize("zeta", [0.2, 0.5, 0.7, 1.0, 1.5])
def test_the_rise_time_is_that_of_the_formula_solved_finely(zeta: float) -> None:
    fine = np.linspace(0.0, 0.5, 500_001)
    answer = second_order(zeta, fine)
    wanted = fine[np.argmax(answer >= 0.9)] - fine[np.argmax(answer >= 0.1)]
    found = step_response(TIME, second_order(zeta, TIME), 1.0)
    # Lines between samples of 1 ms leave omega dt^2 or so.
    assert found.rise_time_s == pytest.approx(wanted, abs=3e-5)


def test_the_rise_time_of_a_first_order_answer_is_ln_9_time_constants() -> None:
    found = step_response(TIME, 1.0 - np.exp(-TIME / 0.1), 1.0)
    assert found.rise_time_s == pytest.approx(0.1 * math.log(9.0), rel=1e-4)
    assert found.settling_time_s == pytest.approx(0.1 * math.log(50.0), rel=1e-4)
    assert found.overshoot == 0.0


@pytest.mark.parametrize("zeta", [0.2, 0.5, 0.7])
def test_the_settling_time_lies_within_the_envelope_and_its_last_half_swing(zeta: float) -> None:
    found = step_response(TIME, second_order(zeta, TIME), 1.0)
    root = math.sqrt(1.0 - zeta**2)
    envelope = -math.log(0.02 * root) / (zeta * OMEGA)
    assert envelope - math.pi / (OMEGA * root) <= found.settling_time_s <= envelope + 1e-6
    after = second_order(zeta, found.settling_time_s + np.linspace(1e-5, 1.0, 20_000))
    assert np.abs(after - 1.0).max() <= 0.02 + 1e-5  # lines between samples


def test_a_step_down_from_elsewhere_reads_the_same_and_says_what_is_left() -> None:
    up = step_response(TIME, second_order(0.5, TIME), 1.0)
    down = step_response(TIME, 0.3 - 0.02 * second_order(0.5, TIME), 0.279)
    assert down.rise_time_s == pytest.approx(up.rise_time_s)
    assert down.settling_time_s == pytest.approx(up.settling_time_s)
    assert down.overshoot == pytest.approx(up.overshoot)
    assert down.steady_error == pytest.approx(-0.001)
    assert up.steady_error == pytest.approx(0.0, abs=1e-9)


def test_what_swings_on_has_not_settled_and_what_stays_has_not_risen() -> None:
    swings = step_response(TIME, 1.0 - np.cos(10.0 * np.pi * TIME), 1.0)  # whole swings at the end
    assert math.isnan(swings.settling_time_s)
    assert swings.overshoot == pytest.approx(1.0, abs=0.01)
    stays = step_response(TIME, np.zeros(len(TIME)), 1.0)
    assert math.isnan(stays.rise_time_s) and math.isnan(stays.settling_time_s)
    assert stays.steady_error == 1.0


# ------------------------------------------------------------------ the search


def servo(gains: Gains, inertia: float = 0.5) -> StepResponse:
    """Return the answer of an inertia without friction to its servo, with P as its effort."""
    omega = math.sqrt(gains.p / inertia)
    zeta = gains.d / (2.0 * math.sqrt(gains.p * inertia))
    return step_response(TIME, second_order(zeta, TIME, omega), 1.0, gains.p / 400.0)


def test_an_ideal_servo_is_tuned_to_its_effort_and_to_little_overshoot() -> None:
    present = Gains(200.0, 0.3, 10.0)
    best, tried = search(servo, present, 1.0)
    before, after = servo(present), servo(best)
    assert before.overshoot > 0.15
    assert after.overshoot <= 0.05
    assert after.peak_effort_share <= 0.8
    most = math.sqrt(320.0 / 0.5)  # at 80 % of the effort
    fastest = min(
        step_response(TIME, second_order(zeta, TIME, most), 1.0).settling_time_s
        for zeta in np.linspace(0.69, 0.99, 61)
    )
    # Settling jumps where a swing first touches the band, so a search with steps stops beside it.
    assert fastest <= after.settling_time_s <= 1.15 * fastest
    assert best.i == present.i
    assert 9 <= tried <= 200


@pytest.mark.parametrize("p", [10.0, 200.0, 3000.0])
@pytest.mark.parametrize("d", [0.0, 0.5, 30.0, 200.0])
def test_tuned_gains_are_never_worse_and_stay_in_reach(p: float, d: float) -> None:
    present = Gains(p, 0.0, d)
    best, _ = search(servo, present, 1.0)
    allowed = bounds(1.0, servo(present))
    assert cost(servo(best), allowed) <= cost(servo(present), allowed)
    assert p / MOST_FACTOR <= best.p <= p * MOST_FACTOR
    begun = d or 0.01 * p
    assert best.d == d or begun / MOST_FACTOR <= best.d <= begun * MOST_FACTOR


def test_breaking_a_bound_outweighs_settling_and_not_settling_outweighs_both() -> None:
    allowed = bounds(1.0, StepResponse(0.1, 0.0, 0.1, 0.0, 0.5))
    good = StepResponse(0.1, 0.05, 0.9, 0.02, 0.8)
    assert cost(good, allowed) == (0.0, pytest.approx(0.9))
    for worse in (
        StepResponse(0.1, 0.06, 0.1, 0.0, 0.5),
        StepResponse(0.1, 0.0, 0.1, -0.03, 0.5),
        StepResponse(0.1, 0.0, 0.1, 0.0, 0.9),
        StepResponse(math.nan, 0.0, math.nan, 0.0, 0.5),
    ):
        assert cost(worse, allowed) > cost(good, allowed)


def test_gains_that_diverge_are_not_taken() -> None:
    def only_softer(gains: Gains) -> StepResponse:
        if gains.p > 200.0:
            raise DivergedError(0.1, "yaw", 0.0)
        return servo(gains)

    best, _ = search(only_softer, Gains(200.0, 0.0, 10.0), 1.0)
    assert best.p <= 200.0


# ------------------------------------------------------------------ on an arm


@pytest.fixture(scope="module")
def report():
    return tune("psm", TuneSettings(("insertion", "roll")))


def test_every_step_begins_afresh_so_the_same_gains_give_the_same_answer() -> None:
    bench = StepBench(load_arm("psm"))
    first = bench.step("yaw")
    bench.step("jaw", Gains(9.0, 0.0, 0.06))
    again = bench.step("yaw")
    np.testing.assert_array_equal(first.position, again.position)
    np.testing.assert_array_equal(first.effort, again.effort)


def test_the_other_joints_are_held_by_more_than_their_servos() -> None:
    arm = load_arm("psm")
    preset = arm.control["dvrk"]
    limp = {n: g if n == "pitch" else Gains(0.1 * g.p, 0.0, 0.0) for n, g in preset.pid.items()}
    weak = replace(arm, control={"dvrk": replace(preset, pid=limp)})
    np.testing.assert_array_equal(
        StepBench(weak).step("pitch").position, StepBench(arm).step("pitch").position
    )


def test_a_step_moves_its_joint_to_the_target_within_the_effort_limit() -> None:
    arm = load_arm("psm")
    bench = StepBench(arm, dynamics="cad")
    for joint in arm.joints:
        trace = bench.step(joint.name)
        size = bench.step_size(joint.name)
        assert trace.position[-1] == pytest.approx(trace.target, abs=0.05 * size)
        assert trace.position[-1] - trace.position[0] == pytest.approx(size, rel=0.1)
        assert np.abs(trace.effort).max() <= joint.effort_max
        # Half of the limit by the servo; the weight that is compensated comes on top of it.
        assert 0.2 <= trace.response.peak_effort_share <= 0.8


def test_an_arm_answers_nearly_as_an_inertia_and_a_damper_would() -> None:
    """Without dry friction the yaw is one mass before its P and D, and P carries its weight."""
    arm = load_arm("psm")
    bench = StepBench(arm, "paper", "paper")
    gains = Gains(70.0, 0.0, 2.0)
    trace = bench.step("yaw", gains)
    inertia = apparent_inertias(arm, arm.poses["home"])[0]
    damping = gains.d + arm.friction["paper"]["yaw"].viscous
    zeta = damping / (2.0 * math.sqrt(gains.p * inertia))
    wanted = math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
    # The implicit servo damps by dt P / 2 more, 0.035 of 2.1.
    assert trace.response.overshoot == pytest.approx(wanted, abs=0.02)
    q = arm.poses["home"].copy()
    q[0] = trace.position[-1]
    weight = holding_efforts(arm, q)[0]
    assert trace.response.steady_error == pytest.approx(weight / gains.p, abs=1e-6)


@pytest.mark.slow
def test_tuning_twice_gives_the_same_report(report) -> None:
    again = tune("psm", TuneSettings(("roll",)))
    assert again.joints == report.joints[1:]


def test_tuned_joints_settle_sooner_within_the_bounds(report) -> None:
    assert [entry.joint for entry in report.joints] == ["insertion", "roll"]
    for entry in report.joints:
        allowed = bounds(entry.step, entry.present.response)
        assert cost(entry.tuned.response, allowed) <= cost(entry.present.response, allowed)
        assert entry.tuned.response.overshoot <= 0.05
        assert entry.tuned.response.peak_effort_share <= 0.8
        assert entry.tuned.gains.i == entry.present.gains.i


def test_the_lines_to_paste_are_toml_and_load_with_the_tuned_gains(report, tmp_path: Path) -> None:
    assert list(report.toml) == ["psm", "LARGE_NEEDLE_DRIVER:400006"]
    pid = tomllib.loads(report.toml["psm"])["control"]["dvrk"]["pid"]
    assert pid["yaw"] == [120.0, 0.0, 6.0]  # not tuned: stays
    text = Path(load_arm("psm").file).read_text(encoding="utf-8")
    (old,) = [line for line in text.splitlines() if line.startswith("pid = { yaw = [120")]
    mine = tmp_path / "psm.toml"
    mine.write_text(text.replace(old, report.toml["psm"].splitlines()[1]), encoding="utf-8")
    tuned = report.joints[0].tuned
    assert load_arm(mine).control["dvrk"].pid["insertion"] == tuned.gains


def test_setup_joints_are_stepped_with_only_their_own_brake_released() -> None:
    bench = StepBench(load_arm("suj_psm1"))
    assert bench.step("suj_4").response.settling_time_s < 1.0


def test_a_joint_without_p_cannot_be_stepped(tmp_path: Path) -> None:
    text = Path(load_arm("ecm").file).read_text(encoding="utf-8")
    mine = tmp_path / "limp.toml"
    mine.write_text(text.replace("roll = [20.0, 0.0, 0.5]", "roll = [0.0, 0.0, 0.5]"))
    with pytest.raises(InputError, match="roll: got P 0; allowed for a step: above 0"):
        tune(mine, TuneSettings(("roll",)))


def test_an_unknown_joint_is_answered_with_those_that_are_known() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown joint 'rol' \(did you mean 'roll'\?\)"):
        tune("ecm", TuneSettings(("rol",)))


def test_a_gripper_has_no_motor_and_the_rest_of_its_arm_is_tuned_around_it() -> None:
    bench = StepBench(load_arm("mtmr"), dynamics="cad")
    assert bench.joints == load_arm("mtmr").mechanism.joint_names[:-1]
    trace = bench.step("wrist_roll")
    assert trace.position[-1] == pytest.approx(
        trace.target, abs=0.1 * bench.step_size("wrist_roll")
    )
    with pytest.raises(InputError, match="mtmr: gripper has no motor; allowed: outer_yaw, "):
        tune("mtmr", TuneSettings(("wrist_roll", "gripper")))
