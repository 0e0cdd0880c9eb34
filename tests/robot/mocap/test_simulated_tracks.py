"""Simulated tracks: the geometry of the paper, rigid clusters, noise as asked for."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.robot.mocap import MarkerNoise, MocapSettings, simulate_tracks, write_tracks
from trocar.robot.mocap.sweep import sweep

QUICK = MocapSettings(motion="kinematic", duration_s=8.0, rate_hz=50.0)

# Source: the mended Tables 4 and 5 (docs/mechanism.md). [m, rad]
DRAWN = {
    "psm": ({"3-4": 0.096, "3-6": 0.150, "4-c1": 0.150, "6-c1": 0.096, "3-7": 0.1842, "6-8": 0.516,
             "7-c2": 0.516, "6-7": 0.0365}, 0.2908, 0.2140),
    "ecm": ({"3-4": 0.03786, "3-6": 0.3047, "4-c1": 0.3047, "6-c1": 0.03786, "3-7": 0.3419,
             "6-8": 0.3404, "7-c2": 0.3404, "6-7": 0.03787}, 0.3448, 0.3229),
}  # fmt: skip


@pytest.mark.parametrize("name", DRAWN)
def test_the_truth_of_a_drawn_arm_is_the_papers(name):
    distances, beta1, beta2 = DRAWN[name]
    truth = simulate_tracks(load_arm(name), QUICK).truth
    assert truth["axis_distances_m"] == pytest.approx(distances, abs=6e-5)
    assert truth["beta_rad"] == pytest.approx({"beta1": beta1, "beta2": beta2}, abs=6e-5)
    assert truth["rcm"]["distance_to_pitch_axis_m"] == pytest.approx(distances["6-8"], abs=1e-9)
    json.dumps(truth)


@pytest.mark.parametrize("name", DRAWN)
def test_the_remote_centre_stays_where_the_truth_has_it_in_the_base_body(name):
    tracks = simulate_tracks(load_arm(name), QUICK)
    base, end = tracks.poses[f"{name}_base"], tracks.poses[f"{name}_pitch_end"]
    centre = base @ np.append(tracks.truth["rcm"]["position_in_base_body_m"], 1.0)
    tip = np.linalg.inv(end) @ centre[..., None]  # fixed in the end link as well
    assert np.ptp(tip[:, :3, 0], axis=0).max() < 1e-12


def test_the_start_is_still_and_the_sweeps_reach_their_amplitude():
    tracks = simulate_tracks(load_arm("psm"), QUICK)
    yaw, pitch = tracks.q[:, 0], tracks.q[:, 1]
    still = tracks.times <= tracks.truth["parts_s"]["still"][1]
    assert tracks.times[still][-1] >= 0.5
    assert not tracks.q[still, :2].any()
    axes = (tracks.times >= 2.0) & (tracks.times <= 8.0)
    assert not yaw[axes].any()
    for part in (pitch[axes], pitch[~axes], yaw[~axes]):
        assert np.abs(part).max() == pytest.approx(0.6, abs=0.01)
    assert np.abs(np.diff(tracks.q, axis=0)).max() < 0.04  # never a jump


def test_a_mechanism_with_one_loop_is_swept_joint_by_joint():
    settings = MocapSettings(motion="kinematic", duration_s=12.0, rate_hz=20.0)
    tracks = simulate_tracks(load_arm("mtml"), settings)
    # Source: the MTM's DH table, arm 0.2794 m; its parallelogram's bar 0.100 m (our own choice).
    assert tracks.truth["axis_distances_m"] == pytest.approx(
        {"2-3": 0.2794, "bar-rod": 0.1, "rod-c1": 0.2794, "3-c1": 0.1}
    )
    with pytest.raises(InputError, match="mtml: has no remote centre"):
        simulate_tracks(load_arm("mtml"), MocapSettings(parts="both"))


def test_noise_is_as_large_as_asked_for_and_nothing_else_changes():
    clean = simulate_tracks(load_arm("psm"), QUICK)
    noise = MarkerNoise(position=1e-4, rotation=1e-3)
    noisy = simulate_tracks(load_arm("psm"), MocapSettings(**{**vars(QUICK), "noise": noise}))
    for body, pose in clean.poses.items():
        off = np.linalg.inv(pose) @ noisy.poses[body]
        turned = np.stack([off[:, 2, 1], off[:, 0, 2], off[:, 1, 0]])
        assert np.std(off[:, :3, 3]) == pytest.approx(1e-4, rel=0.05)
        assert np.std(turned) == pytest.approx(1e-3, rel=0.05)


def test_bodies_are_lost_in_bursts_and_gross_errors_are_20_mm_off():
    clean = simulate_tracks(load_arm("psm"), QUICK)
    noise = MarkerNoise(dropout=0.2, outliers=0.05)
    spoiled = simulate_tracks(load_arm("psm"), MocapSettings(**{**vars(QUICK), "noise": noise}))
    lost = np.stack([np.isnan(pose[:, 0, 0]) for pose in spoiled.poses.values()])
    assert lost.mean() == pytest.approx(0.2, abs=0.08)
    assert lost.sum() / np.diff(lost.astype(int), axis=1).clip(0).sum() > 5.0
    off = np.concatenate([
        np.linalg.norm((spoiled.poses[b] - clean.poses[b])[:, :3, 3], axis=1) for b in clean.poses
    ])  # fmt: skip
    off = off[~np.isnan(off)]
    assert ((off > 0.0199) & (off < 0.0201)).mean() == pytest.approx(0.05, abs=0.02)
    assert ((off < 1e-12) | (off > 0.0199)).all()


@pytest.mark.parametrize("name", DRAWN)
def test_the_simulated_arm_lags_a_little_and_its_loops_hold(name):
    told = MocapSettings(duration_s=8.0, rate_hz=50.0, amplitude=0.3)
    dynamic = simulate_tracks(load_arm(name), told)
    exact = simulate_tracks(load_arm(name), MocapSettings(**{**vars(told), "motion": "kinematic"}))
    end = f"{name}_pitch_end"
    off = np.linalg.norm((dynamic.poses[end] - exact.poses[end])[:, :3, 3], axis=1)
    assert 1e-5 < off.max() < 0.01
    assert off[exact.times < 1.0].max() < 1e-5
    # Opposite sides keep parallel: the bodies of 3 and 8 do not turn in one another.
    driven = f"{name}_pitch_{'back' if name == 'psm' else 'front'}"
    turn = dynamic.poses[driven][:, :3, :3].swapaxes(1, 2) @ dynamic.poses[end][:, :3, :3]
    assert np.ptp(turn, axis=0).max() < 1e-6


def test_the_same_seed_writes_the_same_file_and_nothing_is_left_over(tmp_path):
    noise = MarkerNoise(position=1e-4, rotation=1e-3, dropout=0.05, outliers=0.01)
    settings = MocapSettings(**{**vars(QUICK), "noise": noise, "seed": 3})
    for name in "ab":
        write_tracks(tmp_path / name, simulate_tracks(load_arm("psm"), settings))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    other = simulate_tracks(load_arm("psm"), MocapSettings(**{**vars(settings), "seed": 4}))
    write_tracks(tmp_path / "c", other)
    assert (tmp_path / "a").read_bytes() != (tmp_path / "c").read_bytes()
    assert {p.name for p in tmp_path.iterdir()} == {
        f"{name}{end}" for name in "abc" for end in ("", ".truth.json")
    }


def test_others_may_read_what_is_written_and_a_folder_in_its_place_leaves_nothing(tmp_path):
    tracks = simulate_tracks(load_arm("psm"), QUICK)
    (tmp_path / "plain").write_text("", encoding="utf-8")
    write_tracks(tmp_path / "a.csv", tracks)
    modes = {path.stat().st_mode for path in tmp_path.iterdir()}
    assert len(modes) == 1  # as any file of this user
    (tmp_path / "b.csv").mkdir()
    with pytest.raises(InputError, match=r"b\.csv: cannot be written"):
        write_tracks(tmp_path / "b.csv", tracks)
    assert not list(tmp_path.glob(".*"))
    assert not list(tmp_path.glob("b.csv.*"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"duration_s": 3.0}, "duration: got 3 s; allowed: at least 6 s"),
        ({"amplitude": 0.0}, "amplitude: got 0 rad; allowed: above 0"),
        ({"rate_hz": 5.0}, "rate: got 5; allowed: 10 to 1000 Hz"),
        ({"seed": -1}, "seed: got -1; allowed"),
        ({"motion": "magic"}, "motion: got 'magic'; allowed: dynamic, kinematic"),
        ({"parts": "none"}, "parts: got 'none'; allowed: axes, rcm, both"),
        ({"motion": "dynamic", "duration_s": 6.0, "amplitude": 0.92},
         "pitch would be swept at"),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_used_are_refused(changes, said):
    with pytest.raises(InputError) as refused:
        simulate_tracks(load_arm("psm"), MocapSettings(**{**vars(QUICK), **changes}))
    assert said in str(refused.value)


def test_noise_out_of_range_and_arms_without_loops_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"noise, dropout: got 1.5; allowed: 0 to 0.9"):
        MarkerNoise(dropout=1.5)
    with pytest.raises(InputError, match="has no closed loop"):
        simulate_tracks(load_arm("suj_psm1"), replace(QUICK, parts="axes"))
    with pytest.raises(InputError, match=r'psm: parts: got "chain"; allowed: axes, rcm, both'):
        simulate_tracks(load_arm("psm"), replace(QUICK, parts="chain"))
    tracks = simulate_tracks(load_arm("psm"), QUICK)
    with pytest.raises(InputError, match="cannot be written: No such file or directory"):
        write_tracks(tmp_path / "nowhere" / "a.csv", tracks)
    with pytest.raises(InputError, match="format: got 'c3d'; allowed: tidy, motive"):
        write_tracks(tmp_path / "a.csv", tracks, "c3d")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["psm_si", "ecm_si"])
def test_slides_of_an_si_are_swept_below_their_velocity_limits(name: str) -> None:
    arm, times = load_arm(name), np.linspace(0.0, 100.0, 100001)
    found = sweep(arm, times, 40.0, 0.6, ("chain",))
    speed = np.abs(np.gradient(found.q, times, axis=0)).max(axis=0)
    assert (speed[: len(arm.joints)] <= [joint.velocity_max for joint in arm.joints]).all()
    assert found.swings["chain"]["insertion"] > 0.09
