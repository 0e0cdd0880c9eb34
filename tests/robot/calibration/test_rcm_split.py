"""The parts into which the difference between a measured and a described remote centre is split."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import ArmDescription, load_arm
from trocar.robot.calibration import Calibration, Tracks, calibrate
from trocar.robot.calibration.rcm import Split, Table7, centre_links, find_rcm, own_centre
from trocar.robot.calibration.report import centre_parts
from trocar.robot.calibration.robot import calibrated, lengths_only
from trocar.robot.mocap import MarkerNoise, MocapSettings, perturbed, simulate_tracks, worn
from trocar.robot.mocap.simulate import spoil

SETTINGS = MocapSettings("kinematic", "both", 8.0, 0.6, 30.0, MarkerNoise(), 3)


def calibration(real: ArmDescription, noise: MarkerNoise | None = None) -> Calibration:
    made = simulate_tracks(real, replace(SETTINGS, noise=noise or MarkerNoise()))
    tracks = Tracks("x", "", made.times, made.poses, made.rate_hz)
    return calibrate(tracks, load_arm(real.name), closure="general")


def split(real: ArmDescription, noise: MarkerNoise | None = None) -> tuple[Split, Table7]:
    found = calibration(real, noise)
    assert found.centre is not None
    report = found.centre
    assert report.table7 is not None
    return centre_parts(found, report, load_arm(real.name)), report.table7


def rms(cloud: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(cloud**2, axis=1))))


ARMS = ["psm", pytest.param("ecm", marks=pytest.mark.slow)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
def test_the_parts_add_up(name: str) -> None:
    arm = worn(load_arm(name), np.random.default_rng(2))
    parts, seen = split(arm, MarkerNoise(1e-4, 8.7e-4))
    np.testing.assert_allclose(sum(parts.place.values()), seen.position, atol=1e-12)
    np.testing.assert_allclose(sum(parts.clouds.values()), parts.cloud, atol=1e-12)
    left = np.mean(parts.clouds["left"] ** 2, axis=0)
    known = left > parts.noise**2
    np.testing.assert_allclose((parts.unexplained**2 + parts.noise**2)[known], left[known])
    # Wear is seen through the noise: little of it is left.
    assert rms(parts.own.cloud) > 1e-4
    assert np.linalg.norm(parts.unexplained) < 0.5 * rms(parts.own.cloud)
    assert (seen.frame.position > 0.0).all() and (seen.frame.spread > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("equal", [True, False])
def test_links_of_other_lengths_leave_nothing_to_the_axes(name: str, equal: bool) -> None:
    arm, rng = load_arm(name), np.random.default_rng(5)
    parts, _ = split(perturbed(arm, rng) if equal else worn(arm, rng, 3e-4, 0.0))
    assert np.linalg.norm(parts.place["lengths"]) > 5e-4
    assert (rms(parts.clouds["lengths"]) > 1e-4) is not equal
    for place, cloud in zip(list(parts.place.values())[2:], list(parts.clouds.values())[1:],
                            strict=True):  # fmt: skip
        assert np.linalg.norm(place) < 3e-7
        assert rms(cloud) < 3e-7


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_leaning_axes_alone_leave_nothing_to_the_lengths(name: str) -> None:
    arm = load_arm(name)
    found = calibration(arm)
    linkage, rng = found.refined.robot.linkage, np.random.default_rng(6)
    lean = {h.name: rng.uniform(-1e-3, 1e-3, 2) for h in linkage.hinges if not h.closure}
    leaning = replace(found.refined.robot, moved=0.0 * found.refined.robot.moved, tilts=lean)
    found = replace(found, refined=replace(found.refined, robot=leaning))
    q = np.stack(np.meshgrid([-0.5, 0.0, 0.5], [-0.4, 0.1, 0.6]), axis=-1).reshape(-1, 2)
    links = centre_links(arm)
    drawn = own_centre(arm.mechanism, links, q)
    straight = own_centre(lengths_only(found.refined.robot, arm, None), links, q)
    np.testing.assert_allclose(straight.position, drawn.position, atol=1e-9)
    assert rms(straight.cloud) < 1e-9
    # while the lean itself is there
    before = [frame.before for frame in arm.mechanism.frames]
    after = [frame.before for frame in calibrated(arm, leaning, None).frames]
    assert max(np.abs(a - b).max() for a, b in zip(after, before, strict=True)) > 5e-4


def seen(body: str, seed: int) -> Table7:
    """Return Table 7 of a PSM one of whose bodies is measured with noise."""
    made = simulate_tracks(load_arm("psm"), SETTINGS)
    poses = dict(made.poses)
    poses[body] = spoil(poses[body], MarkerNoise(1e-4, 8.7e-4), np.random.default_rng(seed))
    found = find_rcm(Tracks("x", "", made.times, poses, made.rate_hz), load_arm("psm")).table7
    assert found is not None
    return found


def test_the_frame_s_error_is_that_of_its_axes_and_the_centre_s_that_of_the_body() -> None:
    centre = seen("psm_pitch_end", 1)
    assert centre.frame.position.max() < 1e-3 * centre.centre_sigma.min()
    np.testing.assert_allclose(centre.sigma, centre.centre_sigma, rtol=1e-3)
    axis = seen("psm_pitch_back", 1)
    assert axis.centre_sigma.max() < 1e-3 * axis.frame.position.max()
    np.testing.assert_allclose(axis.sigma, axis.frame.position, rtol=1e-3, atol=1e-9)


@pytest.mark.slow
def test_the_frame_s_error_is_as_large_as_takes_scatter() -> None:
    takes = [seen("psm_pitch_back", seed) for seed in range(30)]
    scatter = np.std([take.position for take in takes], axis=0)
    told = np.mean([take.frame.position for take in takes], axis=0)
    shown = told > 1e-7
    assert shown.any()
    # 30 takes tell a deviation to 13 %; three times that.
    np.testing.assert_allclose(scatter[shown], told[shown], rtol=0.4)
