"""From exact and noisy tracks of robots that are not as drawn back to what they are."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.overlay import apply_overlay, overlay_text, parse_overlay
from trocar.kinematics import poses
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.robot.calibration import Calibration, Tracks, calibrate, read_tracks
from trocar.robot.mocap.robots import perturbed
from trocar.robot.mocap.simulate import MarkerNoise, MocapSettings, SimulatedTracks, simulate_tracks
from trocar.robot.mocap.writers import write_tracks

WHITE = MarkerNoise(position=1e-4, rotation=np.deg2rad(0.05))


@functools.cache
def nominal(name: str) -> ArmDescription:
    return load_arm(name)


@functools.cache
def simulated(
    name: str,
    seed: int,
    noise: MarkerNoise | None = None,
    parts: Any = "both",
    duration: float = 8.0,
    motion: Literal["dynamic", "kinematic"] = "kinematic",
) -> SimulatedTracks:
    settings = MocapSettings(
        motion=motion,
        parts=parts,
        duration_s=duration,
        rate_hz=60.0,
        noise=noise or MarkerNoise(),
        seed=seed,
    )
    arm = nominal(name)
    robot = perturbed(arm, np.random.default_rng(seed)) if arm.type in ("PSM", "ECM") else arm
    return simulate_tracks(robot, settings)


def tracks_of(made: SimulatedTracks, **changed: Any) -> Tracks:
    return replace(Tracks("tracks.csv", "0" * 64, made.times, made.poses, made.rate_hz), **changed)


@functools.cache
def found_of(name: str, seed: int) -> Calibration:
    return calibrate(tracks_of(simulated(name, seed)), nominal(name))


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_rounding_of_exact_tracks_changes_no_verdict(name: str) -> None:
    made, rng = simulated(name, 3), np.random.default_rng(0)
    rounded = {b: T * (1.0 + 1e-15 * rng.normal(size=T.shape)) for b, T in made.poses.items()}
    one, two = found_of(name, 3), calibrate(tracks_of(made, poses=rounded), nominal(name))
    assert (one.warnings, one.refined.settled) == (two.warnings, two.refined.settled) == ((), True)
    for label, fit in one.axes.fits.items():
        assert (fit.used == two.axes.fits[label].used).all()
    # Were it not 1, it would widen what a creep before the sweep leaves of home.
    assert one.axes.widened == two.axes.widened == 1.0


@pytest.mark.parametrize(("name", "seed"), [("psm", 1), ("psm", 2), ("ecm", 3)])
def test_exact_poses_give_the_robot_back(name: str, seed: int) -> None:
    found, truth = found_of(name, seed), simulated(name, seed).truth
    assert not found.warnings
    assert set(found.axis_distances) == set(truth["axis_distances_m"])
    for label, wanted in truth["axis_distances_m"].items():
        # Source: the figure to reach, 0.01 um.
        assert abs(found.axis_distances[label].value - wanted) < 1e-8
        assert abs(found.closed_distances[label] - wanted) < 1e-8
    for label, wanted in truth["beta_rad"].items():
        assert abs(found.betas[label].value - wanted) < 1e-7
    assert found.centre is not None and found.centre.distance is not None
    swept = found.overlay.measured["rcm"]["sweep_rad"]
    assert swept["yaw"] == pytest.approx([-0.6, 0.6], abs=0.05)
    assert swept["pitch"] == pytest.approx([-0.6, 0.6], abs=0.05)
    place = truth["rcm"]["position_in_base_body_m"]
    assert np.abs(found.centre.fit.post - place).max() < 1e-8
    assert abs(found.centre.distance.value - truth["rcm"]["distance_to_pitch_axis_m"]) < 1e-8


@pytest.mark.parametrize(
    ("name", "seed"), [("psm", 1), pytest.param("ecm", 3, marks=pytest.mark.slow)]
)
def test_tracks_of_a_simulated_arm_with_servo_errors_give_it_back_as_well(
    tmp_path: Path, name: str, seed: int
) -> None:
    duration = 8.0 if name == "psm" else 24.0  # an ECM is slow
    made = simulated(name, seed, duration=duration, motion="dynamic")
    told = simulated(name, seed, duration=duration)
    end = f"{name}_pitch_end"
    off = np.abs(made.poses[end] - told.poses[end])[:, :3, 3]
    assert off.max() > 1e-5  # the servos lag
    write_tracks(tmp_path / "tracks.csv", made)
    found = calibrate(read_tracks(tmp_path / "tracks.csv"), nominal(name))
    for label, wanted in made.truth["axis_distances_m"].items():
        # Source: the figure to reach from a tidy file, 0.01 um.
        assert abs(found.axis_distances[label].value - wanted) < 1e-8, label
        assert abs(found.closed_distances[label] - wanted) < 1e-8, label
    assert found.centre is not None
    place = made.truth["rcm"]["position_in_base_body_m"]
    assert np.abs(found.centre.fit.post - place).max() < 1e-8


@pytest.mark.parametrize(("name", "seed"), [("psm", 1), ("ecm", 3)])
def test_the_overlay_is_a_robot_whose_shaft_passes_the_remote_centre(name: str, seed: int) -> None:
    found, arm = found_of(name, seed), nominal(name)
    overlay = parse_overlay(overlay_text(found.overlay), "overlay.toml")
    robot = apply_overlay(arm, overlay).mechanism
    assert loops_are_parallelograms(robot)
    q = np.zeros((7, len(arm.joints)))
    q[:, 1] = np.linspace(-0.6, 0.6, 7)
    slide = next(f for f in found.overlay.frames if robot.frame(f).motion == "prismatic")
    shaft = poses(robot, q)[slide]
    assert np.linalg.norm(np.cross(shaft[:, :3, 3], shaft[:, :3, 2]), axis=1).max() < 1e-9
    # Insertion 0 stays as far from the remote centre as the description has it.
    own, drawn = (poses(m, q)[slide][:, :3, 3] for m in (robot, arm.mechanism))
    assert np.abs(np.linalg.norm(own, axis=1) - np.linalg.norm(drawn, axis=1)).max() < 1e-9


def test_the_calibrated_robot_moves_as_the_one_that_was_seen() -> None:
    found, made = found_of("psm", 1), simulated("psm", 1)
    robot = perturbed(nominal("psm"), np.random.default_rng(1)).mechanism
    q = made.q[:: len(made.q) // 40]
    names = ["pitch_back", "pitch_front", "pitch_bottom", "pitch_top", "pitch_end"]
    # Frames sit on their links as they like; how a link moves does not depend on that.
    for name in names:
        a, b = (poses(m, q, "yaw")[name] for m in (robot, found.mechanism))
        turned = np.linalg.inv(a[:1]) @ a, np.linalg.inv(b[:1]) @ b
        angles = [np.arccos(np.clip((np.trace(T[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
                  for T in turned]  # fmt: skip
        assert np.abs(angles[0] - angles[1]).max() < 1e-6


def test_the_masters_forearm_is_measured_the_same_way() -> None:
    made = simulated("mtml", 1, parts="axes")
    found = calibrate(tracks_of(made), nominal("mtml"))
    assert set(found.axis_distances) == {"2-3", "bar-rod", "rod-c1", "3-c1"}
    assert found.axis_distances["2-3"].value == pytest.approx(0.2794, abs=1e-8)
    assert found.axis_distances["rod-c1"].value == pytest.approx(0.2794, abs=1e-8)
    assert found.axis_distances["bar-rod"].value == pytest.approx(0.1, abs=1e-8)
    assert found.axis_distances["3-c1"].value == pytest.approx(0.1, abs=1e-8)
    assert found.centre is None and not found.betas


def test_noise_stays_inside_its_own_figures() -> None:
    made = simulated("psm", 4, MarkerNoise(WHITE.position, WHITE.rotation, 0.05, 0.01))
    found = calibrate(tracks_of(made), nominal("psm"))
    for label, wanted in made.truth["axis_distances_m"].items():
        value = found.axis_distances[label]
        # Five standard deviations; a sweep of 8 s at 60 Hz knows an axis to some 20 um.
        assert abs(value.value - wanted) < 5 * value.sigma < 5e-4
        assert abs(found.closed_distances[label] - wanted) < 1e-4
    assert found.refined.misfit == pytest.approx(1.0, abs=0.15)


def test_without_the_ecms_fourth_frame_five_distances_remain() -> None:
    made = simulated("ecm", 3)
    poses_left = {k: v for k, v in made.poses.items() if k != "ecm_pitch_back"}
    found = calibrate(tracks_of(made, poses=poses_left), nominal("ecm"))
    assert set(found.axis_distances) == {"3-6", "3-7", "6-8", "7-c2", "6-7"}
    for label, value in found.axis_distances.items():
        assert value.value == pytest.approx(made.truth["axis_distances_m"][label], abs=1e-8)
    assert "ecm_pitch_back" in found.warnings[0]


def test_without_a_still_start_there_are_no_betas() -> None:
    made = simulated("psm", 1)
    late = made.times > 2.6
    found = calibrate(
        tracks_of(made, times=made.times[late], poses={k: v[late] for k, v in made.poses.items()}),
        nominal("psm"),
    )
    assert not found.betas
    assert any("the betas are absent" in text for text in found.warnings)
    assert "beta1" not in found.as_dict()["beta_rad"]
    wanted = made.truth["axis_distances_m"]
    for label, value in found.axis_distances.items():
        assert value.value == pytest.approx(wanted[label], abs=1e-8)


def test_a_tidy_and_a_motive_file_agree_with_the_poses(tmp_path: Path) -> None:
    made = simulated("psm", 1)
    layouts: list[tuple[Literal["tidy", "motive"], float]] = [("tidy", 1e-8), ("motive", 1e-6)]
    for layout, limit in layouts:
        path = tmp_path / f"{layout}.csv"
        write_tracks(path, made, layout)
        found = calibrate(read_tracks(path), nominal("psm"))
        for label, wanted in made.truth["axis_distances_m"].items():
            # Source: the figures to reach; a Motive file has six decimals.
            assert abs(found.axis_distances[label].value - wanted) < limit
