"""Worn robots and broken loops: they close, and the remote centre wanders."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.kinematics import coordinates, gaps
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.robot.mocap import MocapSettings, broken, perturbed, simulate_tracks, worn

QUICK = MocapSettings(motion="kinematic", duration_s=8.0, rate_hz=20.0)


@pytest.mark.parametrize("name", ["psm", "ecm"])
@pytest.mark.parametrize("seed", range(3))
def test_a_worn_robot_closes_and_its_centre_wanders_by_tenths_of_a_millimetre(name, seed):
    rng = np.random.default_rng(seed)
    arm = worn(perturbed(load_arm(name), rng), rng)
    tracks = simulate_tracks(arm, QUICK)
    assert not loops_are_parallelograms(arm.mechanism)
    assert gaps(arm.mechanism, coordinates(arm.mechanism, tracks.q)).max() < 1e-9
    assert 1e-4 < tracks.truth["rcm"]["rms_m"] < 2e-3
    sides = tracks.truth["axis_distances_m"]
    assert abs(sides["3-6"] - sides["4-c1"]) > 1e-6
    assert list(tracks.poses) == list(simulate_tracks(load_arm(name), QUICK).poses)


def test_without_displacement_and_tilt_nothing_is_worn():
    drawn = simulate_tracks(load_arm("psm"), QUICK)
    same = simulate_tracks(worn(load_arm("psm"), np.random.default_rng(0), 0.0, 0.0), QUICK)
    for body, pose in drawn.poses.items():
        assert same.poses[body] == pytest.approx(pose, abs=1e-12)
    assert drawn.truth["rcm"]["rms_m"] < 1e-14


@pytest.mark.parametrize("name", ["psm", "ecm"])
@pytest.mark.parametrize("seed", range(3))
def test_opposite_sides_of_broken_loops_differ_by_what_was_broken(name, seed):
    rng = np.random.default_rng(seed)
    robot = perturbed(load_arm(name), rng)
    arm = broken(robot, rng, 1e-3)
    mechanism = arm.mechanism
    assert not loops_are_parallelograms(mechanism)
    q = np.zeros((40, len(arm.joints)))
    q[:, 1] = np.linspace(mechanism.lower[1], mechanism.upper[1], 40)
    assert gaps(mechanism, coordinates(mechanism, q)).max() < 1e-9
    for old, new in zip(robot.mechanism.closures, mechanism.closures, strict=True):
        by = new.point_a - old.point_a
        assert np.linalg.norm(by) == pytest.approx(1e-3) and by[2] == 0.0
    assert simulate_tracks(arm, QUICK).truth["rcm"]["rms_m"] > 5e-5
