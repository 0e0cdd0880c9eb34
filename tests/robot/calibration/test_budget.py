"""An error budget foretells, without noise, how calibrations scatter that have it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.fitting import fit_pivot_in_body
from trocar.robot.calibration import Tracks
from trocar.robot.calibration.axes import betas, distances, find_datum, find_home, measure_axes
from trocar.robot.calibration.budget import Budget, error_budget, expected_sigma, pose_noise
from trocar.robot.calibration.linkage import linkage
from trocar.robot.calibration.selection import planned_figures
from trocar.robot.mocap import MarkerNoise, MocapSettings, SimulatedTracks, simulate_tracks
from trocar.robot.mocap.simulate import Parts, spoil

POSE = (1e-4, float(np.radians(0.05)))
RATE_HZ = 20.0


@cache
def motion(parts: Parts = "axes") -> SimulatedTracks:
    return simulate_tracks(
        load_arm("psm"), MocapSettings("kinematic", parts, 8.0, 0.6, RATE_HZ, MarkerNoise(), 2)
    )


def tracks(seed: int | None = None, parts: Parts = "axes") -> Tracks:
    """Return tracks without noise, or with that of a seed."""
    made, poses = motion(parts), motion(parts).poses
    if seed is not None:
        rng = np.random.default_rng(seed)
        poses = {body: spoil(T, MarkerNoise(*POSE), rng) for body, T in poses.items()}
    return Tracks("x", "", made.times, poses, made.rate_hz)


@pytest.mark.slow
def test_axes_and_angles_scatter_as_foretold() -> None:
    psm, trials = load_arm("psm"), 20
    loops, (pairs, lines) = linkage(psm), planned_figures(psm)
    told, truth = expected_sigma(tracks(), psm, POSE), motion().truth
    off: list[list[float]] = []
    for seed in range(trials):
        axes, home = find_home(tracks(seed), measure_axes(tracks(seed), loops))
        found = distances(axes, pairs)
        angles = betas(axes, home, lines, find_datum(axes, home, None).at_home)
        off.append([
            *((v.value - truth["axis_distances_m"][k]) / told[f"distance {k}"]
              for k, v in found.items()),
            *((v.value - truth["beta_rad"][k]) / told[k] for k, v in angles.items()),
        ])  # fmt: skip
    assert np.shape(off) == (trials, 10)
    # 200 errors over their sigmas, of which some share noise: chi-squared within 4 of its sigmas
    # were they 100 independent ones
    assert np.mean(np.square(off)) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 100.0))
    # and each figure by itself
    each = np.sqrt(np.mean(np.square(off), axis=0))
    assert each.min() > 0.55  # chi of 20 trials: 1 in 1000 is below 0.55 or above 1.5
    assert each.max() < 1.5


def test_a_remote_centre_scatters_as_foretold() -> None:
    psm, trials = load_arm("psm"), 40
    told = expected_sigma(tracks(parts="rcm"), psm, POSE)["remote centre"]
    true = motion("rcm").truth["rcm"]["position_in_base_body_m"]
    squares: list[float] = []
    for seed in range(trials):
        poses = tracks(seed, "rcm").poses
        moving = poses["psm_pitch_end"].copy()
        moving[: round(2.0 * RATE_HZ)] = np.nan  # the still start
        found = fit_pivot_in_body(poses["psm_base"], moving)
        squares.append(float(np.sum((found.post - true) ** 2)))
    # three unequal coordinates in each trial: a relative deviation of at most sqrt(2 / 40)
    assert np.mean(squares) == pytest.approx(told**2, rel=3.0 * np.sqrt(2.0 / trials))


def test_sigmas_follow_noise_and_samples() -> None:
    psm, sweeps = load_arm("psm"), {"pitch": (2.0, 8.0)}
    one = error_budget(tracks(), psm, POSE, sweeps, 20.0)
    fast = error_budget(tracks(), psm, POSE, sweeps, 80.0)
    worse = error_budget(tracks(), psm, (2.0 * POSE[0], 2.0 * POSE[1]), sweeps, 20.0)
    for name, sigma in one.sigma.items():
        assert fast.sigma[name] == pytest.approx(0.5 * sigma)
        assert worse.sigma[name] == pytest.approx(2.0 * sigma, rel=1e-3)
        # all but the still start twice: between the same and a root of two less
        assert sigma / np.sqrt(2.0) <= one.doubled["pitch"][name] < sigma


def test_the_sweep_that_helps_most_is_named() -> None:
    doubled = {"pitch": {"a": 3.0, "b": 1.0}, "yaw": {"a": 2.0, "b": 2.0}}
    found = Budget("psm", POSE, 30.0, {}, {"a": 4.0, "b": 3.0}, doubled)
    assert (found.sweep_longer("a"), found.sweep_longer("b")) == ("yaw", "pitch")
    assert found.as_dict()["sweep_longer"] == {"a": "yaw", "b": "pitch"}


def test_a_joint_of_many_is_named_on_an_mtm() -> None:
    mtm = load_arm("mtmr")
    made = simulate_tracks(mtm, MocapSettings("kinematic", "axes", 12.0, 0.5, 20.0))
    seen = Tracks("x", "", made.times, made.poses, made.rate_hz)
    found = error_budget(seen, mtm, POSE, made.truth["sweeps_s"], 120.0)
    assert dict(found.seconds) == {"shoulder_pitch": 5.0, "elbow_pitch": 5.0}
    assert found.sweep_longer("distance 2-3") == "shoulder_pitch"
    assert found.sweep_longer("distance bar-rod") == "elbow_pitch"


def test_markers_give_the_noise_of_their_pose() -> None:
    noise, spread = 1e-4, 0.06
    markers = spread * np.concatenate([np.eye(3), -np.eye(3)])
    rng = np.random.default_rng(1)
    seen = markers + rng.normal(scale=noise, size=(4000, 6, 3))
    shift = seen.mean(axis=1)
    # small turns: least squares of  seen - markers = turn x markers
    moment = np.cross(markers, seen - shift[:, None]).sum(axis=1)
    turn = moment / (np.sum(markers**2) * 2.0 / 3.0)
    position, rotation = pose_noise(noise, 6, spread)
    assert shift.std() == pytest.approx(position, rel=0.03)
    assert turn.std() == pytest.approx(rotation, rel=0.03)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((1e-4, 2, 0.06), "markers: got 2; allowed: 3 or more"),
        ((0.0, 4, 0.06), "marker noise: got 0 mm; allowed: above 0"),
        ((1e-4, 4, -0.1), "marker spread: got -100 mm; allowed: above 0"),
    ],
)
def test_impossible_clusters_are_refused(values: tuple[float, int, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        pose_noise(*values)
