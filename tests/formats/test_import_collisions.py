"""Colliding meshes of robots and groups keep their cavities; of open meshes the ways are named."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

import trimesh

from tests.formats.test_import_looks import shapes_of
from trocar.descriptions.props import read_props
from trocar.descriptions.records import Shape
from trocar.descriptions.table import Table
from trocar.errors import InputError
from trocar.formats.importing import Imported, ImportOptions, import_file

needs_coacd = pytest.mark.skipif(
    find_spec("coacd") is None, reason="coacd is not installed (extra convex)"
)
#: Outer and inner edge and height of a square tube [m].
OUTER, INNER, HEIGHT = 0.1, 0.07, 0.05


def tube():
    """A square tube: a closed surface with a hole through it."""
    rings = [
        [(x, y, z) for x, y in ((-r, -r), (r, -r), (r, r), (-r, r))]
        for z in (0.0, HEIGHT)
        for r in (OUTER / 2, INNER / 2)
    ]
    vertices = np.array(rings).reshape(-1, 3)  # outer below, inner below, outer above, inner above
    faces: list[tuple[int, int, int]] = []
    for k in range(4):
        n = (k + 1) % 4
        for a, b, c, d in (
            (k, n, 8 + n, 8 + k),  # outside
            (4 + n, 4 + k, 12 + k, 12 + n),  # inside
            (n, k, 4 + k, 4 + n),  # below
            (8 + k, 8 + n, 12 + n, 12 + k),  # above
        ):
            faces += [(a, b, c), (a, c, d)]
    body = trimesh.Trimesh(vertices, faces)
    assert body.is_watertight
    assert body.volume == pytest.approx((OUTER**2 - INNER**2) * HEIGHT)
    return body


def robot(folder: Path, mesh: str, kind: str) -> Path:
    """A URDF or SDF of one link with a colliding mesh."""
    if kind == "urdf":
        text = (
            f'<robot name="a"><link name="l"><collision><geometry><mesh filename="{mesh}"/>'
            "</geometry></collision></link></robot>"
        )
    else:
        text = (
            '<sdf version="1.7"><model name="a"><link name="l"><collision name="c"><geometry>'
            f"<mesh><uri>{mesh}</uri></mesh></geometry></collision></link></model></sdf>"
        )
    (folder / f"a.{kind}").write_text(text, encoding="utf-8")
    return folder / f"a.{kind}"


def touched(found: Imported) -> list[Shape]:
    row = {"name": "thing", "description": found.file}
    (prop,) = read_props(Table({"prop": [row]}, "test.toml", ""), ())
    return [shape for shape in prop.shapes if shape.collide]


def inside(found: Imported, point: tuple[float, float, float]) -> bool:
    """Return whether a point is in any of the colliding hulls."""
    hulls = [ConvexHull(s.mesh.vertices).equations for s in touched(found) if s.mesh is not None]
    return any(bool((faces @ [*point, 1.0] <= 1e-9).all()) for faces in hulls)


@needs_coacd
@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_a_hole_through_a_robot_s_mesh_stays_open(kind: str, tmp_path: Path) -> None:
    tube().export(tmp_path / "tube.stl")
    file = robot(tmp_path, "tube.stl", kind)
    found = import_file(file, tmp_path / "out")
    assert found.pieces >= 4
    assert not inside(found, (0.0, 0.0, HEIGHT / 2))
    assert inside(found, ((OUTER + INNER) / 4, 0.0, HEIGHT / 2))
    hull = import_file(file, tmp_path / "hull", ImportOptions(hull=True))
    assert hull.pieces == 1
    assert inside(hull, (0.0, 0.0, HEIGHT / 2))
    more = 100.0 * (OUTER**2 / (OUTER**2 - INNER**2) - 1.0)
    assert any(f"hull is {more:.0f} % larger" in text for text in hull.warnings)


@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_a_convex_mesh_of_a_robot_is_one_piece_without_a_warning(kind: str, tmp_path: Path) -> None:
    trimesh.creation.icosphere(radius=0.05).export(tmp_path / "ball.stl")
    for hull in (False, True):
        options = ImportOptions(hull=hull, overwrite=True)
        found = import_file(robot(tmp_path, "ball.stl", kind), tmp_path / "out", options)
        assert found.pieces == 1
        assert not any("larger" in text for text in found.warnings)


def grouped(path: Path, key: str) -> None:
    """Write three boxes in a row, which touch, each in a group of an OBJ."""
    lines: list[str] = []
    for k in range(3):
        body = trimesh.creation.box([0.02, 0.02, 0.02 * (k + 1)])
        body.apply_translation([0.02 * k, 0.0, 0.0])
        lines.append(f"{key} piece_{k}")
        lines += [f"v {x} {y} {z}" for x, y, z in body.vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in body.faces + 1 + 8 * k]
    path.write_text("\n".join(lines), encoding="utf-8")


@pytest.mark.parametrize("key", ["o", "g"])
@pytest.mark.parametrize("kind", ["urdf", "sdf", "obj"])
def test_convex_groups_of_an_obj_stay_pieces(kind: str, key: str, tmp_path: Path) -> None:
    grouped(tmp_path / "pieces.obj", key)
    file = tmp_path / "pieces.obj" if kind == "obj" else robot(tmp_path, "pieces.obj", kind)
    found = import_file(file, tmp_path / "out")
    assert found.pieces == 3
    sizes = sorted(float(np.ptp(s.mesh.vertices[:, 2])) for s in touched(found) if s.mesh)
    assert sizes == pytest.approx([0.02, 0.04, 0.06])


def test_the_mass_of_groups_is_that_of_all(tmp_path: Path) -> None:
    grouped(tmp_path / "pieces.obj", "o")
    found = import_file(tmp_path / "pieces.obj", tmp_path / "out")
    assert found.mass == pytest.approx(1200.0 * 0.02**3 * (1 + 2 + 3))
    text = (tmp_path / "out" / "pieces.toml").read_text(encoding="utf-8")
    com = next(x for x in text.splitlines() if x.startswith("com_m")).partition("[")[2]
    assert float(com.split(",")[0]) == pytest.approx(0.02 * (1 * 2 + 2 * 3) / 6)


def test_separate_bodies_of_an_stl_stay_pieces(tmp_path: Path) -> None:
    parts = [trimesh.creation.box([0.02] * 3) for _ in range(4)]
    for k, part in enumerate(parts):
        part.apply_translation([0.05 * k, 0.0, 0.0])
    trimesh.util.concatenate(parts).export(tmp_path / "four.stl")
    assert import_file(tmp_path / "four.stl", tmp_path / "out").pieces == 4


def test_a_flat_colliding_mesh_gets_a_thickness(tmp_path: Path) -> None:
    plate = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]])
    plate.export(tmp_path / "plate.stl")
    found = import_file(robot(tmp_path, "plate.stl", "urdf"), tmp_path / "out")
    (shape,) = touched(found)
    assert shape.mesh is not None
    assert np.ptp(shape.mesh.vertices[:, 2]) == pytest.approx(1e-3)
    assert any("plate.stl: is flat" in text for text in found.warnings)


def open_tube():
    """The tube without its outside: what a scanner sees of a phantom."""
    body = tube()
    side = np.arange(32) % 8 < 2
    body.update_faces(~side)
    assert not body.is_watertight
    return body


def test_an_open_mesh_names_the_ways(tmp_path: Path) -> None:
    open_tube().export(tmp_path / "scan.stl")
    with pytest.raises(InputError, match=r"--open repair .* --open draw .* --hull"):
        import_file(tmp_path / "scan.stl", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_open_mesh_can_be_drawn_without_contact(tmp_path: Path) -> None:
    open_tube().export(tmp_path / "scan.stl")
    found = import_file(tmp_path / "scan.stl", tmp_path / "out", ImportOptions(open_as="draw"))
    assert found.pieces == 0
    assert found.triangles == 24
    assert len(shapes_of(found)) == 1
    assert any("no contact" in text for text in found.warnings)


def test_a_small_hole_is_closed(tmp_path: Path) -> None:
    box = trimesh.creation.box([0.1, 0.1, 0.1])
    box.update_faces(np.arange(12) != 5)
    box.export(tmp_path / "scan.stl")
    found = import_file(tmp_path / "scan.stl", tmp_path / "out", ImportOptions(open_as="repair"))
    assert found.pieces == 1
    assert found.mass == pytest.approx(1.2)


@pytest.mark.slow
@needs_coacd
def test_an_open_vessel_gets_walls_that_can_be_touched_and_stays_empty(tmp_path: Path) -> None:
    """A cup scanned as a single surface: four sides and a bottom."""
    cup = trimesh.creation.box([0.1, 0.1, 0.1]).subdivide().subdivide()
    top = cup.triangles_center[:, 2] > 0.0499
    cup.update_faces(~top)
    cup.export(tmp_path / "cup.stl")
    found = import_file(tmp_path / "cup.stl", tmp_path / "out", ImportOptions(open_as="repair"))
    assert found.pieces >= 1
    assert not inside(found, (0.0, 0.0, 0.02))
    assert inside(found, (0.0, 0.0, -0.05)) or inside(found, (0.0, 0.0, -0.049))
    assert inside(found, (0.05, 0.0, 0.0)) or inside(found, (0.049, 0.0, 0.0))
