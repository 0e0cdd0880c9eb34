"""Rings and cups: convex pieces that touch, and a smooth surface to look at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.descriptions.meshes import Mesh, open_edges, welded
from trocar.descriptions.records import Prop
from trocar.errors import DescriptionError

RIG = """
schema = 1
name = "rounds"
source = "a test"
[[arm]]
name = "PSM1"
description = "psm"
[[pose]]
name = "start"
[pose.q_rad_m]
PSM1 = [0, 0, 0.12, 0, 0, 0, 0]
[[prop]]
name = "thing"
movable = true
mass_g = 2
shape = [{ SHAPE, material = "red" }]
"""


def thing(tmp_path: Path, shape: str) -> Prop:
    file = tmp_path / "rig.toml"
    text = RIG.replace("SHAPE", shape)
    file.write_text(text, encoding="utf-8")
    return load_rig(file).objects[0]


def drawn(prop: Prop) -> Mesh:
    (mesh,) = (shape.mesh for shape in prop.shapes if shape.mesh is not None)
    return mesh


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_a_ring_is_rods_that_touch_and_a_torus_that_is_seen(tmp_path: Path) -> None:
    ring = thing(tmp_path, 'kind = "ring", radius_mm = 8, wire_radius_mm = 1.5')
    rods = [shape for shape in ring.shapes if shape.collide]
    assert len(rods) == 16 and not any(rod.visible for rod in rods)
    ends = [rod.pose @ [0, 0, z * rod.size[1], 1] for rod in rods for z in (-1, 1)]
    assert np.linalg.norm(np.array(ends)[:, :2], axis=1) == pytest.approx(0.008)
    mesh = drawn(ring)
    torus = 2.0 * np.pi**2 * 0.008 * 0.0015**2
    assert volume(mesh) == pytest.approx(
        torus, rel=0.04
    )  # corners cut it; above 0: it is not inside out
    assert open_edges(*welded(mesh.vertices, mesh.faces)) == 0
    # about its axis as a torus: m (R^2 + 3/4 r^2)
    assert ring.movable is not None
    expected = 0.002 * (0.008**2 + 0.75 * 0.0015**2)
    assert ring.movable.inertia[2, 2] == pytest.approx(expected, rel=0.05)


def test_a_ring_of_few_sides_has_corners_and_is_seen_as_it_touches(tmp_path: Path) -> None:
    ring = thing(tmp_path, 'kind = "ring", radius_mm = 13, wire_radius_mm = 1.5, sides = 3')
    assert [shape.kind for shape in ring.shapes] == ["capsule"] * 3
    assert all(shape.visible and shape.collide for shape in ring.shapes)
    middles = np.array([shape.pose[:3, 3] for shape in ring.shapes])
    assert np.linalg.norm(middles, axis=1) == pytest.approx(0.0065)


def test_a_cup_is_hollow_and_closed(tmp_path: Path) -> None:
    cup = thing(tmp_path, 'kind = "cup", radius_mm = 8, wall_mm = 1, height_mm = 10, floor_mm = 2')
    mesh = drawn(cup)
    solid = np.pi * (0.009**2 * 0.010 - 0.008**2 * 0.008)
    assert volume(mesh) == pytest.approx(solid, rel=0.01)
    boards = [shape for shape in cup.shapes if shape.kind == "box"]
    assert min(np.linalg.norm(b.pose[:2, 3]) - b.size[0] for b in boards) == pytest.approx(0.008)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (
            'kind = "ring", radius_mm = 8, wire_radius_mm = 0',
            "wire_radius: got 0; allowed: above 0",
        ),
        ('kind = "ring", radius_mm = 8, wire_radius_mm = 1, sides = 2', "sides: got 2; allowed: 3"),
        ('kind = "cup", radius_mm = 8, wall_mm = 1, height_mm = 10', "floor"),
    ],
)
def test_impossible_rounds_are_rejected(tmp_path: Path, shape: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        thing(tmp_path, shape)
