"""How far a remote centre is told to wander is how far it does, noise or not."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trocar.descriptions import ArmDescription, load_arm
from trocar.kinematics import poses
from trocar.robot.calibration import Tracks
from trocar.robot.calibration.rcm import RcmReport, find_rcm
from trocar.robot.mocap import (
    MarkerNoise,
    MocapSettings,
    SimulatedTracks,
    broken,
    perturbed,
    simulate_tracks,
    worn,
)
from trocar.robot.mocap.simulate import spoil

POSITION, ROTATION = 1e-4, float(np.deg2rad(0.05))
ROBOTS = [("psm", 0), ("psm", 1), ("psm", 2), ("ecm", 0), ("ecm", 4)]


@functools.cache
def made(name: str, seed: int) -> SimulatedTracks:
    """Return exact tracks of a worn robot: 2 s of rest, then 6 s about the remote centre."""
    robot = worn(load_arm(name), np.random.default_rng(seed))
    return simulate_tracks(
        robot, MocapSettings("kinematic", "rcm", 8.0, 0.6, 120.0, MarkerNoise(), seed)
    )


def told(name: str, poses: Mapping[str, Any]) -> RcmReport:
    exact = made(name, 0)
    return find_rcm(Tracks("x", "", exact.times, dict(poses), exact.rate_hz), load_arm(name))


def truth(name: str, seed: int) -> float:
    return float(made(name, seed).truth["rcm"]["rms_m"])


@pytest.mark.parametrize(("name", "seed"), ROBOTS)
def test_exact_tracks_tell_all_of_the_wander(name: str, seed: int) -> None:
    found = told(name, made(name, seed).poses)
    # the swing's first tenths of a second count for the rest before it
    assert found.wander_rms == pytest.approx(truth(name, seed), rel=0.01)
    assert found.fit.outliers == 0


@pytest.mark.parametrize(("name", "seed"), ROBOTS)
def test_noise_is_told_from_the_wander(name: str, seed: int) -> None:
    rng, exact = np.random.default_rng(seed), made(name, seed)
    noise = MarkerNoise(POSITION, ROTATION)
    found = told(name, {body: spoil(T, noise, rng) for body, T in exact.poses.items()})
    assert found.noise_rms > 2e-4  # of the wander's own size
    assert found.wander_rms == pytest.approx(truth(name, seed), rel=0.05)


@pytest.mark.parametrize(("name", "seed"), ROBOTS)
@pytest.mark.parametrize("turned", [False, True])
def test_gross_outliers_of_20_mm_are_left_out_and_the_wander_is_not(
    name: str, seed: int, turned: bool
) -> None:
    rng, exact = np.random.default_rng(seed), made(name, seed)
    poses = {body: T.copy() for body, T in exact.poses.items()}
    body = poses[f"{name}_pitch_end"]
    wrong = rng.choice(np.arange(260, len(body)), len(body) // 100, replace=False)  # of the swing
    away = rng.normal(size=(len(wrong), 3))
    body[wrong, :3, 3] += 0.02 * away / np.linalg.norm(away, axis=1, keepdims=True)
    if turned:
        body[wrong, :3, :3] = np.linalg.qr(rng.normal(size=(len(wrong), 3, 3)))[0]
        body[wrong, :3, :3] *= np.linalg.det(body[wrong, :3, :3])[:, None, None]
    found = told(name, poses)
    assert not found.fit.used[wrong].any()
    assert found.fit.outliers == len(wrong)
    assert found.wander_rms == pytest.approx(truth(name, seed), rel=0.02)


@pytest.mark.slow
def test_a_rest_before_the_swing_does_not_make_the_wander_less() -> None:
    exact = made("psm", 0)
    rested = {
        body: np.concatenate([T[:1].repeat(1200, axis=0), T]) for body, T in exact.poses.items()
    }
    times = np.arange(len(exact.times) + 1200) / exact.rate_hz
    found = find_rcm(Tracks("x", "", times, rested, exact.rate_hz), load_arm("psm"))
    assert found.wander_rms == pytest.approx(told("psm", exact.poses).wander_rms, rel=0.01)


@pytest.mark.slow
def test_the_centre_of_table_7_is_told_at_yaw_0_wherever_the_arm_swings() -> None:
    exact = made("psm", 0)  # its centre is a millimetre off the yaw axis
    found = told("psm", exact.poses).table7
    # without the rest the zero is in the middle of the swing, which is there, too
    moving = {body: T[230:] for body, T in exact.poses.items()}
    other = find_rcm(
        Tracks("x", "", exact.times[230:], moving, exact.rate_hz), load_arm("psm")
    ).table7
    assert found is not None and other is not None
    assert abs(found.position[0]) > 2e-4
    np.testing.assert_allclose(found.position, other.position, atol=5e-6)


@functools.cache
def broken_robot(name: str, seed: int) -> ArmDescription:
    rng = np.random.default_rng(seed)
    return broken(perturbed(load_arm(name), rng), rng, 1e-3)


def seen(name: str, seed: int, noise: MarkerNoise) -> tuple[SimulatedTracks, RcmReport]:
    """Return the whole take of a robot whose loops are broken by 1 mm, and its centre."""
    settings = MocapSettings("kinematic", "both", 24.0, 0.6, 30.0, noise, seed)
    tracks = simulate_tracks(broken_robot(name, seed), settings)
    taken = Tracks("x", "", tracks.times, tracks.poses, tracks.rate_hz)
    return tracks, find_rcm(taken, load_arm(name))


def true_curve(name: str, seed: int, made: SimulatedTracks, pitch: np.ndarray) -> np.ndarray:
    """Return how a robot misses the point of smallest error, in its base body at yaw 0, (g, 3)."""
    arm, bodies = broken_robot(name, seed), made.truth["bodies"]
    end, base = (np.array(bodies[f"{name}_{b}"]["T_link_body"]) for b in ("pitch_end", "base"))
    frame, begin = bodies[f"{name}_pitch_end"]["frame"], made.truth["parts_s"]["rcm"][0]

    def body(q: np.ndarray) -> np.ndarray:
        return np.linalg.inv(base) @ poses(arm.mechanism, q, arm.root)[frame] @ end

    at = body(made.q[made.times >= begin])
    rows = np.concatenate([at[:, :3, :3], np.tile(-np.eye(3), (len(at), 1, 1))], axis=2)
    tip, post = np.split(np.linalg.lstsq(rows.reshape(-1, 6), -at[:, :3, 3].ravel())[0], 2)
    q = np.tile(made.q[0], (len(pitch), 1))
    q[:, 0], q[:, 1] = 0.0, pitch
    at = body(q)
    return at[:, :3, :3] @ tip + at[:, :3, 3] - post


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_exact_tracks_of_broken_loops_give_the_point_of_smallest_error_and_its_curve(
    name: str,
) -> None:
    made, report = seen(name, 1, MarkerNoise())
    assert report.wander is not None and report.fit.rms > 5e-4
    place = np.array(made.truth["rcm"]["position_in_base_body_m"])
    # The truth is that of 400 samples of the sweep, weighted as they lie in time.
    assert np.linalg.norm(report.fit.post - place) < 5e-6
    curve = true_curve(name, 1, made, report.wander.q)
    assert np.abs(report.wander.curve - curve).max() < 1e-5
    assert np.abs(curve).max() > 5e-4


@pytest.mark.slow
def test_intervals_of_a_wandering_centre_and_of_its_curve_cover_them() -> None:
    noise = MarkerNoise(0.5 * POSITION, 0.5 * ROTATION)
    places, curves, errors = [], [], []
    for name in ("psm", "ecm"):
        for seed in range(20):
            made, report = seen(name, seed, noise)
            assert report.wander is not None
            off = report.fit.post - made.truth["rcm"]["position_in_base_body_m"]
            errors.append(float(np.linalg.norm(off)))
            places.append(np.abs(off) < 1.96 * report.fit.sigma_post)
            curve = report.wander.curve - true_curve(name, seed, made, report.wander.q)
            curves.append(np.abs(curve) < 1.96 * report.wander.sigma)
    # Source: 92 % is asked for; the 120 numbers of the places scatter by 2 %.
    assert np.mean(places) >= 0.90 and np.mean(curves) >= 0.90
    assert np.median(errors) < 2e-5


@pytest.mark.slow
def test_slow_noise_is_no_wander_and_widens_the_intervals() -> None:
    settings = MocapSettings("kinematic", "both", 24.0, 0.6, 30.0, MarkerNoise(), 3)
    slow, white = (
        find_rcm(Tracks("x", "", made.times, made.poses, 30.0), load_arm("psm"))
        for noise in (
            MarkerNoise(POSITION, ROTATION, correlation_s=0.8),
            MarkerNoise(POSITION, ROTATION),
        )
        for made in [simulate_tracks(load_arm("psm"), replace(settings, noise=noise))]
    )
    assert slow.wander is None and white.wander is None
    assert any("correlated in time" in text for text in slow.warnings)
    assert not white.warnings
    assert (slow.fit.sigma_post > 4.0 * white.fit.sigma_post).all()
