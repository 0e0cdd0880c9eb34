"""What files say of their look and size is kept: colours, textures, units, up axes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

import trimesh as trimesh_library
from PIL import Image

from tests.formats.texts import MJCF
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.props import read_props
from trocar.descriptions.table import Table
from trocar.errors import InputError
from trocar.formats.importing import Imported, ImportOptions, import_file
from trocar.formats.surfaces import MOST_COLOURS, SUFFIXES, read_surface

#: Without types.
trimesh: Any = trimesh_library
SKIN, BLUE = (0.93, 0.72, 0.60), (0.10, 0.20, 0.70)
EDGES = (0.10, 0.04, 0.02)


def box():
    return trimesh.creation.box(EDGES)


def shapes_of(found: Imported):
    row = {"name": "thing", "description": found.file}
    (prop,) = read_props(Table({"prop": [row]}, "test.toml", ""), ())
    return [shape for shape in prop.shapes if shape.visible]


def colours_of(found: Imported) -> list[tuple[float, ...]]:
    return [MATERIALS[shape.material].rgba[:3] for shape in shapes_of(found)]


def assert_colours(found: Imported, *expected: tuple[float, ...]) -> None:
    got = sorted(colours_of(found))
    assert len(got) == len(expected)
    for one, other in zip(got, sorted(expected), strict=True):
        assert one == pytest.approx(other, abs=0.5 / 255 + 1e-9)


def two_materials(folder: Path, *, library: bool = True) -> Path:
    """A box of which half the triangles are skin and half are blue, as modellers write them."""
    body = box()
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in body.vertices)
    faces = [f"f {a} {b} {c}\n" for a, b, c in body.faces + 1]
    text = f"mtllib two.mtl\n{corners}usemtl skin\n{''.join(faces[:6])}"
    (folder / "two.obj").write_text(f"{text}usemtl blue\n{''.join(faces[6:])}", encoding="utf-8")
    if library:
        rows = (f"newmtl {n}\nKd {r} {g} {b}\n" for n, (r, g, b) in
                (("skin", SKIN), ("blue", BLUE)))  # fmt: skip
        (folder / "two.mtl").write_text("".join(rows), encoding="utf-8")
    return folder / "two.obj"


def test_each_material_of_an_obj_is_a_mesh_of_its_colour(tmp_path: Path) -> None:
    found = import_file(two_materials(tmp_path), tmp_path / "out")
    assert_colours(found, SKIN, BLUE)
    assert found.triangles == 12
    assert found.pieces == 1  # the halves are open, the whole is a convex box


def test_a_material_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    found = import_file(two_materials(tmp_path, library=False), tmp_path / "out")
    assert any("material file 'two.mtl' not found" in text for text in found.warnings)
    assert [shape.material for shape in shapes_of(found)] == ["casting"]


@pytest.mark.parametrize("kind", ["color", "by name", "texture"])
def test_a_urdf_s_material_keeps_its_colour(kind: str, tmp_path: Path) -> None:
    look = f'<color rgba="{SKIN[0]} {SKIN[1]} {SKIN[2]} 1"/>'
    if kind == "texture":
        pixel = np.rint(255 * np.array(SKIN)).astype(np.uint8)
        Image.fromarray(np.tile(pixel, (4, 4, 1))).save(tmp_path / "skin.png")
        look = '<texture filename="skin.png"/>'
    above = f'<material name="skin">{look}</material>' if kind == "by name" else ""
    own = '<material name="skin"/>' if above else f'<material name="skin">{look}</material>'
    (tmp_path / "a.urdf").write_text(
        f'<robot name="a">{above}<link name="l"><visual><geometry><box size="0.1 0.1 0.1"/>'
        f"</geometry>{own}</visual></link></robot>",
        encoding="utf-8",
    )
    assert_colours(import_file(tmp_path / "a.urdf", tmp_path / "out"), SKIN)


def test_a_mesh_in_a_urdf_has_its_own_colours_unless_the_urdf_gives_one(tmp_path: Path) -> None:
    two_materials(tmp_path)
    mesh = '<visual><geometry><mesh filename="two.obj"/></geometry>{}</visual>'
    red = '<material name="r"><color rgba="0.5 0.1 0.1 1"/></material>'
    for name, look, expected in (("a", "", (SKIN, BLUE)), ("b", red, ((0.5, 0.1, 0.1),))):
        text = f'<robot name="{name}"><link name="l">{mesh.format(look)}</link></robot>'
        (tmp_path / f"{name}.urdf").write_text(text, encoding="utf-8")
        assert_colours(import_file(tmp_path / f"{name}.urdf", tmp_path / name), *expected)


@pytest.mark.parametrize(
    ("look", "expected"),
    [
        (f"<diffuse>{SKIN[0]} {SKIN[1]} {SKIN[2]} 1</diffuse>", SKIN),
        ("<ambient>0.1 0.2 0.7</ambient>", BLUE),
        ("<script><name>Gazebo/Orange</name></script>", (1.0, 0.5088, 0.0468)),
    ],
)
def test_an_sdf_s_material_keeps_its_colour(
    look: str, expected: tuple[float, ...], tmp_path: Path
) -> None:
    (tmp_path / "a.sdf").write_text(
        '<sdf version="1.7"><model name="a"><static>1</static><link name="l"><visual name="v">'
        f"<geometry><box><size>0.1 0.1 0.1</size></box></geometry><material>{look}</material>"
        "</visual></link></model></sdf>",
        encoding="utf-8",
    )
    assert_colours(import_file(tmp_path / "a.sdf", tmp_path / "out"), expected)


def test_geoms_of_an_mjcf_keep_their_colours(tmp_path: Path) -> None:
    text = MJCF.format(block=0.0, rest=0.1).replace(
        '<geom type="box"', f'<geom rgba="{SKIN[0]} {SKIN[1]} {SKIN[2]} 1" type="box"'
    )
    (tmp_path / "a.xml").write_text(text, encoding="utf-8")
    found = import_file(tmp_path / "a.xml", tmp_path / "out", ImportOptions(kind="prop"))
    grey = MATERIALS["casting"].rgba[:3]
    assert_colours(found, SKIN, grey, grey)


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_faces_keep_their_colours(suffix: str, tmp_path: Path) -> None:
    body = box()
    body.unmerge_vertices()  # glTF has colours of corners
    colours = np.array([[*SKIN, 1.0]] * 6 + [[*BLUE, 1.0]] * 6)
    if suffix == ".glb":  # which has linear light: the inverse of what the import does
        rgb = colours[:, :3]
        colours[:, :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    eight = np.rint(255 * colours).astype(np.uint8)
    body.visual.vertex_colors = np.repeat(eight, 3, axis=0)
    body.export(tmp_path / f"a{suffix}")
    got = sorted(colours_of(import_file(tmp_path / f"a{suffix}", tmp_path / "out")))
    np.testing.assert_allclose(got, sorted([SKIN, BLUE]), atol=0.01)  # 8 bits of dark light


def textured(pixels: np.ndarray):
    """A finely divided box whose texture is laid on from above."""
    body = box().subdivide().subdivide().subdivide()
    uv = body.vertices[:, :2] / EDGES[:2] + 0.5
    image = Image.fromarray(pixels.astype(np.uint8))
    body.visual = trimesh.visual.TextureVisuals(uv=uv, image=image)
    return body


def test_a_texture_becomes_colours_where_they_are_in_the_picture(tmp_path: Path) -> None:
    pixels = np.zeros((64, 64, 3))
    pixels[:, :32], pixels[:, 32:] = (200, 30, 20), (20, 40, 210)  # left red, right blue
    textured(pixels).export(tmp_path / "a.obj")
    surface = read_surface(tmp_path / "a.obj")
    assert any("texture replaced by" in note for note in surface.notes)
    for material, mesh in surface.looks:
        red, _, blue = MATERIALS[material].rgba[:3]
        middle = mesh.vertices[mesh.faces].mean(axis=1)[:, 0]
        if red > 0.75:
            assert middle.max() < 0.01
        if blue > 0.75:
            assert middle.min() > -0.01


def test_a_photograph_becomes_a_few_colours(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    textured(rng.integers(0, 255, (64, 64, 3))).export(tmp_path / "a.obj")
    found = import_file(tmp_path / "a.obj", tmp_path / "out")
    assert 1 < len(shapes_of(found)) <= MOST_COLOURS
    assert found.triangles == 12 * 4**3
    assert any("texture replaced by" in text for text in found.warnings)


def test_transparency_is_said_to_be_lost(tmp_path: Path) -> None:
    file = two_materials(tmp_path)
    library = tmp_path / "two.mtl"
    library.write_text(library.read_text("utf-8") + "d 0.4\n", encoding="utf-8")
    assert any("transparency" in text for text in import_file(file, tmp_path / "o").warnings)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_listed_format_is_read_with_its_size_and_z_up(suffix: str, tmp_path: Path) -> None:
    body = box()
    if suffix in (".glb", ".gltf", ".dae"):  # y is up in these
        body.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    if suffix == ".gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(body)).items():
            (tmp_path / name.replace("model.gltf", "a.gltf")).write_bytes(data)
    else:
        body.export(tmp_path / f"a{suffix}")
    found = import_file(tmp_path / f"a{suffix}", tmp_path / "out")
    assert found.size == pytest.approx(EDGES, rel=1e-6)
    assert (found.triangles, found.pieces) == (12, 1)


def test_the_extra_of_meshes_has_what_each_format_needs() -> None:
    import tomllib

    with (Path(__file__).parents[2] / "pyproject.toml").open("rb") as file:
        extras = tomllib.load(file)["project"]["optional-dependencies"]
    names = {row.split(">")[0].split("=")[0] for row in extras["convex"]}
    assert {"trimesh", "coacd", "pycollada"} <= names
    assert "convex" in extras["all"][0]


COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="inch" meter="{unit}"/><up_axis>{up}_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">{corners}</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 3 1 2 3 2 0 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
#: A corner of edges along right, up and towards the viewer, 1, 2 and 3 long: {up: x, y, z of each}.
#: Source: COLLADA 1.5, <up_axis>.
CORNER = {
    "Z": ((1, 0, 0), (0, 0, 2), (0, -3, 0)),
    "Y": ((1, 0, 0), (0, 2, 0), (0, 0, 3)),
    "X": ((0, -1, 0), (2, 0, 0), (0, 0, 3)),
}


@pytest.mark.parametrize("up", CORNER)
@pytest.mark.parametrize("unit", [0.0254, 0.01])
def test_a_collada_file_s_unit_and_axis_are_applied(up: str, unit: float, tmp_path: Path) -> None:
    pytest.importorskip("collada", reason="pycollada is not installed (extra convex)")
    corners = " ".join(str(v) for point in ((0, 0, 0), *CORNER[up]) for v in point)
    text = COLLADA.format(unit=unit, up=up, corners=corners)
    (tmp_path / "a.dae").write_text(text, encoding="utf-8")
    expected = unit * np.array([[0, 0, 0], *CORNER["Z"]])
    alone = read_surface(tmp_path / "a.dae")
    assert sorted(alone.whole.vertices.tolist()) == pytest.approx(
        np.array(sorted(expected.tolist())), abs=1e-9
    )
    assert any(f"unit of {unit:g} m applied" in note for note in alone.notes)
    # In a URDF, scaled.
    mesh = '<mesh filename="a.dae" scale="2 2 2"/>'
    robot = f'<robot name="a"><link name="l"><visual><geometry>{mesh}</geometry></visual></link>'
    (tmp_path / "a.urdf").write_text(f"{robot}</robot>", encoding="utf-8")
    found = import_file(tmp_path / "a.urdf", tmp_path / "out")
    assert found.size == pytest.approx(2.0 * np.ptp(expected, axis=0), rel=1e-6)
    # Overridden.
    again = import_file(tmp_path / "a.dae", tmp_path / "again", ImportOptions(unit="mm", up="z"))
    own = np.ptp(1e-3 * np.array([[0, 0, 0], *CORNER[up]]), axis=0)
    assert again.size == pytest.approx(own, rel=1e-6)
    assert any("--unit mm replaces the file's unit" in text for text in again.warnings)


@pytest.mark.parametrize(
    ("line", "factor"),
    [
        ("# Units: millimeters", 1e-3),
        ("# unit = cm", 1e-2),
        ("# millimetres", 1e-3),
        ("# made in an inch of time", 1.0),
    ],
)
def test_a_unit_in_an_obj_s_comment_is_applied(line: str, factor: float, tmp_path: Path) -> None:
    text = trimesh.exchange.obj.export_obj(box())
    (tmp_path / "a.obj").write_text(f"{line}\n{text}", encoding="utf-8")
    vertices = read_surface(tmp_path / "a.obj").whole.vertices
    assert np.ptp(vertices, axis=0) == pytest.approx(factor * np.array(EDGES), rel=1e-6)


def test_an_imported_mesh_can_be_imported_again(tmp_path: Path) -> None:
    """Ours are in millimetres, and their first line says so."""
    box().export(tmp_path / "a.stl")
    first = import_file(tmp_path / "a.stl", tmp_path / "out")
    mesh = min((tmp_path / "out" / "meshes").iterdir())
    assert import_file(mesh, tmp_path / "again").size == pytest.approx(first.size, rel=1e-9)


@pytest.mark.parametrize(("edge", "doubt"), [(2.0, "2 x 2 x 2 m large"), (0.3, "weighs 32.4 kg")])
def test_an_absurd_size_or_mass_is_doubted(edge: float, doubt: str, tmp_path: Path) -> None:
    trimesh.creation.box([edge] * 3).export(tmp_path / "a.stl")
    found = import_file(tmp_path / "a.stl", tmp_path / "out")
    assert any(doubt in text for text in found.warnings)
    trimesh.creation.box([0.1] * 3).export(tmp_path / "b.stl")
    warnings = import_file(tmp_path / "b.stl", tmp_path / "b").warnings
    assert not any("check its unit" in text for text in warnings)


def test_unknown_units_and_axes_are_refused(tmp_path: Path) -> None:
    box().export(tmp_path / "a.stl")
    with pytest.raises(InputError, match="got the up axis 'w'; allowed: x, y, z"):
        import_file(tmp_path / "a.stl", tmp_path / "out", ImportOptions(up="w"))
    with pytest.raises(InputError, match="got the unit 'ft'; allowed: m, mm, cm, in"):
        import_file(tmp_path / "a.stl", tmp_path / "out", ImportOptions(unit="ft"))


def test_coordinates_of_a_texture_without_a_material_give_no_colour(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n"
    faces = ("1 3 2", "1 2 4", "2 3 4", "3 1 4")
    for face in faces:
        a, b, c = face.split()
        text += f"f {a}/1 {b}/2 {c}/3\n"
    (tmp_path / "bare.obj").write_text(text, encoding="utf-8")
    found = read_surface(tmp_path / "bare.obj")
    assert [material for material, _ in found.looks] == [""]
    assert found.notes == ()
