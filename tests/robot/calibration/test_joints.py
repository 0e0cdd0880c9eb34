"""Setup joints, masters and serial arms from tracks: each axis of the chain and the next."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import apply_overlay
from trocar.errors import FarFromNominalError, InputError, LabelsError, TracksError
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.robot.calibration import JointsCalibration, Tracks, calibrate, calibrate_joints
from trocar.robot.mocap import MarkerNoise, MocapSettings, perturbed, simulate_tracks
from trocar.robot.verification.unseen_robots import last_link

NOISE = MarkerNoise(1e-4, float(np.radians(0.05)))


@cache
def take(name: str, seed: int, noise: MarkerNoise | None = None, rate_hz: float = 30.0):
    """Return the robot, its tracks and the truth."""
    robot = perturbed(load_arm(name), np.random.default_rng(seed))
    settings = MocapSettings("kinematic", noise=noise or MarkerNoise(), seed=seed, rate_hz=rate_hz)
    made = simulate_tracks(robot, settings)
    return robot, Tracks("x.csv", "", made.times, made.poses, made.rate_hz), made.truth["joints"]


@cache
def measured(name: str, tracks: Tracks) -> JointsCalibration:
    arm = load_arm(name)
    return calibrate_joints(tracks, arm, calibrate(tracks, arm) if arm.mechanism.closures else None)


def errors(found: JointsCalibration, truth) -> list[tuple[float, float]]:
    """Return (error, sigma) of every figure."""
    both = ((found.distances, truth["distances_m"]), (found.angles, truth["angles_rad"]))
    return [(v.value - drawn[k], v.sigma) for values, drawn in both for k, v in values.items()]


@pytest.mark.parametrize("name", ["suj_psm1", "suj_ecm", "mtml", "psm_si"])
def test_exact_tracks_give_the_robot(name: str):
    robot, tracks, truth = take(name, 3)
    found = measured(name, tracks)
    assert max(abs(error) for error, _ in errors(found, truth)) < 1e-9
    mine = apply_overlay(load_arm(name), found.overlay)
    assert last_link(load_arm(name), robot) > 1e-3
    assert last_link(mine, robot) < 1e-8


def test_exact_tracks_of_an_endoscope_arm_of_an_si_give_it_to_micrometres():
    robot, tracks, truth = take("ecm_si", 3)
    found = measured("ecm_si", tracks)
    assert max(abs(error) for error, _ in errors(found, truth)) < 1e-9
    mine = apply_overlay(load_arm("ecm_si"), found.overlay)
    # where the axis of a slide lies is not seen
    assert last_link(mine, robot) < 1e-5 < 1e-3 < last_link(load_arm("ecm_si"), robot)


def test_noise_is_within_its_intervals_and_the_tip_ten_times_nearer():
    noise = replace(NOISE, dropout=0.05, outliers=0.01)
    robot, tracks, truth = take("suj_psm1", 1, noise)
    found = measured("suj_psm1", tracks)
    assert all(abs(error) < 4.0 * sigma for error, sigma in errors(found, truth))
    mine = apply_overlay(load_arm("suj_psm1"), found.overlay)
    assert last_link(mine, robot) < 0.1 * last_link(load_arm("suj_psm1"), robot)
    patch = found.overlay.frames["suj_3"]
    assert patch.xyz_sigma is not None and 1e-6 < patch.xyz_sigma.max() < 1e-3
    assert all(outliers > 0 for *_, outliers in found.residuals.values())


@pytest.mark.slow
def test_intervals_hold_for_robots_with_lost_and_wrong_samples():
    noise = replace(NOISE, dropout=0.05, outliers=0.01)
    scaled = [
        error / sigma
        for name in ("suj_psm1", "suj_ecm")
        for seed in range(20)
        for error, sigma in errors(measured(name, take(name, seed, noise, 30.0)[1]),
                                   take(name, seed, noise, 30.0)[2])
    ]  # fmt: skip
    assert 0.92 <= np.mean(np.abs(scaled) < 1.96) <= 0.98


def test_a_master_s_loop_stays_closed():
    _, tracks, _ = take("mtml", 3)
    found = measured("mtml", tracks)
    mine = apply_overlay(load_arm("mtml"), found.overlay)
    assert loops_are_parallelograms(mine.mechanism)
    assert {"shoulder_pitch", "wrist_platform", "wrist_roll"} <= set(found.overlay.frames)


def test_exchanged_labels_are_named():
    _, tracks, _ = take("suj_psm1", 3, NOISE)
    names = ("suj_psm1_suj_3", "suj_psm1_suj_4")
    swapped = dict(tracks.poses)
    swapped[names[0]], swapped[names[1]] = swapped[names[1]], swapped[names[0]]
    with pytest.raises(LabelsError, match="suj_psm1_suj_3 and suj_psm1_suj_4 are exchanged"):
        measured("suj_psm1", replace(tracks, poses=swapped))


def test_a_chain_of_another_length_is_refused():
    _, tracks, _ = take("suj_psm1", 3)
    larger = {}
    for body, T in tracks.poses.items():
        larger[body] = T.copy()
        larger[body][:, :3, 3] *= 1.1
    with pytest.raises(FarFromNominalError, match=r"suj_2-suj_3 47\d\.\d mm .*within 10 mm"):
        measured("suj_psm1", replace(tracks, poses=larger))


@pytest.mark.slow
def test_sweeps_that_begin_the_wrong_way_and_starts_without_rest_are_refused():
    _, tracks, _ = take("suj_psm1", 3)
    rest = tracks.times < 2.0
    back = np.concatenate([np.flatnonzero(rest), np.flatnonzero(~rest)[::-1]])
    reversed_ = {body: T[back] for body, T in tracks.poses.items()}
    with pytest.raises(TracksError, match="begin towards positive joint positions"):
        measured("suj_psm1", replace(tracks, poses=reversed_))
    late = {body: T[~rest] for body, T in tracks.poses.items()}
    with pytest.raises(TracksError, match="does not rest at the start"):
        measured("suj_psm1", replace(tracks, times=tracks.times[~rest], poses=late))


def test_joints_that_hardly_move_are_refused():
    _, tracks, _ = take("suj_psm1", 3)
    begun = tracks.times > 2.5  # the column has risen a little
    still = {body: np.where(begun[:, None, None], T[begun][0], T)
             for body, T in tracks.poses.items()}  # fmt: skip
    with pytest.raises(InputError, match=r"suj_1 .*was swept by .* m; allowed: 0\.02 m or more"):
        measured("suj_psm1", replace(tracks, poses=still))
