"""The solids of an arm's links stand on the axes of its description, and clear of each other."""

from importlib import import_module
from itertools import combinations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.kinematics.forward import poses

pytest.importorskip("build123d", reason="solids need the extra cad")

from tests.tools.cad.solids import links_of, off_axis, parts, set_of, shared
from tools.cad import kit
from tools.cad.links import drawn as drawn_link
from tools.cad.sets import solid_sets

# Whole arms are drawn.
pytestmark = pytest.mark.slow

#: Link -> the axes that its solids show.
AXES = {
    "psm": {
        "base": ("yaw",),
        "yaw": ("pitch_back", "pitch_front"),
        "pitch_back": ("pitch_back", "pitch_bottom", "pitch_top"),
        "pitch_front": ("pitch_front", "c1"),
        "pitch_bottom": ("pitch_bottom", "c1", "pitch_end"),
        "pitch_top": ("pitch_top", "c2"),
        "pitch_end": ("pitch_end", "c2", "insertion"),
    },
    "ecm": {
        "base": ("yaw",),
        "yaw": ("pitch_front", "pitch_back"),
        "pitch_front": ("pitch_front", "pitch_bottom", "pitch_top"),
        "pitch_back": ("pitch_back", "c1"),
        "pitch_bottom": ("pitch_bottom", "c1", "pitch_end"),
        "pitch_top": ("pitch_top", "c2"),
        "pitch_end": ("pitch_end", "c2", "insertion"),
        "insertion": ("insertion", "roll"),
        "roll": ("roll",),
    },
    "psm_si": {
        "base": ("yaw",),
        "yaw": ("yaw", "pitch_1"),
        "pitch_1": ("pitch_1", "pitch_2"),
        "pitch_2": ("pitch_2", "pitch_3"),
        "psm_pitch_3": ("pitch_3", "insertion"),
    },
    "ecm_si": {
        "base": ("yaw",),
        "yaw": ("yaw", "pitch_1"),
        "pitch_1": ("pitch_1", "pitch_2"),
        "pitch_2": ("pitch_2", "pitch_3"),
        "ecm_pitch_3": ("pitch_3", "insertion"),
        "ecm_insertion": ("insertion",),
    },
}
ARMS = tuple(AXES)


@pytest.mark.parametrize(
    ("arm", "link", "axis"),
    [(arm, link, axis) for arm in ARMS for link, axes in AXES[arm].items() for axis in axes],
)
def test_hinges_of_the_solids_lie_on_the_frames(arm, link, axis):
    mechanism = load_arm(arm).mechanism
    (solid,) = [k for k in links_of(arm) if k.name == link]
    at = poses(mechanism, np.zeros(len(mechanism.joints)), solid.frame)[axis]
    assert off_axis(parts(solid), 1000.0 * at[:3, 3], at[:3, 2]) < 1e-6


@pytest.mark.parametrize("arm", ["psm", "ecm"])  # the Si is not calibrated by its closures
def test_a_robot_with_leaning_hinges_is_drawn_on_them(arm, skew_overlay):
    own = load_arm(arm, "none", skew_overlay(arm, np.random.default_rng(1)))
    links = {k.name: k for k in import_module(f"tools.cad.{arm}").links(own)}
    for name, axes in AXES[arm].items():
        for part in links[name].parts:
            assert part.solid.is_valid, (name, part.material)
        for axis in axes:
            at = kit.hinge(own.mechanism, name, axis)
            assert off_axis(parts(links[name]), at.point, at.direction) < 1e-6, (name, axis)


@pytest.mark.parametrize("arm", ARMS)
def test_every_part_is_a_closed_solid_of_a_known_frame(arm):
    frames = load_arm(arm).mechanism.frame_index
    for link in links_of(arm):
        assert link.frame in frames
        for part in link.parts:
            assert part.solid.is_valid, (link.name, part.material)
            assert all(solid.volume > 0.0 for solid in part.solid.solids()), link.name
        for shape in link.convex:
            assert shape.is_valid
            assert len(shape.faces()) <= 64


@pytest.mark.parametrize(
    ("arm", "most"), [("psm", 14_000), ("ecm", 12_000), ("psm_si", 14_000), ("ecm_si", 12_000)]
)
def test_an_arm_is_drawn_with_few_triangles(arm, most):
    fineness = solid_sets()[set_of(arm)].fineness
    pieces = [drawn_link(link, fineness) for link in links_of(arm)]
    assert sum(len(mesh.faces) for piece in pieces for mesh in piece.visual) <= most
    assert all(len(mesh.faces) <= 64 for piece in pieces for mesh in piece.convex)


@pytest.mark.parametrize("lean", [0.0, 1.0])
@pytest.mark.parametrize("arm", ARMS)
def test_links_do_not_run_through_each_other(arm, lean):
    """Pins and caps (material joint) excepted: they sit in what they join."""
    mechanism = load_arm(arm).mechanism
    q = 0.5 * (mechanism.lower + mechanism.upper)
    q[1] = mechanism.lower[1] + lean * (mechanism.upper[1] - mechanism.lower[1])
    q[2] = mechanism.upper[2] if lean == 1.0 else mechanism.lower[2]
    at = poses(mechanism, q)
    bodies = {
        link.name: [
            kit.location(at[link.frame]) * part.solid
            for part in link.parts
            if part.material != "joint"
        ]
        for link in links_of(arm)
    }
    for one, other in combinations(bodies, 2):
        both = [shared(a, b) for a in bodies[one] for b in bodies[other]]
        assert sum(both) < 1.0, (one, other)  # mm^3
