"""Meshes from STL and OBJ files: the same triangles whatever the format, and each fault named."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_tool
from trocar.descriptions.catalogue import DATA
from trocar.descriptions.meshes import Mesh, read_mesh
from trocar.descriptions.shapes import read_shapes
from trocar.descriptions.table import Table, parse_table
from trocar.errors import DescriptionError

TOOL = DATA / "tools" / "LARGE_NEEDLE_DRIVER_400006.toml"
#: A pyramid on a square of 2 mm, 3 mm high.
POINTS = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 3]])
FACES = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [2, 1, 0], [3, 2, 0]]


def ascii_stl() -> bytes:
    lines = ["solid pyramid of 6"]
    for face in FACES:
        lines += ["  facet normal 0 0 0", "    outer loop"]
        lines += [f"      vertex {x} {y} {z}" for x, y, z in POINTS[face]]
        lines += ["    endloop", "  endfacet"]
    return "\n".join([*lines, "endsolid"]).encode()


def binary_stl() -> bytes:
    data = b"solid in the header of a binary file".ljust(80) + struct.pack("<I", len(FACES))
    for face in FACES:
        data += struct.pack("<12fH", 0, 0, 0, *POINTS[face].ravel(), 0)
    return data


def obj() -> bytes:
    lines = ["# a pyramid", *(f"v {x} {y} {z}" for x, y, z in POINTS), "vn 0 0 1", "usemtl grey"]
    lines += [f"f {a + 1}//1 {b + 1}//1 {c + 1}//1" for a, b, c in FACES[:4]]
    return "\n".join([*lines, "f -2 -3 -4 -5"]).encode()  # the square, from the end


def read(folder: Path, name: str, data: bytes, **more: object) -> Mesh:
    (folder / name).write_bytes(data)
    return read_mesh(Table({"file": name, **more}, str(folder / "tool.toml"), "body[4].shape[1]"))


@pytest.mark.parametrize(
    ("name", "data"), [("a.stl", ascii_stl()), ("b.STL", binary_stl()), ("c.obj", obj())]
)
def test_every_format_gives_the_same_solid(name: str, data: bytes, tmp_path: Path) -> None:
    mesh = read(tmp_path, name, data)
    assert mesh.vertices.shape == (5, 3) and mesh.faces.shape == (6, 3)
    corners = mesh.vertices[mesh.faces]
    volume = np.linalg.det(corners).sum() / 6  # of what closed triangles enclose
    assert volume == pytest.approx(4e-9, rel=1e-6)  # 1/3 of 2 mm x 2 mm x 3 mm


def test_an_obj_files_normals_are_kept_and_edges_stay_sharp(tmp_path: Path) -> None:
    # Two triangles share an edge: with one normal along it, then with two.
    points = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 -1\nvn 0 0 2\nvn 1 0 1\n"
    smooth = read(tmp_path, "s.obj", points + b"f 1//1 2//2 3//2\nf 2//2 4//2 3//2\n")
    sharp = read(tmp_path, "h.obj", points + b"f 1//1 2//1 3//1\nf 2/7/2 4/7/2 3/7/2\n")
    bare = read(tmp_path, "b.obj", points + b"f 1//1 2//1 3//1\nf 2 4 3\n")
    assert smooth.normals is not None and smooth.vertices.shape == (4, 3)
    assert np.allclose(np.linalg.norm(smooth.normals, axis=1), 1.0)
    assert sharp.normals is not None and sharp.vertices.shape == (6, 3)
    assert np.allclose(sharp.normals[sharp.faces[0]], [0.0, 0.0, 1.0])
    assert bare.normals is None and bare.vertices.shape == (4, 3)


def test_the_scale_is_the_length_of_a_unit(tmp_path: Path) -> None:
    inches = read(tmp_path, "a.stl", ascii_stl(), scale_mm=25.4)
    assert inches.vertices.max() == pytest.approx(3 * 25.4e-3)


@pytest.mark.parametrize(
    ("name", "data", "problem"),
    [
        ("a.step", b"", r"got 'a.step'; allowed: a file that ends in .stl, .obj"),
        ("a.stl", b"solid empty\nendsolid\n", r"a.stl has no triangles"),
        ("a.stl", b"\x00" * 50, r"a.stl is no STL file: it neither starts with `solid` nor"),
        ("a.stl", binary_stl()[:-7], r"a.stl is no STL file"),
        ("a.stl", ascii_stl().replace(b"vertex -1", b"vertex one", 1), r"no STL file: could not"),
        ("a.stl", ascii_stl().replace(b"0 0 3", b"0 0 nan").replace(b"0.0 0.0 3.0", b"0 0 nan"),
         r"has coordinates that are not finite"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", r"face 1 2 9 has a corner that is not there"),
        ("a.obj", b"v 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n", r"a corner is a line `v x y z`"),
        ("a.obj", b"\xff\xfe", r"a.obj is no OBJ file"),
    ],
)  # fmt: skip
def test_a_fault_in_a_mesh_is_named(name: str, data: bytes, problem: str, tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match=problem) as caught:
        read(tmp_path, name, data)
    assert str(caught.value).startswith(f"{tmp_path / 'tool.toml'}: body[4].shape[1].file: ")


def test_too_many_triangles_are_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trocar.descriptions.meshes.MOST_TRIANGLES", 5)
    with pytest.raises(DescriptionError, match=r"has 6 triangles; allowed: up to 5"):
        read(tmp_path, "a.stl", ascii_stl())


@pytest.mark.parametrize(
    ("shape", "problem"),
    [
        ('kind = "mesh"', r"shape\[0\].file: is missing"),
        ('kind = "mesh", file = "gone.stl"', r"gone.stl cannot be read: No such file"),
        ('kind = "mesh", file = "a.stl", weigh = true', r"weigh: got true; allowed: false"),
        ('kind = "mesh", file = "a.stl", scale_mm = 0.0', r"scale: got 0; allowed: above 0"),
        ('kind = "mesh", file = "a.stl", hull = "capsule"', r"hull: unknown key"),
        ('kind = "mesh", file = "a.stl"', r"inertia_kgm2: is missing, and there is no shape"),
    ],
)
def test_a_fault_in_a_tool_s_mesh_is_named(shape: str, problem: str, tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(ascii_stl())
    text = TOOL.read_text(encoding="utf-8")
    head, tail = text.split('[[body]]\nframe = "finger_left"\n')
    rest = tail[tail.index("[[body]]") :]
    body = f'[[body]]\nframe = "finger_left"\nmass_kg = 0.00004\nshape = [{{ {shape} }}]\n\n'
    (tmp_path / "tool.toml").write_text(head + body + rest, encoding="utf-8")
    with pytest.raises(DescriptionError, match=problem):
        load_tool(tmp_path / "tool.toml")


def test_a_mesh_touches_as_its_convex_hull_and_may_be_unseen(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(ascii_stl())
    table = parse_table(
        'shape = [{ kind = "mesh", file = "a.stl", collide = true, visible = false }]',
        str(tmp_path / "tool.toml"),
    )
    (shape,) = read_shapes(table)
    assert (shape.collide, shape.visible, shape.weigh) == (True, False, False)
