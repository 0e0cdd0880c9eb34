"""Identified dynamics are those that made the log, and of possible bodies."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar import World
from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.descriptions.overlay import overlay_text, parse_overlay
from trocar.descriptions.overlay_records import Drivetrain, FilterSettings, Overlay
from trocar.errors import InputError, LogError, MissingExtraError, UnknownNameError
from trocar.recording import record
from trocar.robot.identification import (
    FilteredLog,
    JointMotion,
    Log,
    Weight,
    cross_validate,
    excite,
    filtered,
    identify,
    predicted_efforts,
    read_motion,
)
from trocar.robot.identification.bounds import all_bounds, body_bounds
from trocar.robot.identification.drivetrains import (
    basis,
    coefficients,
    described_trains,
    labels,
    stop_elements,
    structure,
    train_efforts,
)
from trocar.robot.identification.fit import fit_problem, reweighted
from trocar.robot.identification.logs import derivative, low_pass
from trocar.robot.identification.regression import loaded, moving_bodies
from trocar.robot.identification.rigid_body import parameters, pseudo_inertia

Array = NDArray[np.float64]
RATE_HZ = 100.0
SETTINGS = FilterSettings(rate_hz=RATE_HZ, cutoff_hz=20.0)


def motion(name: str, seconds: float = 10.0, seed: int = 1) -> JointMotion:
    arm = load_arm(name)
    found = excite(arm, seconds, 1, RATE_HZ, candidates=10, seed=seed)
    return JointMotion(found.q, found.qd, np.gradient(found.qd, 1.0 / RATE_HZ, axis=0))


def trains(name: str) -> dict[str, Drivetrain]:
    arm = load_arm(name)
    return {
        train_name: replace(
            train,
            terms={
                "coulomb": (0.03,), "viscous": (0.05,), "offset": (0.01,), "rotor": (0.01,),
                "stops": tuple(0.05 / limit for limit in train.stop_limits),
            },
        )
        for train_name, train in structure(arm).items()
    }  # fmt: skip


def log_of(
    name: str, rng: np.random.Generator, noise: float = 0.0, known: tuple[Weight, ...] = ()
) -> FilteredLog:
    arm, moved = load_arm(name), motion(name)
    effort = predicted_efforts(loaded(arm, known), trains(name), moved)
    effort = effort + noise * rng.normal(size=effort.shape) * effort.std(axis=0)
    log = Log("made", RATE_HZ, moved.q, moved.qd, effort, arm.mechanism.joint_names, np.eye(4))
    return filtered(log, arm, SETTINGS)


@pytest.fixture(scope="module")
def found() -> object:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    log = log_of("ecm", np.random.default_rng(3), noise=0.005)
    return log, identify([log], load_arm("ecm"), mass_ratios=(0.1, 10.0))


def test_identifiable_parameters_return_within_two_percent(found: object) -> None:
    _, result = found  # type: ignore[misc]
    truth = np.concatenate(
        [
            *(
                sum(parameters(b) for b in load_arm("ecm").bodies
                    if b.frame == frame and b.part == "ecm")
                for frame in result.model.frames
            ),
            *(
                [value for term in ("rotor", "coulomb", "viscous", "offset", "stops")
                 for value in trains("ecm")[name].terms[term]]
                for name in result.model.trains
            ),
        ]
    )  # fmt: skip
    base = result.base
    expected = base.combinations @ truth
    sure = base.sigma < 0.005 * np.abs(base.values)
    assert sure.sum() >= 5
    np.testing.assert_allclose(base.values[sure], expected[sure], rtol=0.02)


def test_without_noise_every_base_parameter_of_a_matched_model_returns() -> None:
    """What is left is the solver's: its tolerance is not one of the squared efforts."""
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    arm, log = load_arm("ecm_si"), log_of("ecm_si", np.random.default_rng(0))
    problem = fit_problem([log], arm)
    model, ((matrix, _),) = problem.model, problem.parts
    truth = 1.1 * model.values
    known = [c for one in model.trains for c in coefficients(trains("ecm_si")[one]).tolist()]
    truth[10 * len(model.frames) :] = known
    bounds = all_bounds(arm, model.frames, (0.1, 10.0))
    base = reweighted(model, bounds, [(matrix, matrix @ truth)], [log]).base
    np.testing.assert_allclose(base.values, base.combinations @ truth, rtol=2e-3)


