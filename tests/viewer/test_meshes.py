"""Shapes as triangles and as glTF, and the camera that has them in view."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.live.fake_world import FakeWorld
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.simulation import World
from trocar.viewer.scene import (
    FIELD_OF_VIEW,
    VIEW,
    camera_for,
    corners,
    glb,
    half_extents,
    parts_of,
    primitive,
)

SIZES = {
    "box": (0.1, 0.2, 0.3),
    "cylinder": (0.05, 0.2, 0.0),
    "capsule": (0.05, 0.2, 0.0),
    "sphere": (0.05, 0.0, 0.0),
}
VOLUMES = {
    "box": 8 * 0.1 * 0.2 * 0.3,
    "cylinder": np.pi * 0.05**2 * 0.4,
    "capsule": np.pi * 0.05**2 * 0.4 + 4 / 3 * np.pi * 0.05**3,
    "sphere": 4 / 3 * np.pi * 0.05**3,
}


@pytest.mark.parametrize("kind", SIZES)
def test_a_primitive_is_closed_turned_outwards_and_as_large_as_the_shape(kind: str) -> None:
    mesh = primitive(kind, SIZES[kind])
    assert mesh.is_watertight
    # 28 sides around and rounded edges leave out a few percent of the true solid.
    assert VOLUMES[kind] * 0.95 < mesh.volume <= VOLUMES[kind] * 1.0001
    half = half_extents(kind, SIZES[kind])
    assert mesh.bounds == pytest.approx(np.array([-half, half]))


def test_a_box_takes_the_rounding_it_is_given() -> None:
    points = primitive("box", SIZES["box"], 0.05).vertices
    corner = points[np.argmax(points.sum(axis=1))]
    assert np.linalg.norm(corner - [0.05, 0.15, 0.25]) == pytest.approx(0.05)


def test_an_unknown_shape_is_refused() -> None:
    with pytest.raises(InputError, match=r"'torus'.*box, capsule, cylinder, sphere"):
        primitive("torus", (1.0,))


def test_shapes_of_one_body_become_a_mesh_per_material() -> None:
    shapes = [shape for shape in FakeWorld().shapes() if shape.body == 1]
    parts = parts_of(shapes)
    assert len(parts) == len({shape.rgba for shape in shapes}) == 2
    assert sum(len(part.faces) for part in parts) == sum(
        len(primitive(shape.kind, tuple(shape.size)).faces) for shape in shapes
    )


def test_normals_of_a_mesh_are_kept_and_a_mesh_without_is_drawn_flat() -> None:
    (shape, *_) = (s for s in World("psm").shapes() if s.normals is not None)
    assert shape.normals is not None
    normals = shape.normals @ shape.pose[:3, :3].T
    for count in (1, 2):
        (part,) = parts_of([shape] * count)
        np.testing.assert_allclose(part.vertex_normals, np.tile(normals, (count, 1)))
    (flat,) = parts_of([replace(shape, normals=None)])
    np.testing.assert_allclose(flat.vertex_normals[flat.faces][:, 0], flat.face_normals, atol=1e-6)


def test_the_glb_has_the_triangles_and_the_colours_as_linear_light() -> None:
    (ball,) = (s for s in FakeWorld().shapes() if s.body == 3 and s.kind == "sphere")
    ball = replace(ball, rgba=(0.5, 0.02, 1.0, 0.4), metal=0.8, gloss=0.7)
    (part,) = parts_of([ball])
    data = glb([part])
    assert data == glb(parts_of([ball]))  # unchanged bodies are recognised by their bytes
    (read,) = trimesh.load_scene(trimesh.util.wrap_as_stream(data), "glb").geometry.values()
    np.testing.assert_allclose(read.triangles, part.triangles, atol=1e-8)
    length = struct.unpack_from("<I", data, 12)[0]
    (material,) = json.loads(data[20 : 20 + length])["materials"]
    look = material["pbrMetallicRoughness"]
    # Source: IEC 61966-2-1: sRGB 0.5 is 0.2140 of the light, 0.02 lies on the straight part.
    # Colours have 8 bits.
    assert look["baseColorFactor"] == pytest.approx([0.2140, 0.02 / 12.92, 1.0, 0.4], abs=2e-3)
    assert (look["metallicFactor"], look["roughnessFactor"]) == pytest.approx((0.8, 0.3))
    assert material["alphaMode"] == "BLEND"


def test_all_vertices_are_inside_the_corners() -> None:
    world = FakeWorld()
    world.arms["PSM1"].q[:3] = 0.3, -0.2, 0.1
    now, found = world.snapshot(), []
    for shape in world.shapes():
        points = primitive(shape.kind, tuple(shape.size)).vertices
        points = points @ shape.pose[:3, :3].T + shape.pose[:3, 3]
        turn = matrix_from_quaternion(now.quaternions[shape.body])
        found.append(points @ turn.T + now.positions[shape.body])
    points, box = np.concatenate(found), corners(world.shapes(), now)
    low, high = box.min(axis=0), box.max(axis=0)
    # A turned cylinder is bounded by its box, whose corners reach a little further.
    assert np.all(low <= points.min(axis=0) + 1e-9) and np.all(high >= points.max(axis=0) - 1e-9)
    assert low == pytest.approx(points.min(axis=0), abs=0.05)
    assert high == pytest.approx(points.max(axis=0), abs=0.05)


@pytest.mark.parametrize("rig", ["psm", "ecm", "mtm", "pegs", "full_cart_mtm"])
def test_the_camera_has_all_arms_in_view_and_they_fill_it(rig: str) -> None:
    world = World(rig)
    arms = corners([shape for shape in world.shapes() if shape.arm], world.snapshot())
    position, target = camera_for(arms, VIEW)
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(forward, [0, 0, 1.0]))
    seen = (arms - position) @ np.stack([right, np.cross(right, forward), forward]).T
    across = np.abs(seen[:, :2] / seen[:, 2:]).max(axis=0) / np.tan(FIELD_OF_VIEW / 2)
    assert seen[:, 2].min() > 0.0
    assert 0.85 < across.max() <= 1.0
