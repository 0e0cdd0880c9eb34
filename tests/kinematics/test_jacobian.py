"""Jacobians agree with finite differences, on every frame, loops included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.geometry.se3 import adjoint, inverse, log_transform
from trocar.kinematics import forward
from trocar.kinematics.jacobian import jacobian_body, jacobian_spatial
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.kinematics.mechanism import Mechanism

STEP = 1e-6
#: Central differences: STEP^2 of curvature, and rounding over STEP.
CLOSE = 1e-8


def bent(mechanism: Mechanism) -> Mechanism:
    """Return a PSM whose upper bar is 1 mm too long: loops, but no parallelograms."""
    c1, c2 = mechanism.closures
    longer = replace(c2, point_a=c2.point_a + np.array([1e-3, 0.0, 0.0]))
    return replace(mechanism, closures=(c1, longer))


def differences(mechanism: Mechanism, q: np.ndarray, frame: str) -> np.ndarray:
    """Return the spatial Jacobian by central differences, (6, n)."""
    columns = []
    for step in np.eye(len(q)) * STEP:
        ahead, behind = (forward.pose(mechanism, q + s * step, frame) for s in (1, -1))
        columns.append(log_transform(ahead @ inverse(behind)) / (2 * STEP))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("name", ["psm", "ecm", "suj_psm3", "suj_ecm", "mtml"])
def test_the_spatial_jacobian_is_the_derivative_of_every_frame(name, rng, random_positions):
    arm = load_arm(name)
    q = random_positions(arm, rng, 1)[0]
    for frame in (f.name for f in arm.mechanism.frames):
        expected = differences(arm.mechanism, q, frame)
        np.testing.assert_allclose(
            jacobian_spatial(arm.mechanism, q, frame), expected, atol=CLOSE, err_msg=frame
        )


def test_it_holds_where_loops_are_no_parallelograms():
    mechanism = bent(load_arm("psm").mechanism)
    assert not loops_are_parallelograms(mechanism)
    q = np.array([0.3, -0.4, 0.1, 0.2, 0.3, -0.2, 0.4])
    for frame in ("pitch_front", "pitch_bottom", "pitch_top", "pitch_end", "insertion", "tip"):
        expected = differences(mechanism, q, frame)
        np.testing.assert_allclose(
            jacobian_spatial(mechanism, q, frame), expected, atol=1e-7, err_msg=frame
        )


@pytest.mark.parametrize("name", ["psm", "ecm", "mtmr"])
def test_the_body_jacobian_is_the_spatial_one_seen_from_the_frame(name, rng, random_positions):
    arm = load_arm(name)
    q = random_positions(arm, rng, 20)
    tip = forward.pose(arm.mechanism, q)
    expected = adjoint(inverse(tip)) @ jacobian_spatial(arm.mechanism, q)
    np.testing.assert_allclose(jacobian_body(arm.mechanism, q), expected, atol=1e-12)


def test_yaw_and_pitch_do_not_move_the_remote_centre(rng, random_positions):
    arm = load_arm("psm")
    spatial = jacobian_spatial(arm.mechanism, random_positions(arm, rng, 50), "pitch_end")
    # the reference frame lies at the remote centre: no linear velocity there
    np.testing.assert_allclose(spatial[:, :3, :2], 0.0, atol=1e-12)
