"""From solids to files: triangles, normals, hulls, mass properties, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

pytest.importorskip("build123d", reason="solids need the extra cad")

from build123d import Box, Cylinder, Pos, Rot, Sphere, fillet
from build123d.topology import Face, Shape, Shell

from tools.cad.__main__ import main
from tools.cad.links import (
    MOST_TRIANGLES,
    Fineness,
    Link,
    Part,
    drawn,
    few_corners,
    hull_faces,
    tessellate,
    weigh,
)
from tools.cad.sets import make_solids, write_set
from trocar.descriptions.meshes import open_edges
from trocar.descriptions.solids import DATA, read_solid
from trocar.errors import TrocarError, UnknownNameError

FINE = Fineness(0.02, 0.05, angle=0.3)


def casting() -> Shape:
    block = Box(100, 60, 40)
    return Pos(10, 20, 30) * Rot(10, 20, 30) * (fillet(block.edges(), 8) - Cylinder(12, 100))


def enclosed(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, centre and second moments about the origin, by tetrahedra."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    total = a + b + c
    second = np.zeros((3, 3))
    for p in (a, b, c, total):
        second += np.einsum("i,ij,ik->jk", volumes, p, p) / 20
    return float(volumes.sum()), volumes @ total / 4 / volumes.sum(), second / volumes.sum()


def test_triangles_close_and_have_the_volume_of_the_solid() -> None:
    solid = casting()
    mesh = tessellate(solid, FINE)
    assert open_edges(mesh.vertices, mesh.faces) == 0
    assert enclosed(mesh.vertices, mesh.faces)[0] == pytest.approx(weigh([solid]).volume, rel=2e-3)


def test_normals_are_those_of_the_surface_and_not_of_triangles() -> None:
    mesh = tessellate(Pos(1, 2, 3) * Sphere(20), Fineness(1.0, 2.0))
    outward = (mesh.vertices - [1, 2, 3]) / 20
    np.testing.assert_allclose(mesh.normals, outward, atol=0.01)


def test_a_crease_stays_sharp_and_a_fillet_is_one_with_its_faces() -> None:
    assert len(tessellate(Box(1, 1, 1), FINE).vertices) == 24  # three normals a corner
    rod = tessellate(fillet(Cylinder(10, 30).edges(), 4), Fineness(0.5, 1.0))
    spots = np.unique(rod.vertices, axis=0)
    assert len(rod.vertices) <= len(spots) + 4  # but for the seam of the surface


def test_the_same_solid_gives_the_same_bytes() -> None:
    first, second = (tessellate(casting(), FINE) for _ in range(2))
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()


def test_a_solid_weighs_what_its_triangles_enclose() -> None:
    solids = [casting(), Pos(-80, 0, 0) * Box(10, 20, 30)]
    weight = weigh(solids)
    sums = [enclosed(m.vertices, m.faces) for m in (tessellate(s, FINE) for s in solids)]
    volume = sum(s[0] for s in sums)
    com = sum((s[0] * s[1] for s in sums), np.zeros(3)) / volume
    second = sum((s[0] * s[2] for s in sums), np.zeros((3, 3))) / volume - np.outer(com, com)
    assert weight.volume == pytest.approx(volume, rel=2e-3)
    np.testing.assert_allclose(weight.com, com, atol=0.05)
    gyration = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(weight.gyration, gyration, atol=2e-3 * np.trace(gyration))


def test_hulls_have_few_triangles_and_lie_inside() -> None:
    points = tessellate(Pos(5, 5, 5) * Sphere(30), Fineness(0.2, 0.5)).vertices
    chosen = few_corners(points, slack=0.0)
    corners, faces = hull_faces(chosen)
    assert len(faces) <= MOST_TRIANGLES and open_edges(corners, faces) == 0
    volume = enclosed(corners, faces)[0]
    assert 0.75 * ConvexHull(points).volume < volume <= ConvexHull(points).volume


def test_a_box_is_its_own_hull() -> None:
    corners, faces = hull_faces(few_corners(tessellate(Box(2, 4, 6), FINE).vertices))
    assert len(corners) == 8 and len(faces) == 12


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    link = Link(
        "arm", "yaw", (Part("cover", casting()), Part("steel", Pos(0, 0, 60) * Box(9, 9, 9)))
    )
    made = drawn(link, FINE)
    write_set(tmp_path / "mine", [made])
    solid = read_solid("mine/arm", tmp_path)
    assert solid.frame == "yaw" and [s.material for s in solid.visual] == ["cover", "steel"]
    for shape, piece in zip(solid.visual, made.visual, strict=True):
        assert shape.mesh is not None
        np.testing.assert_allclose(shape.mesh.vertices, piece.vertices * 1e-3, atol=1e-12)
        np.testing.assert_array_equal(shape.mesh.faces, piece.faces)
    assert solid.volume == pytest.approx(made.weight.volume * 1e-9, rel=1e-5)


def test_what_was_in_a_set_s_folder_is_gone_and_its_neighbours_stay(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "old.obj").touch()
    (tmp_path / "README.md").touch()
    write_set(tmp_path / "mine", [drawn(Link("a", "a", (Part("cover", Box(1, 1, 1)),)), FINE)])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["README.md", "mine"]
    assert not (tmp_path / "mine" / "old.obj").exists()


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Part("gold", Box(1, 1, 1)), r"a: part 0 \(gold\): unknown material; known: cover"),
        (Part("cover", Shell(Box(1, 1, 1).faces()[:5])), r"a: part 0 \(cover\): is not closed"),
        (Part("cover", Face.make_rect(2, 2)), "is not closed: 4 edges"),
    ],
)
def test_a_bad_part_is_named(part: Part, message: str) -> None:
    with pytest.raises(TrocarError, match=message):
        drawn(Link("a", "a", (part,)), FINE)


def test_an_unknown_set_is_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown set of solids 'psn'.*did you mean 'psm'"):
        list(make_solids(tmp_path / "new", ["psn"]))
    assert not (tmp_path / "new").exists()


def test_the_command_writes_what_the_package_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["-o", str(tmp_path), "--only", "table"]) == 0
    assert "table/table: " in capsys.readouterr().out
    for file in (DATA / "table").iterdir():
        assert (tmp_path / "table" / file.name).read_bytes() == file.read_bytes(), file.name


def test_without_the_library_the_extra_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "tools.cad.sets")
    monkeypatch.setitem(sys.modules, "tools.cad.links", None)
    assert main(["-o", str(tmp_path)]) == 1
    assert "build123d, which is not installed: pip install 'trocar[cad]'" in capsys.readouterr().err
