"""The remote centre in tracks: the centre, its cloud, Table 7, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError, TracksError, UndeterminedError
from trocar.robot.calibration.rcm import about_hinges, centre_links, find_rcm
from trocar.robot.calibration.tracks import Tracks
from trocar.robot.mocap import MarkerNoise, MocapSettings, perturbed, simulate_tracks

NOISE = MarkerNoise(1e-4, np.radians(0.05))
QUICK = MocapSettings(motion="kinematic", duration_s=12.0, rate_hz=60.0)


def told(simulated, *without) -> Tracks:
    poses = {body: T for body, T in simulated.poses.items() if body not in without}
    return Tracks("simulated", "0", simulated.times, poses, simulated.rate_hz)


@pytest.fixture(scope="module", params=["psm", "ecm"])
def exact(request):
    """An arm that is not as drawn, seen without noise."""
    arm = perturbed(load_arm(request.param), np.random.default_rng(2))
    return arm, simulate_tracks(arm, replace(QUICK, seed=4))


@pytest.fixture(scope="module")
def noisy():
    arm = load_arm("psm")
    return arm, simulate_tracks(arm, replace(QUICK, noise=replace(NOISE, outliers=0.01), seed=5))


def test_the_centre_of_an_arm_not_as_drawn_is_found_to_rounding(exact):
    arm, simulated = exact
    report = find_rcm(told(simulated), arm)
    truth = simulated.truth["rcm"]
    assert report.fit.post == pytest.approx(truth["position_in_base_body_m"], abs=1e-12)
    assert report.distance is not None
    assert report.distance.value == pytest.approx(truth["distance_to_pitch_axis_m"], abs=1e-12)
    assert report.fit.rms < 1e-12 and report.warnings == ()


@pytest.mark.parametrize(("name", "place"), [("psm", (0, -0.516, 0)), ("ecm", (0.3404, 0, 0))])
def test_table_7_of_a_drawn_arm_has_the_paper_s_place(name, place):
    # Source: closed-loop paper, Tables 4, 5 and 7: 516 mm on the PSM, 340.4 mm on the ECM.
    arm = load_arm(name)
    report = find_rcm(told(simulate_tracks(arm, QUICK)), arm)
    assert report.table7 is not None
    assert report.table7.position == pytest.approx(place, abs=1e-9)
    assert report.table7.rms_axes == pytest.approx([0, 0, 0], abs=1e-12)


def test_yaw_and_pitch_have_the_signs_and_the_zero_of_the_joints(exact):
    arm, simulated = exact
    found = about_hinges(told(simulated), centre_links(arm))
    assert found.q == pytest.approx(simulated.q[:, :2], abs=1e-9)


def test_the_cloud_lies_about_the_centre_and_covers_the_sweep(noisy):
    arm, simulated = noisy
    report = find_rcm(told(simulated), arm)
    q = np.array([point.q for point in report.cloud])
    assert len(q) > 12 and (np.ptp(q, axis=0) > 0.8).all()
    away = [np.linalg.norm(point.position - report.fit.post) for point in report.cloud]
    expected = [report.noise_rms / np.sqrt(point.samples) for point in report.cloud]
    assert np.mean(np.square(away) / np.square(expected)) == pytest.approx(1.0, abs=0.5)


def test_rounding_does_not_move_samples_to_another_cell_of_the_cloud(exact):
    arm, simulated = exact
    tracks, rng = told(simulated), np.random.default_rng(0)
    again = {b: T * (1.0 + 1e-15 * rng.normal(size=T.shape)) for b, T in tracks.poses.items()}
    one, two = find_rcm(tracks, arm), find_rcm(replace(tracks, poses=again), arm)
    assert [point.samples for point in one.cloud] == [point.samples for point in two.cloud]


def test_rms_is_what_noise_alone_gives_and_the_errors_are_within_their_sigmas(noisy):
    arm, simulated = noisy
    report = find_rcm(told(simulated), arm)
    assert report.fit.rms == pytest.approx(report.noise_rms, rel=0.06)
    assert report.warnings == ()
    off = report.fit.post - simulated.truth["rcm"]["position_in_base_body_m"]
    assert (np.abs(off) < 4 * report.fit.sigma_post).all()
    assert report.table7 is not None
    off = report.table7.position - [0, -0.516, 0]
    assert (np.abs(off) < 4 * report.table7.sigma).all()


def test_a_centre_that_wanders_is_said_to(noisy):
    arm, simulated = noisy
    tracks = told(simulated)
    body = np.array(tracks.poses["psm_pitch_end"])
    body[:, :3, 3] += 0.002 * np.sin(np.outer(tracks.times, [0.5, 0.7, 0.9]))
    report = find_rcm(replace(tracks, poses={**tracks.poses, "psm_pitch_end": body}), arm)
    assert any("the remote centre is not fixed" in words for words in report.warnings)
    assert report.wander_rms > 5e-4
    assert (report.fit.sigma_post > 2 * find_rcm(tracks, arm).fit.sigma_post).all()


def test_mixed_handedness_is_named(noisy):
    arm, simulated = noisy
    tracks = told(simulated)
    poses = {body: np.array(T) for body, T in tracks.poses.items()}
    for T in poses.values():
        T[:, 1, 3] *= -1.0
    report = find_rcm(replace(tracks, poses=poses), arm)
    assert any("the y axis of the positions is mirrored" in words for words in report.warnings)


def test_a_base_that_sways_is_followed(noisy):
    arm, simulated = noisy
    tracks = told(simulated)
    sway = 0.01 * np.sin(tracks.times)
    poses = {body: np.array(T) for body, T in tracks.poses.items()}
    for T in poses.values():
        T[:, 0, 3] += sway
    report = find_rcm(replace(tracks, poses=poses), arm)
    off = report.fit.post - simulated.truth["rcm"]["position_in_base_body_m"]
    assert (np.abs(off) < 4 * report.fit.sigma_post).all()
    assert np.linalg.norm(off) < 2e-4


def test_without_other_bodies_there_is_the_centre_alone_and_it_is_said(noisy):
    arm, simulated = noisy
    lost = ("psm_yaw", "psm_pitch_back")
    report = find_rcm(told(simulated, *lost), arm)
    assert report.table7 is None and report.distance is None and report.cloud == ()
    assert "psm_yaw not tracked" in report.warnings[0]


def test_without_a_neighbour_of_the_pitch_link_the_sense_of_its_axis_is_open(noisy):
    arm, simulated = noisy
    report = find_rcm(told(simulated, "psm_pitch_bottom", "psm_pitch_top"), arm)
    assert report.table7 is not None
    assert abs(report.table7.position[1] + 0.516) < 1e-3
    assert "the direction of the pitch axis is undetermined" in report.warnings[0]


def test_without_a_base_the_cameras_stand_for_it(noisy):
    arm, simulated = noisy
    report = find_rcm(told(simulated, "psm_base"), arm)
    assert report.base == "camera"
    assert "position_in_base_body_m" not in report.as_dict()["rcm"]
    assert "psm_base is not tracked" in report.warnings[0]


def test_pitch_alone_leaves_the_centre_open_along_its_axis(noisy):
    arm, _ = noisy
    simulated = simulate_tracks(arm, replace(QUICK, parts="axes", noise=NOISE))
    with pytest.raises(UndeterminedError, match="one axis only"):
        find_rcm(told(simulated), arm)


def test_the_body_that_turns_about_the_centre_is_needed(noisy):
    arm, simulated = noisy
    with pytest.raises(TracksError, match=r"bodies missing: psm_pitch_end; found: psm_base"):
        find_rcm(told(simulated, "psm_pitch_end"), arm)


def test_bodies_may_be_called_otherwise(noisy):
    arm, simulated = noisy
    tracks = told(simulated)
    named = {f"Rigid Body {k}": T for k, T in enumerate(tracks.poses.values())}
    names = dict(zip(tracks.poses, named, strict=True))
    wanted = {body: names[body] for body in centre_links(arm).all}
    report = find_rcm(replace(tracks, poses=named), arm, wanted)
    assert report.fit.post == pytest.approx(find_rcm(tracks, arm).fit.post, abs=1e-15)
    with pytest.raises(InputError, match=r"got 'psm_elbow'; known: psm_base"):
        find_rcm(tracks, arm, {"psm_elbow": "x"})


def test_an_arm_without_a_remote_centre_is_refused(noisy):
    _, simulated = noisy
    with pytest.raises(InputError, match=r"mtml: has no remote centre"):
        find_rcm(told(simulated), load_arm("mtml"))
