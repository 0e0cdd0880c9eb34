"""The workspace: what a tip reaches, and does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.kinematics import Mechanism, pose
from trocar.kinematics.workspace import icosphere, workspace

ARMS = (pytest.param("psm", marks=pytest.mark.slow), "ecm", "mtmr")
BEYOND_M = 0.005

Floats = NDArray[np.float64]


def nearest_m(mechanism: Mechanism, point: Floats, starts: Floats) -> float:
    """Return the least distance of the tip from a point, by SLSQP from several starts [m]."""
    limits = []
    for frame, ratio in zip(mechanism.frames, mechanism.ratios, strict=True):
        if np.isfinite(frame.lower):
            limits.append({"type": "ineq", "fun": lambda q, r=ratio, f=frame: q @ r - f.lower})
        if np.isfinite(frame.upper):
            limits.append({"type": "ineq", "fun": lambda q, r=ratio, f=frame: f.upper - q @ r})

    def off_mm2(q: Floats) -> float:
        return 1e6 * float(np.sum((pose(mechanism, q)[:3, 3] - point) ** 2))

    bounds = list(zip(mechanism.lower, mechanism.upper, strict=True))
    found = (
        minimize(off_mm2, start, bounds=bounds, constraints=limits, method="SLSQP")
        for start in starts
    )
    return 1e-3 * min(result.fun for result in found) ** 0.5


@pytest.mark.parametrize("name", ARMS)
def test_each_vertex_is_reached_within_the_limits(name: str) -> None:
    mechanism = load_arm(name).mechanism
    found = workspace(mechanism)
    assert np.all(mechanism.within(found.joints))
    tips = pose(mechanism, found.joints)[:, :3, 3]
    assert np.abs(tips - found.vertices).max() < 1e-12
    off = found.vertices - found.centre
    directions, _ = icosphere(3)
    aside = off - np.sum(off * directions, axis=1)[:, None] * directions
    assert np.linalg.norm(aside, axis=1).max() < 1e-4


@pytest.mark.parametrize("name", ARMS)
def test_5_mm_beyond_a_vertex_no_search_of_another_kind_brings_the_tip(name: str) -> None:
    mechanism = load_arm(name).mechanism
    found = workspace(mechanism)
    rng = np.random.default_rng(1)
    span = mechanism.upper - mechanism.lower
    share = np.clip(1.6 * rng.random((20_000, len(span))) - 0.3, 0.0, 1.0)
    samples = mechanism.lower + share * span
    samples = samples[mechanism.within(samples)]
    tips = pose(mechanism, samples)[:, :3, 3]
    for k in rng.choice(len(found.vertices), 12, replace=False):
        off = found.vertices[k] - found.centre
        point = found.vertices[k] + BEYOND_M * off / np.linalg.norm(off)
        order = np.argsort(np.linalg.norm(tips - point, axis=1))[:3]
        assert nearest_m(mechanism, point, samples[order]) > 1e-4
        # The search would have found it: the vertex itself it finds.
        assert nearest_m(mechanism, found.vertices[k], found.joints[k] + 0.02 * span[None]) < 1e-4


def test_of_a_scope_it_is_the_cap_of_a_ball() -> None:
    # ECM: the tip is on a ray from the remote centre, at most as far as insertion goes; without
    # the facets' sagitta, the volume is that of the rays between the limits of yaw and pitch.
    mechanism = load_arm("ecm").mechanism
    found = workspace(mechanism)
    (yaw, pitch, insertion) = mechanism.joints[:3]
    near, far = (
        float(np.linalg.norm(pose(mechanism, [0, 0, s, 0])[:3, 3]))
        for s in (insertion.lower, insertion.upper)
    )
    radii = np.linalg.norm(found.vertices, axis=1)
    assert near - 1e-6 <= radii.min() and far - 5e-4 < radii.max() <= far + 1e-9
    solid = (yaw.upper - yaw.lower) * (np.sin(pitch.upper) - np.sin(pitch.lower))
    assert found.volume == pytest.approx(solid * (far**3 - near**3) / 3, rel=0.06)


def test_the_same_mechanism_has_the_same_surface() -> None:
    mechanism = load_arm("ecm").mechanism
    first = workspace(mechanism, 1)
    workspace.cache_clear()
    assert np.array_equal(first.vertices, workspace(mechanism, 1).vertices)


def test_faces_are_closed_and_seen_from_outside() -> None:
    points, faces = icosphere(2)
    assert len(points) == 162 and len(faces) == 320
    edges = {(int(a), int(b)) for face in faces for a, b in zip(face, face[[1, 2, 0]], strict=True)}
    assert all((b, a) in edges for a, b in edges) and len(edges) == 3 * len(faces)


def test_two_joints_reach_no_volume() -> None:
    scope = load_arm("ecm").mechanism
    stuck = replace(scope.joints[2], lower=0.1, upper=0.1)
    joints = (*scope.joints[:2], stuck, *scope.joints[3:])
    with pytest.raises(InputError, match="no volume: over the range of a joint it moves"):
        workspace(replace(scope, joints=joints))