@pytest.mark.parametrize("name", ["psm_si", "ecm_si"])
def test_second_moments_of_the_described_bodies_of_an_si_are_within_their_bounds(name: str) -> None:
    arm = load_arm(name)
    for frame in moving_bodies(arm, arm.mechanism.joint_names):
        one = body_bounds(arm, frame)
        own = [b for b in arm.bodies if b.frame == frame and b.part == arm.name]
        m, h, s = np.split(np.sum([parameters(b) for b in own], axis=0)[:7], (1, 4))
        assert (s - 2.0 * one.middle * h + (one.middle**2 - one.half**2) * m <= 0.0).all(), frame


def test_rounding_does_not_choose_the_base_parameters(found: object) -> None:
    log, result = found  # type: ignore[misc]
    rng = np.random.default_rng(0)
    q, qd, effort = (
        x * (1.0 + 1e-15 * rng.normal(size=x.shape))
        for x in (log.log.q, log.log.qd, log.log.effort)
    )
    again = filtered(replace(log.log, q=q, qd=qd, effort=effort), load_arm("ecm"), SETTINGS)
    base = identify([again], load_arm("ecm"), mass_ratios=(0.1, 10.0)).base
    assert base.names == result.base.names
    assert base.identifiable == result.base.identifiable
    assert base.condition == pytest.approx(result.base.condition, rel=1e-6)
    # Bodies that move alike: the first named stands for all.
    assert base.names[0] == result.model.names[1] == "yaw.hx"


def test_an_arm_at_rest_has_no_coulomb_friction_whatever_rounding_leaves_of_its_velocity() -> None:
    arm = load_arm("mtml")
    q = np.tile(arm.poses["home"], (20, 1))
    still = JointMotion(q, np.zeros_like(q), np.zeros_like(q))
    rounded = replace(still, qd=1e-17 * np.random.default_rng(0).normal(size=q.shape))
    np.testing.assert_allclose(
        predicted_efforts(arm, trains("mtml"), rounded),
        predicted_efforts(arm, trains("mtml"), still),
        atol=1e-12,
    )


def test_identified_bodies_are_possible(found: object) -> None:
    _, result = found  # type: ignore[misc]
    for k, frame in enumerate(result.model.frames):
        body, bounds = result.dynamics.bodies[frame], result.bounds[frame]
        assert bounds.lower - 1e-6 <= body.mass <= bounds.upper + 1e-6
        assert bounds.contains(body.com, 1e-5)
        own = pseudo_inertia(result.parameters[10 * k : 10 * k + 10])
        assert np.linalg.eigvalsh(own).min() > 0.0
    for train in result.dynamics.drivetrains.values():
        for term in ("rotor", "coulomb", "viscous", "stops"):
            assert min(train.terms[term]) > -1e-6


def test_an_overlay_with_dynamics_comes_back_and_goes_on_the_arm(found: object) -> None:
    _, result = found  # type: ignore[misc]
    overlay = result.overlay("1")
    again = parse_overlay(overlay_text(overlay), "it.toml")
    assert overlay_text(again) == overlay_text(overlay)
    arm = load_arm("ecm", calibration=again)
    masses = {b.frame: b.mass for b in arm.bodies if b.part == "ecm"}
    for frame, body in result.dynamics.bodies.items():
        assert masses[frame] == pytest.approx(body.mass)
    slipping = result.dynamics.drivetrains["yaw"].dry_friction
    assert arm.friction["identified"]["yaw"].coulomb == pytest.approx(slipping)


def test_predictions_with_identified_dynamics_explain_the_log_they_are_from(found: object) -> None:
    log, result = found  # type: ignore[misc]
    arm = load_arm("ecm", calibration=result.overlay("1"))
    efforts = predicted_efforts(arm, result.dynamics.drivetrains, log.motion)
    error = log.cut(log.effort) - log.smooth(efforts)
    ratio = np.linalg.norm(error, axis=0) / np.linalg.norm(log.cut(log.effort), axis=0)
    assert ratio.max() < 0.01


