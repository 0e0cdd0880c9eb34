"""How near a calibration comes under noise, pooled over robots; whether its sigmas are honest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from trocar.apps.calibration import Tracks, calibrate
from trocar.apps.calibration.axes import distances, measure_axes
from trocar.apps.calibration.linkage import linkage
from trocar.apps.mocap import MocapSettings, Noise, perturbed, simulate_tracks
from trocar.apps.mocap.noise import spoil
from trocar.descriptions import load_arm
from trocar.geometry.se3 import exp_twist
from trocar.kinematics.estimation import fit_pivot_in_body

pytestmark = pytest.mark.slow

ROBOTS = 20
POSITION, ROTATION = 1e-4, float(np.deg2rad(0.05))


@dataclass(frozen=True)
class Errors:
    """Errors of each kind, and the same over their own standard deviations."""

    distances: np.ndarray
    closed: np.ndarray
    betas: np.ndarray
    centre: np.ndarray
    scaled: np.ndarray


def errors(dropout: float, outliers: float) -> Errors:
    arm = load_arm("psm")
    noise = Noise(POSITION, ROTATION, dropout, outliers)
    found: dict[str, list[float]] = {name: [] for name in Errors.__dataclass_fields__}
    for seed in range(ROBOTS):
        made = simulate_tracks(
            perturbed(arm, np.random.default_rng(seed)),
            MocapSettings("kinematic", "both", 24.0, 0.6, 120.0, noise, seed),
        )
        got = calibrate(Tracks("x", "", made.times, made.poses, made.rate_hz), arm)
        truth = made.truth
        for label, value in got.axis_distances.items():
            off = value.value - truth["axis_distances_m"][label]
            found["distances"].append(off)
            found["scaled"].append(off / value.sigma)
            found["closed"].append(got.closed_distances[label] - truth["axis_distances_m"][label])
        found["betas"] += [v.value - truth["beta_rad"][k] for k, v in got.betas.items()]
        if got.centre is not None:
            fit = got.centre.report.fit
            off = fit.post - np.array(truth["rcm"]["position_in_base_body_m"])
            found["centre"].append(float(np.linalg.norm(off)))
    return Errors(**{name: np.abs(values) for name, values in found.items()})


@pytest.mark.parametrize(
    # Source: the figures to reach.
    ("amplitude", "median", "most"),
    [(0.3, 18e-6, 70e-6), (0.8, 6e-6, 22e-6)],
)
def test_axes_come_within_their_figures(amplitude: float, median: float, most: float) -> None:
    arm = load_arm("psm")
    loops, plan, off = linkage(arm), arm.calibration, []
    assert plan is not None
    pairs = {f"{a}-{b}": (plan.axes[a], plan.axes[b]) for a, b in plan.distances}
    for seed in range(ROBOTS):
        made = simulate_tracks(
            perturbed(arm, np.random.default_rng(seed)),
            # The whole take of `trocar mocap`: 24 s of each part, of which both sweep the pitch.
            MocapSettings(
                "kinematic", "both", 24.0, amplitude, 120.0, Noise(POSITION, ROTATION), seed
            ),
        )
        tracks = Tracks("x", "", made.times, made.poses, made.rate_hz)
        got = distances(measure_axes(tracks, loops), pairs)
        off += [value.value - made.truth["axis_distances_m"][k] for k, value in got.items()]
    assert len(off) == 8 * ROBOTS
    assert np.median(np.abs(off)) <= median and np.quantile(np.abs(off), 0.95) <= most


@pytest.mark.parametrize(("dropout", "outliers"), [(0.0, 0.0), (0.05, 0.01)])
def test_all_figures_hold_with_lost_bodies_and_gross_errors(
    dropout: float, outliers: float
) -> None:
    got = errors(dropout, outliers)
    assert np.median(got.distances) <= 8e-6 and np.quantile(got.distances, 0.95) <= 32e-6
    assert np.rad2deg(np.quantile(got.betas, 0.95)) <= 15e-3
    assert np.median(got.centre) <= 16e-6 and np.quantile(got.centre, 0.95) <= 30e-6
    # A closed geometry says each length twice, so it is known better.
    assert np.median(got.closed) < np.median(got.distances)
    # Of 160 distances 1.96 standard deviations cover 92 to 98 % of the truth; the binomial spread
    # of the count comes on top.
    assert 0.90 <= np.mean(got.scaled < 1.96) <= 0.995


def test_intervals_of_the_remote_centre_cover_it() -> None:
    within: list[bool] = []
    for seed in range(ROBOTS):
        made = simulate_tracks(
            perturbed(load_arm("psm"), np.random.default_rng(seed)),
            MocapSettings("kinematic", "rcm", 24.0, 0.6, 30.0, Noise(), seed),
        )
        truth = np.array(made.truth["rcm"]["position_in_base_body_m"])
        exact = np.stack([made.poses[name] for name in ("psm_base", "psm_pitch_end")])
        # Half of the time the cart sways, so that the base has to be told in each sample.
        sway = np.outer(np.sin(0.7 * made.times), [0.01, 0.02, 0.005, 0.006, 0.02, 0.01])
        rng = np.random.default_rng(seed)
        for draw in range(15):
            seen = exact if draw % 2 else exp_twist(sway) @ exact
            base, body = (
                spoil(poses, Noise(POSITION, ROTATION, 0.05, 0.01), rng) for poses in seen
            )
            fit = fit_pivot_in_body(base, body)
            within += (np.abs(fit.post - truth) < 1.96 * fit.sigma_post).tolist()
    # Source: 92 to 98 % is asked for. 900 numbers scatter by 0.7 % (binomial) and, as the three of
    # one fit go together a little, by 0.8 %; the 60 of one draw of 20 robots would by 3 %.
    assert len(within) == 900
    assert 0.92 <= np.mean(within) <= 0.98
