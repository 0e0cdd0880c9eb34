"""What spoils a calibration, and what is said of it."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.errors import FarFromNominalError, InputError, UndeterminedError
from trocar.geometry import matrix_from_rotation_vector, transform
from trocar.robot.calibration import Tracks, calibrate
from trocar.robot.calibration.linkage import freedoms, home_points, linkage, slots
from trocar.robot.calibration.robot import Robot, marker_poses, mechanism_of

Array = NDArray[np.float64]
RATE = 60.0


@functools.cache
def psm() -> ArmDescription:
    return load_arm("psm")


def random_robot(seed: int, parallelogram: bool, off: float, tilt: float = 0.0) -> Robot:
    """A PSM's linkage whose axes are off by `off` [m] and tilted by `tilt` [rad]."""
    rng, loops = np.random.default_rng(seed), linkage(psm())
    basis = freedoms(loops, parallelogram)
    moved = (basis @ (off * rng.normal(size=basis.shape[1]))).reshape(-1, 2)
    names = [hinge.name for hinge in loops.hinges if not hinge.closure][1:]
    tilts = {name: tilt * rng.normal(size=2) for name in names} if tilt else {}
    markers = {
        body: transform(matrix_from_rotation_vector(rng.normal(size=3)), 0.06 * rng.normal(size=3))
        for body in loops.bodies
    }
    return Robot(loops, moved, tilts, markers)


def swept(
    robot: Robot, amplitude: float = 0.6, noise: float = 0.0, seed: int = 0, start: float = 0.0
) -> Tracks:
    """Tracks of a robot: a second of rest at a joint position, then two swings of its joint."""
    rng = np.random.default_rng(seed)
    times = np.arange(int(9 * RATE)) / RATE
    q = np.where(times < 1.0, 0.0, amplitude * np.sin(np.pi * (times - 1.0) / 2.0))[:, None] + start
    at = marker_poses(robot, mechanism_of(robot), q)
    camera = transform(matrix_from_rotation_vector(rng.normal(size=3)), rng.normal(size=3))
    seen = camera @ at
    seen[..., :3, 3] += noise * 1e-4 * rng.normal(size=(*seen.shape[:2], 3))
    spin = noise * np.deg2rad(0.05) * rng.normal(size=(*seen.shape[:2], 3))
    seen[..., :3, :3] = seen[..., :3, :3] @ matrix_from_rotation_vector(spin)
    poses = {body: seen[:, i] for i, body in enumerate(robot.markers)}
    return Tracks("tracks.csv", "", times, poses, RATE)


def with_datum(robot: Robot) -> Robot:
    """Move a cluster so that those of yaw and pitch_back lie level with axis 3's origin on average.

    The sweep of the loops alone shows no more than that of where along its axes the linkage is.
    """
    loops = robot.linkage
    ups = {b: loops.frames[loops.bodies[b]][:3, :3].T @ loops.plane[:, 2] for b in robot.markers}
    levels = [ups[b] @ robot.markers[b][:3, 3] for b in ("psm_yaw", "psm_pitch_back")]
    moved = robot.markers["psm_yaw"].copy()
    moved[:3, 3] -= sum(levels) * ups["psm_yaw"]
    return replace(robot, markers={**robot.markers, "psm_yaw": moved})


def spoiled(tracks: Tracks, **poses: Array) -> Tracks:
    return replace(tracks, poses={**tracks.poses, **poses})


def distances(robot: Robot) -> Mapping[str, float]:
    points = home_points(robot.linkage, robot.moved)
    by = {(s.hinge, s.body): p for s, p in points.items()}
    back, end = "psm_pitch_back", "psm_pitch_end"
    return {
        "3-6": float(np.linalg.norm(by["pitch_back", back] - by["pitch_bottom", back])),
        "8-c2": float(np.linalg.norm(by["pitch_end", end] - by["c2", end])),
    }


@pytest.mark.slow
def test_general_loops_are_found_with_their_sides_and_tilts() -> None:
    robot = with_datum(random_robot(1, False, 2e-3, 2e-3))
    found = calibrate(swept(robot), psm(), closure="general")
    # Exact poses: what is left is rounding, through a loop that is closed numerically.
    assert np.abs(found.refined.robot.moved - robot.moved).max() < 1e-8
    for name, tilt in robot.tilts.items():
        assert np.abs(found.refined.robot.tilts[name] - tilt).max() < 1e-7
    assert found.wander is not None and found.wander > 1e-4
    assert any("not a fixed point" in text for text in found.warnings)
    assert all(patch.slides for patch in found.overlay.closures.values())


def test_loops_that_do_not_close_are_told_and_scale_the_covariance() -> None:
    robot = random_robot(2, False, 1e-3)
    tracks = swept(robot, noise=1.0)
    found = calibrate(tracks, psm())
    exact = calibrate(swept(random_robot(2, True, 1e-3), noise=1.0), psm())
    assert any("no fixed remote centre exists" in text for text in found.warnings)
    assert not exact.warnings
    assert found.refined.misfit > 5.0 * exact.refined.misfit
    grown = np.trace(found.refined.covariance) / np.trace(exact.refined.covariance)
    assert grown == pytest.approx(found.refined.misfit, rel=0.5)
    # The distances stay as they are measured, each by itself.
    wanted = distances(robot)["3-6"]
    assert abs(found.axis_distances["3-6"].value - wanted) < 5 * found.axis_distances["3-6"].sigma


