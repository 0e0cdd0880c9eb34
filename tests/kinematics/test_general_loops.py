"""Loops that are no parallelograms: four-bars with any sides, and axes that are not parallel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import FramePatch, Overlay, closure_patch
from trocar.geometry import matrix_from_rotation_vector, rpy_from_matrix
from trocar.kinematics import coordinates, gaps, inverse_kinematics, jacobian_spatial, loops, pose
from trocar.kinematics.loops import TERMS, loop_table, nodes

GRIPPER = Path(__file__).parents[2] / "examples" / "mechanisms" / "four_bar_gripper.toml"


def test_a_four_bar_stands_where_two_circles_meet():
    """The hinge C lies on a circle about B and on one about D."""
    arm = load_arm(GRIPPER)
    q = np.linspace(arm.mechanism.lower, arm.mechanism.upper, 25)
    ground, crank, coupler, rocker = 0.030, 0.040, 0.045, 0.046
    angle = np.radians(100.0) + q[:, 0]
    b = crank * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    d = np.array([ground, 0.0])
    towards = d - b
    span = np.linalg.norm(towards, axis=-1)
    along = (coupler**2 - rocker**2 + span**2) / (2.0 * span)
    height = np.sqrt(coupler**2 - along**2)
    unit = towards / span[:, None]
    across = np.stack([-unit[:, 1], unit[:, 0]], axis=-1)
    c = b + along[:, None] * unit + height[:, None] * across
    found = pose(arm.mechanism, q, "c1", relative_to="base")[:, :2, 3]
    assert np.abs(found - c).max() < 1e-12


def test_a_pin_of_standard_rows_slides_along_the_hinge_and_closes_a_skew_loop(
    rng, random_positions
):
    """The forearm's frame lies across its own hinge: z of neither frame need be the pin's."""
    mechanism = load_arm("mtmr").mechanism
    frames: dict[str, FramePatch] = {}
    for name in ("shoulder_pitch", "elbow_pitch", "elbow_bar", "elbow_rod"):
        before = mechanism.frame(name).before
        tilt = matrix_from_rotation_vector(3e-3 * rng.uniform(-1.0, 1.0, 3))
        off = 5e-4 * rng.uniform(-1.0, 1.0, 3)
        frames[name] = FramePatch(before[:3, 3] + off, rpy_from_matrix(before[:3, :3] @ tilt))
    (hinge,) = mechanism.closures
    closures = {"c1": closure_patch(hinge, slides=True)}
    arm = load_arm("mtmr", calibration=Overlay("mtmr", "general", frames, closures))
    q = random_positions(arm, rng, 50)
    found = coordinates(arm.mechanism, q)
    assert gaps(arm.mechanism, found).max() < 1e-12
    assert 1e-4 < np.abs(found[:, arm.mechanism.frame_index["c1_pin"]]).max() < 5e-3


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_the_table_of_a_loop_leaves_newton_nothing_to_do(
    name, skew_overlay, rng, random_positions, monkeypatch
):
    arm = load_arm(name, calibration=skew_overlay(name, rng))
    q = random_positions(arm, rng, 200)
    start = loops.coupled_coordinates(arm.mechanism, q)
    table = loops.folding_table(arm.mechanism)
    assert table is not None
    near = start.copy()
    near[:, loops.passive_frames(arm.mechanism)] += table.beyond_start(q)
    assert gaps(arm.mechanism, near).max() < 1e-11
    assert gaps(arm.mechanism, start).max() > 1e-4
    found = coordinates(arm.mechanism, q)
    monkeypatch.setattr(loops, "folding_table", lambda _: None)
    alone = coordinates(arm.mechanism, q)
    assert gaps(arm.mechanism, alone).max() < 1e-12
    assert np.abs(found - alone).max() < 1e-10
    assert (found != alone).any()  # the table was used, and then was not


def test_beyond_the_limits_a_loop_closes_without_its_table(skew_overlay, rng):
    mechanism = load_arm("psm", calibration=skew_overlay("psm", rng)).mechanism
    q = np.zeros((2, 7))
    q[:, 1] = mechanism.lower[1] - 0.1, mechanism.upper[1] + 0.1
    assert gaps(mechanism, coordinates(mechanism, q)).max() < 1e-12


def test_one_position_gives_what_many_give(skew_overlay, rng, random_positions):
    arm = load_arm("psm", calibration=skew_overlay("psm", rng))
    q = random_positions(arm, rng, 20)
    many = coordinates(arm.mechanism, q)
    for row, one in zip(many, q, strict=True):
        assert np.abs(coordinates(arm.mechanism, one) - row).max() < 1e-12


def test_a_series_through_chebyshevs_nodes_is_the_function():
    positions = nodes(-0.5, 1.5)
    assert len(positions) == TERMS
    table = loop_table(0, -0.5, 1.5, np.stack([np.exp(positions), np.sin(positions)], axis=-1))
    q = np.linspace(-0.5, 1.5, 101)[:, None]
    found = table.beyond_start(q)
    assert np.abs(found - np.stack([np.exp(q[:, 0]), np.sin(q[:, 0])], axis=-1)).max() < 1e-13
    assert not table.beyond_start(np.array([[2.0], [-1.0]])).any()


@pytest.mark.parametrize("name", ["psm", "ecm"])
def test_jacobians_of_a_skew_arm_are_its_finite_differences(
    name, skew_overlay, rng, random_positions
):
    arm = load_arm(name, calibration=skew_overlay(name, rng))
    mechanism = arm.mechanism
    h = 1e-6
    for q in random_positions(arm, rng, 5):
        slope = jacobian_spatial(mechanism, q)
        at = pose(mechanism, q)
        for joint in range(len(q)):
            step = h * np.eye(len(q))[joint]
            difference = (pose(mechanism, q + step) - pose(mechanism, q - step)) / (2.0 * h)
            twist = difference @ np.linalg.inv(at)
            assert np.abs(twist[:3, 3] - slope[:3, joint]).max() < 1e-8
            spin = np.array([twist[2, 1], twist[0, 2], twist[1, 0]])
            assert np.abs(spin - slope[3:, joint]).max() < 1e-8


@pytest.mark.parametrize("name", ["psm", "ecm"])
@pytest.mark.parametrize("kind", ["parallel_overlay", "skew_overlay"])
def test_inverse_kinematics_of_a_calibrated_arm_undoes_its_forward_kinematics(
    name, kind, request, rng, random_positions
):
    arm = load_arm(name, calibration=request.getfixturevalue(kind)(name, rng))
    mechanism = arm.mechanism
    count = 6 if name == "psm" else 4
    for q in random_positions(arm, rng, 20):
        q[count:] = 0.0
        q[2] = max(q[2], 0.06)
        expected = pose(mechanism, q)
        found = inverse_kinematics(mechanism, arm.inverse_kinematics, expected, q[:count])
        assert np.abs(found[0] - q[:count]).max() < 1e-7
        for solution in found:
            whole = np.concatenate([solution, np.zeros(len(q) - count)])
            assert np.abs(pose(mechanism, whole) - expected).max() < 1e-6