@pytest.mark.slow
def test_a_known_weight_is_not_taken_for_the_arm() -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    arm, known = load_arm("ecm"), (Weight(0.5, "pitch_end", (0.0, 0.0, 0.1)),)
    rng = np.random.default_rng(5)
    log = log_of("ecm", rng, known=known)
    with_it = identify([log], arm, [known]).overlay("1").dynamics
    without = identify([log], arm).overlay("1").dynamics
    assert with_it is not None and without is not None
    clean = log_of("ecm", rng)

    def error(dynamics: object) -> float:
        carried = load_arm("ecm", calibration=Overlay("ecm", dynamics=dynamics))  # type: ignore[arg-type]
        efforts = predicted_efforts(carried, dynamics.drivetrains, clean.motion)  # type: ignore[attr-defined]
        return float(np.abs(clean.cut(clean.effort) - clean.smooth(efforts)).max())

    assert error(with_it) < 0.1 * error(without)


def test_stop_elements_only_dissipate_over_closed_cycles() -> None:
    c = 0.3 * np.sin(np.linspace(0.0, 4.0 * np.pi, 4001))
    force = stop_elements(c, (0.01, 0.1)) @ np.array([5.0, 2.0])
    second = slice(2000, 4001)
    work = float(np.sum(force[second][1:] * np.diff(c[second])))
    # Source: a slipping element dissipates 4 k r (amplitude - r) a cycle.
    expected = 4.0 * (5.0 * 0.01 * (0.3 - 0.01) + 2.0 * 0.1 * (0.3 - 0.1))
    assert work == pytest.approx(expected, rel=0.01)
    assert (np.abs(stop_elements(c, (0.01,))) <= 0.01).all()


def test_hysteresis_is_that_of_positions_before_the_filters() -> None:
    """Stop elements of a coarse triangle wave, filtered, are explained by themselves alone."""
    arm = load_arm("ecm")
    wave = np.abs((np.arange(1000) / 40.0) % 2.0 - 1.0)
    q = np.outer(wave, 0.02 * np.ones(4))
    qd = derivative(q, RATE_HZ)
    train = Drivetrain({"yaw": 1.0}, {"stops": (1.0,)}, stop_limits=(0.005,))
    effort = np.zeros_like(q)
    effort[:, 0] = stop_elements(q[:, 0], (0.005,))[:, 0]
    log = filtered(
        Log("made", RATE_HZ, q, qd, effort, arm.mechanism.joint_names, np.eye(4)), arm, SETTINGS
    )
    found = log.smooth(train_efforts({"yaw": train}, arm, log.motion))
    np.testing.assert_allclose(found, log.cut(log.effort), atol=1e-12)


def test_coulomb_friction_of_a_simulated_log_has_the_signs_of_its_own_velocities() -> None:
    """Filtered velocities change their signs at other times."""
    arm, time = load_arm("ecm"), np.arange(1000)[:, None] / RATE_HZ
    q = 0.1 * np.sin(time * [1.0, 2.0, 3.0, 4.0]) + [0.0, 0.2, 0.1, 0.0]
    qd = np.cos(time) + 2.0 * np.cos(190.0 * time) + 0.0 * q  # 30 Hz, above the filter's 20
    log = Log("made", RATE_HZ, q, qd, 0.0 * q, arm.mechanism.joint_names, np.eye(4))
    train = Drivetrain({"yaw": 1.0}, {"coulomb": (0.0,)})
    weight = np.eye(len(arm.joints))[0]
    signs = [
        basis(train, weight, filtered(replace(log, simulated=simulated), arm, SETTINGS).motion)
        for simulated in (True, False)
    ]
    np.testing.assert_array_equal(signs[0][:, 0], np.sign(qd[:, 0]))
    assert (signs[0] != signs[1]).any()


