"""How far a remote centre is told to wander is how far it does, noise or not."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from trocar.apps.calibration import Tracks
from trocar.apps.calibration.rcm import RcmReport, find_rcm
from trocar.apps.mocap import MocapSettings, Noise, SimulatedTracks, simulate_tracks, worn
from trocar.apps.mocap.simulate import spoil
from trocar.descriptions import load_arm

POSITION, ROTATION = 1e-4, float(np.deg2rad(0.05))
ROBOTS = [("psm", 0), ("psm", 1), ("psm", 2), ("ecm", 0), ("ecm", 4)]


@functools.cache
def made(name: str, seed: int) -> SimulatedTracks:
    """Return exact tracks of a worn robot: 2 s of rest, then 6 s about the remote centre."""
    robot = worn(load_arm(name), np.random.default_rng(seed))
    return simulate_tracks(robot, MocapSettings("kinematic", "rcm", 8.0, 0.6, 120.0, Noise(), seed))


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
    noise = Noise(POSITION, ROTATION)
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


def test_a_rest_before_the_swing_does_not_make_the_wander_less() -> None:
    exact = made("psm", 0)
    rested = {
        body: np.concatenate([T[:1].repeat(1200, axis=0), T]) for body, T in exact.poses.items()
    }
    times = np.arange(len(exact.times) + 1200) / exact.rate_hz
    found = find_rcm(Tracks("x", "", times, rested, exact.rate_hz), load_arm("psm"))
    assert found.wander_rms == pytest.approx(told("psm", exact.poses).wander_rms, rel=0.01)


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
