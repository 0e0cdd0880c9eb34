"""The solids of an arm's links stand on the axes of its description, and clear of each other."""

from dataclasses import replace
from functools import cache
from importlib import import_module
from itertools import combinations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.kinematics.forward import poses

pytest.importorskip("build123d", reason="solids need the extra cad")

from build123d import GeomType
from build123d.topology import Shape

from trocar.apps.cad import kit
from trocar.apps.cad.draw import drawn as drawn_link
from trocar.apps.cad.link import Link
from trocar.apps.cad.sets import solid_sets

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
}
ARMS = tuple(AXES)


def drawn(arm) -> dict[str, Link]:
    return {link.name: link for link in import_module(f"trocar.apps.cad.{arm.name}").links(arm)}


@cache
def links_of(name: str) -> dict[str, Link]:
    return drawn(load_arm(name))


def volume(shape: Shape) -> float:
    return sum(solid.volume for solid in shape.solids())


def round_axes(link: Link) -> list[tuple[np.ndarray, np.ndarray]]:
    """A point and the direction of every cylinder of a link."""
    faces = [f for part in link.parts for f in part.solid.faces().filter_by(GeomType.CYLINDER)]
    axes = [face.axis_of_rotation for face in faces]
    return [(np.array(tuple(a.position)), np.array(tuple(a.direction))) for a in axes if a]


def nearest(link: Link, point: np.ndarray, z: np.ndarray) -> float:
    """How far the axis z through a point [mm] is from that of the nearest parallel cylinder."""
    away = [np.linalg.norm(np.cross(p - point, z)) for p, d in round_axes(link)
            if np.linalg.norm(np.cross(d, z)) < 1e-9]  # fmt: skip
    return float(min(away, default=np.inf))


@pytest.mark.parametrize(
    ("arm", "link", "axis"),
    [(arm, link, axis) for arm in ARMS for link, axes in AXES[arm].items() for axis in axes],
)
def test_hinges_of_the_solids_lie_on_the_frames(arm, link, axis):
    mechanism = load_arm(arm).mechanism
    at = poses(mechanism, np.zeros(len(mechanism.joints)), link)[axis]
    assert nearest(links_of(arm)[link], 1000.0 * at[:3, 3], at[:3, 2]) < 1e-6


@pytest.mark.parametrize("arm", ARMS)
def test_a_calibrated_arm_gets_hinges_of_its_own(arm):
    nominal = load_arm(arm)
    frames = list(nominal.mechanism.frames)
    index = nominal.mechanism.frame_index["pitch_bottom"]
    before = frames[index].before.copy()
    before[:3, 3] += [0.0012, -0.0007, 0.0]
    frames[index] = replace(frames[index], before=before)
    own = replace(nominal, mechanism=replace(nominal.mechanism, frames=tuple(frames)))
    carrier = frames[index].parent
    assert carrier is not None
    point, z = 1000.0 * before[:3, 3], before[:3, 2]
    assert nearest(drawn(own)[carrier], point, z) < 1e-6
    assert nearest(links_of(arm)[carrier], point, z) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
def test_a_robot_with_leaning_hinges_is_drawn_on_them(arm, skew_overlay):
    own = load_arm(arm, "none", skew_overlay(arm, np.random.default_rng(1)))
    links = drawn(own)
    for name, axes in AXES[arm].items():
        for part in links[name].parts:
            assert part.solid.is_valid, (name, part.material)
        for axis in axes:
            at = kit.hinge(own.mechanism, name, axis)
            assert nearest(links[name], at.point, at.direction) < 1e-6, (name, axis)


@pytest.mark.parametrize("arm", ARMS)
def test_every_part_is_a_closed_solid_of_a_known_frame(arm):
    frames = load_arm(arm).mechanism.frame_index
    for link in links_of(arm).values():
        assert link.frame in frames
        for part in link.parts:
            assert part.solid.is_valid, (link.name, part.material)
            assert all(solid.volume > 0.0 for solid in part.solid.solids()), link.name
        for shape in link.convex:
            assert shape.is_valid
            assert len(shape.faces()) <= 64


@pytest.mark.parametrize(("arm", "most"), [("psm", 14_000), ("ecm", 12_000)])
def test_an_arm_is_drawn_with_few_triangles(arm, most):
    fineness = solid_sets()[arm].fineness
    pieces = [drawn_link(link, fineness) for link in links_of(arm).values()]
    assert sum(len(mesh.faces) for piece in pieces for mesh in piece.visual) <= most
    assert all(len(mesh.faces) <= 64 for piece in pieces for mesh in piece.convex)


@pytest.mark.slow
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
        for link in links_of(arm).values()
    }
    for one, other in combinations(bodies, 2):
        shared = [overlap(a, b) for a in bodies[one] for b in bodies[other] if near(a, b)]
        assert sum(shared) < 1.0, (one, other)  # mm^3


def overlap(a: Shape, b: Shape) -> float:
    shared = a & b
    return volume(shared) if shared else 0.0


def near(a: Shape, b: Shape) -> bool:
    one, other = a.bounding_box(), b.bounding_box()
    return all(
        low <= high
        for axis in "XYZ"
        for low, high in (
            (getattr(one.min, axis), getattr(other.max, axis)),
            (getattr(other.min, axis), getattr(one.max, axis)),
        )
    )
