"""Shapes as triangles, and triangles as glTF."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.interfaces.viewer.glb import Finish, Part, pack
from trocar.interfaces.viewer.meshes import half_extents, mesh
from trocar.interfaces.viewer.scene import bounds, parts_of

from ..fake_world import FakeWorld

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
REACH = {"box": 0.3, "cylinder": 0.2, "capsule": 0.25, "sphere": 0.05}


@pytest.mark.parametrize("kind", SIZES)
def test_a_mesh_is_closed_and_turned_outwards(kind: str) -> None:
    vertices, faces = mesh(kind, SIZES[kind])
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = np.sum(np.cross(a, b) * c) / 6  # divergence theorem: positive when turned outwards
    # 28 sides around and softened edges leave out a few percent of the true solid.
    assert VOLUMES[kind] * 0.95 < volume <= VOLUMES[kind] * 1.0001
    area = np.cross(b - a, c - a) / 2
    assert np.abs(area.sum(axis=0)).max() < 1e-12  # of a closed surface they cancel


@pytest.mark.parametrize("kind", SIZES)
def test_a_mesh_reaches_exactly_as_far_as_the_shape(kind: str) -> None:
    vertices, _ = mesh(kind, SIZES[kind])
    assert vertices[:, 2].max() == pytest.approx(REACH[kind])
    assert vertices.max(axis=0) == pytest.approx(half_extents(kind, SIZES[kind]))
    assert vertices.min(axis=0) == pytest.approx(-half_extents(kind, SIZES[kind]))


def test_a_box_takes_the_rounding_it_is_given() -> None:
    round_box, _ = mesh("box", SIZES["box"], 0.05)
    corner = round_box[np.argmax(round_box.sum(axis=1))]
    assert np.linalg.norm(corner - [0.05, 0.15, 0.25]) == pytest.approx(0.05)


def test_an_unknown_shape_is_refused() -> None:
    with pytest.raises(InputError, match=r"'torus'.*box, capsule, cylinder, sphere"):
        mesh("torus", (1.0,))


def test_shapes_of_one_body_become_a_part_per_finish() -> None:
    shapes = [shape for shape in FakeWorld().shapes() if shape.body == 1]
    parts = parts_of(shapes)
    assert len(parts) == len({shape.rgba for shape in shapes}) == 2
    assert sum(len(part.faces) for part in parts) == sum(
        len(mesh(shape.kind, shape.size)[1]) for shape in shapes
    )
    for part in parts:
        assert part.faces.max() == len(part.vertices) - 1


def test_the_bounds_are_those_of_all_vertices() -> None:
    world = FakeWorld()
    world.arms["PSM1"].q[:3] = 0.3, -0.2, 0.1
    now, found = world.snapshot(), []
    for shape in world.shapes():
        points = mesh(shape.kind, shape.size)[0] @ shape.pose[:3, :3].T + shape.pose[:3, 3]
        turn = matrix_from_quaternion(now.quaternions[shape.body])
        found.append(points @ turn.T + now.positions[shape.body])
    points = np.concatenate(found)
    low, high = bounds(world.shapes(), now)
    # A turned cylinder is bounded by its box, whose corners reach a little further.
    assert np.all(low <= points.min(axis=0) + 1e-9) and np.all(high >= points.max(axis=0) - 1e-9)
    assert low == pytest.approx(points.min(axis=0), abs=0.05)
    assert high == pytest.approx(points.max(axis=0), abs=0.05)


def read_glb(data: bytes) -> tuple[dict, bytes]:
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and length % 4 == 0
    document = json.loads(data[20 : 20 + length])
    size, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0" and size % 4 == 0
    return document, data[28 + length :]


def test_a_packed_part_unpacks_to_the_same_triangles() -> None:
    vertices, faces = mesh("capsule", SIZES["capsule"])
    part = Part(vertices, faces, Finish((1.0, 0.5, 0.0, 1.0), metallic=0.8, roughness=0.3))
    document, blob = read_glb(pack([part, part]))
    assert document["buffers"][0]["byteLength"] == len(blob)
    for primitive in document["meshes"][0]["primitives"]:
        points = document["accessors"][primitive["attributes"]["POSITION"]]
        view = document["bufferViews"][points["bufferView"]]
        read = np.frombuffer(blob, "<f4", 3 * points["count"], view["byteOffset"]).reshape(-1, 3)
        assert np.allclose(read, vertices, atol=1e-8)
        indices = document["accessors"][primitive["indices"]]
        view = document["bufferViews"][indices["bufferView"]]
        read = np.frombuffer(blob, "<u4", indices["count"], view["byteOffset"])
        assert np.array_equal(read.reshape(-1, 3), faces)


def test_colours_are_written_as_linear_light() -> None:
    vertices, faces = mesh("sphere", SIZES["sphere"])
    document, _ = read_glb(pack([Part(vertices, faces, Finish((0.5, 0.02, 1.0, 0.4), 0.0, 1.0))]))
    material = document["materials"][0]
    colour = material["pbrMetallicRoughness"]["baseColorFactor"]
    # Source: IEC 61966-2-1: sRGB 0.5 is 0.2140 of the light, 0.02 lies on the straight part.
    assert colour == pytest.approx([0.2140, 0.02 / 12.92, 1.0, 0.4], abs=1e-4)
    assert material["alphaMode"] == "BLEND"