def test_a_small_sweep_is_warned_of_and_a_tiny_one_refused() -> None:
    robot = random_robot(3, True, 1e-3)
    found = calibrate(swept(robot, 0.06, noise=1.0), psm())
    assert any("swept by 0.1" in text for text in found.warnings)
    with pytest.raises(InputError, match=r"swept by 0\.0\d+ rad; allowed: 0\.05 rad"):
        calibrate(swept(robot, 0.02, noise=0.1), psm())


@pytest.mark.parametrize("seed", range(3))
def test_noise_makes_no_sweep_larger(seed: int) -> None:
    """Peak to peak, noise of 1 mrad would add 5 mrad to a sweep of 46."""
    tracks = swept(random_robot(3, True, 1e-3), 0.023, noise=1.0, seed=seed)
    with pytest.raises(InputError, match=r"swept by 0\.04\d+ rad; allowed: 0\.05"):
        calibrate(tracks, psm())


def test_a_still_start_away_from_joint_positions_0_is_refused() -> None:
    robot = random_robot(3, True, 1e-3)
    words = r"angles at rest beta1 .*within 0\.1 rad.*joint positions 0"
    with pytest.raises(FarFromNominalError, match=words) as caught:
        calibrate(swept(robot, 0.3, start=0.2), psm())
    assert set(caught.value.off) == {"beta1", "beta2"}
    assert calibrate(swept(robot, 0.3, start=0.02), psm()).betas


@pytest.mark.slow
def test_the_first_frame_is_a_worse_home_than_the_still_start() -> None:
    errors: dict[str, list[float]] = {"mean": [], "first": []}
    for seed in range(6):
        robot = random_robot(seed, True, 1e-3)
        found = calibrate(swept(robot, noise=1.0, seed=seed), psm())
        start = next(iter(found.axes.fits.values()))
        angles = start.angles[found.home.samples]
        errors["mean"].append(found.home.angles["pitch_back"].sigma)
        errors["first"].append(float(np.nanstd(angles)))
    # Sixty samples of rest: the mean is some eight times as good as one of them.
    assert np.mean(errors["first"]) > 6.0 * np.mean(errors["mean"])


def test_bodies_that_are_missing_or_unknown_are_listed() -> None:
    tracks = swept(random_robot(4, True, 1e-3))
    without = {k: v for k, v in tracks.poses.items() if k != "psm_pitch_bottom"}
    with pytest.raises(InputError, match="bodies missing: psm_pitch_bottom; found: psm_yaw"):
        calibrate(replace(tracks, poses=without), psm())
    with pytest.raises(InputError, match=r"unknown bodies: psm_pitch_fornt; found: .*expected:"):
        calibrate(spoiled(tracks, psm_pitch_fornt=tracks.poses["psm_pitch_front"]), psm())
    renamed = {("Rigid Body 1" if k == "psm_yaw" else k): v for k, v in tracks.poses.items()}
    found = calibrate(replace(tracks, poses=renamed), psm(), bodies={"psm_yaw": "Rigid Body 1"})
    assert len(found.axis_distances) == 8


def test_bodies_that_are_never_seen_together_are_refused() -> None:
    tracks = swept(random_robot(5, True, 1e-3))
    half = len(tracks.times) // 2
    first, second = tracks.poses["psm_yaw"].copy(), tracks.poses["psm_pitch_back"].copy()
    first[:half], second[half:] = np.nan, np.nan
    with pytest.raises(InputError, match="psm_yaw and psm_pitch_back are tracked together in 0"):
        calibrate(spoiled(tracks, psm_yaw=first, psm_pitch_back=second), psm())


def test_mixed_handedness_is_named() -> None:
    tracks = swept(random_robot(6, True, 1e-3))
    flipped = {body: pose.copy() for body, pose in tracks.poses.items()}
    for pose in flipped.values():
        pose[:, 2, 3] *= -1.0
    with pytest.raises(InputError, match=r"do not rotate about a common axis.*cause: .*hand"):
        calibrate(replace(tracks, poses=flipped), psm())


@pytest.mark.slow
def test_a_sweep_of_the_pitch_alone_shows_no_remote_centre() -> None:
    robot = random_robot(7, True, 1e-3)
    tracks = swept(robot)
    # The base rests as the yaw link does.
    tracks = spoiled(tracks, psm_base=tracks.poses["psm_yaw"])
    found = calibrate(tracks, psm())
    assert found.centre is None
    assert any("no remote centre" in text for text in found.warnings)
    with pytest.raises(UndeterminedError):
        calibrate(tracks, psm(), tracks)


def test_every_place_of_a_hinge_has_its_numbers() -> None:
    loops = linkage(psm())
    # Five frames' hinges, and two closures that have a place on either side.
    assert len(slots(loops)) == 9
    assert freedoms(loops, True).shape == (18, 7)
    assert freedoms(loops, False).shape == (18, 11)


def test_the_same_tracks_give_the_same_robot() -> None:
    tracks = swept(random_robot(8, True, 1e-3), noise=1.0)
    assert calibrate(tracks, psm()).as_dict() == calibrate(tracks, psm()).as_dict()
