"""The dynamics that come with the package, and the recordings that they are from."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.drives import masters
from trocar import World
from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.descriptions.calibrated import as_overlay
from trocar.descriptions.inertial import holding_efforts
from trocar.errors import InputError
from trocar.robot.identification import Weight, predict, read_motion
from trocar.robot.identification.bounds import body_bounds

RECORDINGS = Path(os.environ.get("TROCAR_HARDWARE_DATA", "none"))
recorded = pytest.mark.skipif(
    not (RECORDINGS / "psm_one_results.csv.gz").is_file(),
    reason="TROCAR_HARDWARE_DATA names no folder with psm_one_results.csv.gz, recorded on a PSM",
)


@pytest.mark.parametrize("name", ["psm", "mtmr"])
def test_every_shipped_body_is_possible(name: str) -> None:
    dynamics = as_overlay(name).dynamics
    assert dynamics is not None
    arm = load_arm(name)
    for frame, body in dynamics.bodies.items():
        bounds = body_bounds(arm, frame)
        assert bounds.lower - 1e-6 <= body.mass <= bounds.upper + 1e-6
        assert bounds.contains(body.com, 1e-5)
        second = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
        assert np.linalg.eigvalsh(second).min() > 0.0
        assert body.mass_sigma is not None


@pytest.mark.parametrize("name", ["psm", "mtmr"])
def test_the_nominal_arm_keeps_its_masses(name: str) -> None:
    with_it, nominal = load_arm(name, calibration=name), load_arm(name)
    assert with_it.overlay is not None
    assert nominal.overlay is None
    own = [(a.mass, b.mass) for a, b in zip(nominal.bodies, with_it.bodies, strict=True)]
    assert any(a != b for a, b in own)


def test_a_simulated_psm_with_identified_dynamics_stays_where_it_is() -> None:
    world = World("psm", calibration="psm")
    arm = world.arms["PSM1"]
    world.step(1000)
    before = np.array(arm.measured_js().position)
    world.step(300)
    assert np.abs(np.array(arm.measured_js().position) - before).max() < 1e-4


@pytest.mark.parametrize("name", ["psm", "mtmr"])
def test_the_motors_hold_an_identified_arm_at_home(name: str) -> None:
    arm = load_arm(name, calibration=name)
    limits = np.array([joint.effort_max for joint in arm.joints])
    assert (np.abs(holding_efforts(arm, arm.pose("home"))) < limits).all()


def test_motors_hold_the_identified_master_anywhere_and_other_masters_weigh_the_same() -> None:
    found = masters()
    assert [figure.name for figure in found if figure.met is False] == []
    assert sum(figure.met is True for figure in found) == 7 + 3


def test_dynamics_and_geometry_are_combined_and_two_dynamics_are_refused() -> None:
    with pytest.raises(InputError, match="got two for 'psm'; allowed: one"):
        load_arm("psm", calibration=["psm", "psm"])
    with pytest.raises(InputError, match="mtmr"):
        load_arm("psm", calibration="mtmr")


@recorded
def test_the_recorded_psm_is_predicted() -> None:
    found = predict(RECORDINGS / "psm_one_results.csv.gz", "psm").score.relative_rms_percent
    goals = (5.0, 16.0, 17.0, 10.0, 12.0, 13.0, 13.0)
    assert all(v is not None and v < g for v, g in zip(found.values(), goals, strict=True))


@recorded
@pytest.mark.parametrize("grams", [105, 205])
def test_a_weight_on_the_arm_is_predicted_without_a_new_fit(grams: int) -> None:
    file = RECORDINGS / f"psm_one_{grams}_grams_parallel_results.csv.gz"
    known = [Weight(1e-3 * grams, "pitch_top", (0.351, 0.02, 0.0))]
    with_it, without = (predict(file, weights=w).score.relative_rms_percent for w in (known, []))
    for column, goal in (("yaw", 6.0), ("pitch", 12.0)):
        predicted, ignored = with_it[column], without[column]
        assert predicted is not None and ignored is not None
        assert predicted < min(goal, 0.8 * ignored)


@recorded
def test_a_bag_without_the_jaw_identifies_the_other_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("clarabel", reason="clarabel is not installed: trocar[identify]")
    motions = pytest.importorskip("tests.robot.follow.motions", reason="rosbags is not installed")
    log = read_motion(RECORDINGS / "psm_one_no_weight_results.csv.gz", load_arm("psm"))
    rows = [
        (k / log.rate_hz, "/PSM1/measured_js", log.q[k, :6], log.qd[k, :6], log.effort[k, :6])
        for k in range(len(log.q))
    ]
    bag = motions.write(tmp_path / "psm.bag", "ros1", rows)
    words = ["identify", str(bag), "--arm", "psm", "-o", str(tmp_path / "own.toml"), "--json"]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document["kept_as_described"]) == ["jaw"]
    *found, jaw = document["logs"][0]["relative_rms_percent"].values()
    # Source: the roadmap's figures for a bag without a jaw
    assert all(v < goal for v, goal in zip(found, (12, 24, 13, 33, 20, 30), strict=True))
    assert jaw is None