@pytest.mark.slow
def test_friction_of_a_joint_that_sticks_in_a_simulated_log_does_not_count() -> None:
    """There it is what other forces leave; here a third of the yaw's, at random."""
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    arm, moved, rng = load_arm("ecm"), motion("ecm"), np.random.default_rng(2)
    cycle, number = np.modf(np.arange(len(moved.q)) / RATE_HZ)
    x, up = np.minimum(cycle / 0.6, 1.0), np.where(number % 2.0, -1.0, 1.0)  # then 0.4 s at rest
    steps = (
        x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
        x**2 * (1.0 - x) ** 2,
        x - 3.0 * x**2 + 2.0 * x**3,
    )
    for column, one, scale in zip(
        (moved.q, moved.qd, moved.qdd), steps, (0.3, 9.0 / 0.6, 18.0 / 0.36), strict=True
    ):
        column[:, 0] = scale * up * one
    moved.q[:, 0] += np.where(up < 0.0, 0.3, 0.0)
    effort = predicted_efforts(arm, trains("ecm"), moved)
    effort[:, 0] += np.where(x == 1.0, rng.uniform(-0.02, 0.08, len(x)), 0.0)
    log = Log("made", RATE_HZ, moved.q, moved.qd, effort, arm.mechanism.joint_names, np.eye(4))
    truth = trains("ecm")["yaw"].terms

    def off(simulated: bool) -> float:
        one = filtered(replace(log, simulated=simulated), arm, SETTINGS)
        found = identify([one], arm).dynamics.drivetrains["yaw"].terms
        return abs(found["viscous"][0] / truth["viscous"][0] - 1.0)

    assert off(simulated=True) < 0.01 < 0.05 < off(simulated=False), (off(True), off(False))


def test_an_excitation_stays_in_limits_and_is_better_than_the_first() -> None:
    arm = load_arm("psm")
    found = excite(arm, 8.0, 2, 100.0, candidates=20)
    mechanism = arm.mechanism
    assert (found.q >= mechanism.lower).all() and (found.q <= mechanism.upper).all()
    assert (np.abs(found.qd) <= [joint.velocity_max for joint in arm.joints]).all()
    assert found.condition < found.first_condition
    assert not found.qd[[0, -1]].any()
    slopes = np.gradient(found.q, 0.01, axis=0)
    np.testing.assert_allclose(slopes[2:-2], found.qd[2:-2], atol=0.02)


@pytest.mark.parametrize("name", ["ecm", "ecm_si", "mtmr", "psm_si"])
def test_an_excitation_fades_within_the_limits_of_velocity(name: str) -> None:
    arm = load_arm(name)
    found = excite(arm, 10.0, 1, 100.0, candidates=2)
    most = [joint.velocity_max for joint in arm.joints[: found.qd.shape[1]]]
    assert (np.abs(found.qd) <= most).all()


@pytest.mark.parametrize("name", ["ecm", "ecm_si", "psm", "psm_si"])
def test_an_excitation_slips_the_stop_elements_of_a_slide_both_ways(name: str) -> None:
    arm = load_arm(name)
    q = excite(arm, 10.0, 1, 100.0, candidates=20).q
    slide = [joint.kind == "prismatic" for joint in arm.joints].index(True)
    assert np.ptp(q[:, slide]) > 2.0 * max(structure(arm)["insertion"].stop_limits)


def test_an_excitation_keeps_the_crank_of_a_master_in_its_range() -> None:
    arm = load_arm("mtmr")
    q = excite(arm, 8.0, 1, 100.0, candidates=2).q
    assert arm.mechanism.within(np.hstack([q, np.zeros((len(q), 1))])).all()
    assert q[:, 1:3].max() > 0.3  # the joints alone could go on
    bar = arm.mechanism.frame("elbow_bar")
    assert bar.lower < 0.0 < bar.upper < arm.mechanism.upper[1]


def test_a_cable_says_nothing_new_beyond_the_positions_of_the_logs() -> None:
    arm, moved = load_arm("mtmr"), motion("mtmr", 5.0)
    train = structure(arm, [moved.q, moved.q[:50]])["wrist_pitch"]
    lower, upper = moved.q[:, 4].min(), moved.q[:, 4].max()
    assert train.cable_range == (lower, upper)
    q = np.zeros((3, len(arm.joints)))
    q[:, 4] = upper, upper + 0.1, upper + 0.3
    cable = [k for k, (term, _) in enumerate(labels(train)) if term == "cable"]
    found = basis(train, np.eye(len(arm.joints))[4], JointMotion(q, 0.0 * q, 0.0 * q))[:, cable]
    np.testing.assert_array_equal(found, found[:1].repeat(3, axis=0))


