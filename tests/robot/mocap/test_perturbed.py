"""Robots that are not as drawn: every loop closed, every number off, a remote centre."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.kinematics import coordinates, gaps, poses, remote_centre
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.robot.mocap import MocapSettings, perturbed, simulate_tracks


def geometry(arm):
    settings = MocapSettings(motion="kinematic", duration_s=6.0, rate_hz=10.0)
    return simulate_tracks(arm, settings).truth


@pytest.mark.parametrize("name", ["psm", "ecm"])
@pytest.mark.parametrize("seed", range(5))
def test_a_perturbed_robot_closes_and_has_a_remote_centre(name, seed, rng, random_positions):
    arm = perturbed(load_arm(name), np.random.default_rng(seed))
    mechanism = arm.mechanism
    assert loops_are_parallelograms(mechanism)
    q = random_positions(arm, rng, 50)
    assert gaps(mechanism, coordinates(mechanism, q)).max() < 1e-12
    at = poses(mechanism, q, arm.root)
    shaft = at["insertion"]
    centre = remote_centre(shaft[:, :3, 3], shaft[:, :3, 2])
    assert centre.point == pytest.approx(at["rcm"][0, :3, 3], abs=1e-12)
    assert centre.rms < 1e-12


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_every_length_and_angle_is_off_within_bounds_and_opposite_sides_are_equal(name):
    drawn = geometry(load_arm(name))
    off = {key: [] for key in (*drawn["axis_distances_m"], "beta1", "beta2")}
    for seed in range(20):
        made = geometry(perturbed(load_arm(name), np.random.default_rng(seed)))
        sides = made["axis_distances_m"]
        for one, other in (("3-4", "6-c1"), ("3-6", "4-c1"), ("6-8", "7-c2")):
            assert sides[one] == pytest.approx(sides[other], abs=1e-12)
        for key, length in sides.items():
            off[key].append(length - drawn["axis_distances_m"][key])
        for key, angle in made["beta_rad"].items():
            off[key].append(angle - drawn["beta_rad"][key])
    for key, differences in off.items():
        limit = np.radians(1.0) if key.startswith("beta") else 0.003
        if key != "6-7":  # follows from 3-6, 3-7 and the angle between them
            assert np.abs(differences).max() <= limit + 1e-12
        assert np.ptp(differences) > limit, key


def test_the_same_generator_makes_the_same_robot_and_loops_alone_make_none():
    one, two = (geometry(perturbed(load_arm("psm"), np.random.default_rng(7))) for _ in "12")
    assert one == two
    gripper = load_arm(Path(__file__).parents[3] / "examples/mechanisms/four_bar_gripper.toml")
    with pytest.raises(InputError, match="its loops carry all axes; allowed: psm, ecm"):
        perturbed(gripper, np.random.default_rng(0))