def write_tidy(path: Path, rows: Array, time: Array) -> Path:
    joints = load_arm("ecm").mechanism.joint_names
    parts = ("position", "velocity", "effort")
    head = ["time", *(f"{joint}_{part}" for part in parts for joint in joints)]
    np.savetxt(path, np.column_stack([time, rows]), delimiter=",", header=",".join(head),
               comments="")  # fmt: skip
    return path


@pytest.fixture
def tidy(tmp_path: Path) -> Callable[..., Path]:
    def write(
        change: Callable[[Array, Array], None] | None = None, seconds: int = 10, seed: int = 1
    ) -> Path:
        moved = motion("ecm", seed=seed)
        effort = predicted_efforts(load_arm("ecm"), described_trains(load_arm("ecm")), moved)
        rows = np.hstack([moved.q, moved.qd, effort])[: int(seconds * RATE_HZ)]
        time = np.arange(len(rows)) / RATE_HZ
        if change is not None:
            change(rows, time)
        return write_tidy(tmp_path / "log.csv", rows, time)

    return write


def test_predict_explains_a_simulated_log_with_the_description(
    tidy: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(tidy())
    assert main(["predict", log, "--arm", "ecm", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["dynamics"] == "cad"
    assert document["filters"]["cutoff_hz"] == pytest.approx(16.96)
    # Coulomb friction between two samples of 10 ms, and central differences
    assert max(document["relative_rms_percent"].values()) < 3.0
    assert set(document["rms"]) == {"yaw", "pitch", "insertion", "roll"}


def scaled(columns: slice, factor: float) -> Callable[[Array, Array], None]:
    def change(rows: Array, _time: Array) -> None:
        rows[:, columns] *= factor

    return change


def swapped(rows: Array, _time: Array) -> None:
    rows[:, [5, 9]] = rows[:, [9, 5]]  # velocities and efforts of the pitch


def clipped(rows: Array, _time: Array) -> None:
    most = 0.5 * np.abs(rows[:, 8]).max()
    rows[:, 8] = np.clip(rows[:, 8], -most, most)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (scaled(slice(8, 12), 0.0), "efforts are zero throughout"),
        (scaled(slice(4, 8), 57.3), "times the derivative of the positions; allowed: 0.5 to 2.0"),
        (scaled(slice(4, 8), -1.0), "times the derivative of the positions; allowed"),
        (swapped, "are columns swapped"),
        (scaled(slice(9, 10), 50.0), "of the samples are at or above the limit"),
        (clipped, r"yaw: .* of the samples are .* the largest of all; .*saturated"),
    ],
)
def test_columns_that_cannot_be_are_named(
    tidy: Callable[..., Path], change: Callable[[Array, Array], None], message: str
) -> None:
    with pytest.raises(LogError, match=message):
        read_motion(tidy(change), load_arm("ecm"))


def test_efforts_of_the_wrong_sign_are_named(tidy: Callable[..., Path]) -> None:
    def change(rows: Array, _time: Array) -> None:
        rows[:, 8:12] = -0.1 * rows[:, 4:8]

    with pytest.raises(LogError, match=r"the motors take up .* but friction dissipates"):
        read_motion(tidy(change), load_arm("ecm"))


def test_efforts_of_a_recording_are_means_of_the_steps_around_a_sample(tmp_path: Path) -> None:
    world, found = World("ecm", timestep_s=0.0025), []
    world.set_state("ECM", np.array([0.0, 0.0, 0.06, 0.1]))
    with record(world, tmp_path / "it.mcap"):
        arm = world.arm("ECM")
        for k in range(1300):
            arm.servo_jp([0.2 * np.sin(0.007 * k), 0.1 * np.sin(0.005 * k), 0.06, 0.1])
            world.step()
            found.append(arm.measured_js().effort)
    log = read_motion(tmp_path / "it.mcap", load_arm("ecm"))
    assert log.rate_hz == pytest.approx(200.0)
    efforts = np.array(found)
    means = low_pass(0.5 * (efforts[:-1] + efforts[1:]), 80.0, 400.0, SETTINGS)
    # The recording begins with the state before the first step; its filter has another beginning.
    np.testing.assert_allclose(log.effort[50:100], means[1::2][49:99], rtol=1e-5, atol=1e-5)


def test_a_fast_log_has_the_mean_of_efforts_that_held_set_points_make_a_saw(tmp_path: Path) -> None:
    """Samples in step with the set-points, at 200 Hz, would have one tooth's height of it."""
    arm, rate_hz = load_arm("ecm"), 1000.0
    moved = excite(arm, 4.0, 1, rate_hz, candidates=1)
    effort = 0.2 * np.cos(moved.q)
    saw = np.tile([0.2, 0.1, 0.0, -0.1, -0.2], len(effort) // 5 + 1)[: len(effort), None]
    times = np.arange(len(effort)) / rate_hz
    logs = [
        read_motion(
            write_tidy(tmp_path / f"{k}.csv", np.hstack([moved.q, moved.qd, one]), times), arm
        )
        for k, one in enumerate((effort + saw, effort))
    ]
    assert logs[0].rate_hz == 200.0
    inside = slice(100, -100)
    np.testing.assert_allclose(logs[0].effort[inside], logs[1].effort[inside], atol=1e-3)
    np.testing.assert_allclose(logs[1].effort[inside], effort[::5][inside], atol=1e-4)


def test_a_short_log_is_refused(tidy: Callable[..., Path]) -> None:
    with pytest.raises(LogError, match="lasts 2 s; allowed: 3 s or more"):
        read_motion(tidy(seconds=2), load_arm("ecm"))


def still_roll(rows: Array, _time: Array) -> None:
    rows[:, 3], rows[:, 7] = 0.1, 0.0


def test_a_joint_that_does_not_move_stays_as_described(tidy: Callable[..., Path]) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    arm = load_arm("ecm")
    log = filtered(read_motion(tidy(still_roll), arm), arm, SETTINGS)
    found = identify([log], arm)
    assert found.kept == {"roll": "did not move"}
    kept, described = found.dynamics.drivetrains["roll"], described_trains(arm)["roll"]
    assert kept.terms == described.terms
    assert "roll" not in found.model.trains


@pytest.mark.slow
def test_a_joint_without_efforts_leaves_the_fit_of_the_others(tidy: Callable[..., Path]) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    arm = load_arm("ecm")
    whole = filtered(read_motion(tidy(), arm), arm, SETTINGS)
    log = filtered(read_motion(tidy(scaled(slice(11, 12), 0.0)), arm), arm, SETTINGS)
    found, reference = identify([log], arm), identify([whole], arm)
    assert found.kept == {"roll": "has no recorded efforts"}
    for name in ("yaw", "insertion"):
        ours, theirs = (one.dynamics.drivetrains[name].terms for one in (found, reference))
        assert ours["viscous"] == pytest.approx(theirs["viscous"], rel=0.02), name
    held_out = cross_validate(log, arm).relative_rms_percent
    assert held_out["roll"] is None and held_out["yaw"] is not None


def test_a_joint_can_be_left_as_described(tidy: Callable[..., Path]) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    arm = load_arm("ecm")
    log = filtered(read_motion(tidy(), arm), arm, SETTINGS)
    assert identify([log], arm, keep=["roll"]).kept == {"roll": "is to stay as described"}
    with pytest.raises(UnknownNameError, match=r"joint 'rol'.*did you mean"):
        identify([log], arm, keep=["rol"])


def test_a_log_that_determines_nothing_is_refused(tidy: Callable[..., Path]) -> None:
    arm = load_arm("ecm")
    log = filtered(read_motion(tidy(), arm), arm, SETTINGS)
    with pytest.raises(
        LogError, match=r"determines nothing of the arm \(yaw is to stay as described"
    ):
        identify([log], arm, keep=arm.mechanism.joint_names)


def test_joints_of_the_wrist_may_be_missing_from_a_table(tmp_path: Path) -> None:
    arm = load_arm("psm")
    moved = motion("psm", 4.0)
    effort = predicted_efforts(arm, described_trains(arm), moved)
    joints = arm.mechanism.joint_names[:6]
    head = ["time", *(f"{j}_{what}" for what in ("position", "effort") for j in joints)]
    head = [name for name in head if name != "roll_effort"]
    table = np.hstack([moved.q[:, :6], np.delete(effort[:, :6], 3, axis=1)])
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([np.arange(len(table)) / RATE_HZ, table]), delimiter=",",
               header=",".join(head), comments="")  # fmt: skip
    log = read_motion(path, arm)
    assert log.silent == ("roll", "jaw")
    assert log.still(arm) == ("jaw",)


def test_swapped_efforts_are_named(
    tidy: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")

    def change(rows: Array, _time: Array) -> None:
        rows[:, [8, 10]] = rows[:, [10, 8]]

    path = tidy(change, seed=5)  # yaw and insertion move unlike
    output = path.with_suffix(".toml")
    assert main(["identify", str(path), "--arm", "ecm", "-o", str(output)]) == 2
    message = capsys.readouterr().err
    assert "efforts: insertion: no arm of this kind explains" in message
    assert "are columns swapped" in message
    assert not output.exists()


@pytest.mark.parametrize(
    ("size", "joint", "parameter"),
    [(0.02, "yaw", "yaw.stops"), (0.1, "insertion", "insertion.stops")],
)
def test_a_log_that_excites_too_little_names_what_it_does_not_determine(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    size: float,
    joint: str,
    parameter: str,
) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    arm, moved = load_arm("ecm"), motion("ecm")
    middle = moved.q.mean(axis=0)
    small = JointMotion(middle + size * (moved.q - middle), size * moved.qd, size * moved.qdd)
    effort = predicted_efforts(arm, described_trains(arm), small)
    noise = 0.02 * effort.std(axis=0) * np.random.default_rng(0).normal(size=effort.shape)
    rows = np.hstack([small.q, small.qd, effort + noise])
    path = write_tidy(tmp_path / "log.csv", rows, np.arange(len(rows)) / RATE_HZ)
    assert main(["identify", str(path), "--arm", "ecm", "-o", str(tmp_path / "own.toml")]) == 2
    message = capsys.readouterr().err
    assert f"% of the effort of {joint}" in message
    assert f"(of {joint}, " in message and parameter in message
    assert "cannot be identified" in message


def test_an_arm_without_masses_is_named() -> None:
    log = log_of("ecm", np.random.default_rng(0))
    with pytest.raises(InputError, match="has no bodies with masses"):
        identify([log], replace(load_arm("ecm"), bodies=()))


def test_bounds_that_exclude_each_other_are_named() -> None:
    log = log_of("ecm", np.random.default_rng(0))
    with pytest.raises(InputError, match=r"mass bounds: got 2 to 1 times .* LOWER below UPPER"):
        identify([log], load_arm("ecm"), mass_ratios=(2.0, 1.0))


def test_a_missing_header_column_is_named(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,yaw_position\n0,0\n")
    with pytest.raises(LogError, match="lacks columns pitch_position"):
        read_motion(path, load_arm("ecm"))


def test_identify_and_predict_from_the_command_line(
    tidy: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    log, overlay = str(tidy()), str(tmp_path / "own.toml")
    assert main(["identify", log, "--arm", "ecm", "-o", overlay, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["base_parameters"] and document["identifiable"]
    assert main(["predict", log, "--arm", "ecm", "--dynamics", overlay, "--json"]) == 0
    predicted = json.loads(capsys.readouterr().out)["relative_rms_percent"]
    for name, value in document["logs"][0]["relative_rms_percent"].items():
        assert predicted[name] == pytest.approx(value, rel=1e-6)
    assert main(["show", "ecm", "--dynamics", overlay, "--json"]) == 0
    shown = {b["frame"]: b["mass"] for b in json.loads(capsys.readouterr().out)["bodies"]}
    assert shown["yaw"] == pytest.approx(document["bodies"]["yaw"]["mass_kg"])


def test_excite_writes_a_trajectory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "t.csv"
    words = ["excite", "--arm", "psm", "--candidates", "4", "--repeats", "1", "-o", str(path)]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["samples"] == 2001
    assert path.read_text().startswith("time,yaw_position,")
    assert main(words) == 2


def test_without_the_solver_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "clarabel", None)
    with pytest.raises(MissingExtraError, match=r"trocar\[identify\]"):
        identify([log_of("ecm", np.random.default_rng(0))], load_arm("ecm"))
