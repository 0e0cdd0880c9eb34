"""COLLADA files as exporters write them: all primitives, and references that lead nowhere."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from trocar.formats.links import ImportFileError
from trocar.formats.surfaces import read_surface

pytest.importorskip("collada", reason="pycollada is not installed (extra convex)")

#: The corners of a cube of 2 m, and its six faces, seen from outside anticlockwise.
CORNERS = "-1 -1 -1 1 -1 -1 1 1 -1 -1 1 -1 -1 -1 1 1 -1 1 1 1 1 -1 1 1"
FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def text_of(faces: object) -> str:
    return str(faces).translate(str.maketrans("", "", "(),"))


TRIANGLES = [t for a, b, c, d in FACES for t in ((a, b, c), (a, c, d))]
PRIMITIVES = {
    "triangles": '<triangles count="12" material="m">%s'
    f"<p>{text_of(TRIANGLES)[1:-1]}</p></triangles>",
    "polylist": '<polylist count="6" material="m">%s<vcount>4 4 4 4 4 4</vcount>'
    f"<p>{text_of(FACES)}</p></polylist>",
    "polygons": '<polygons count="6" material="m">%s'
    + "".join(f"<p>{text_of(face)}</p>" for face in FACES)
    + "</polygons>",
    "tristrips": '<tristrips count="6" material="m">%s'
    + "".join(f"<p>{a} {b} {d} {c}</p>" for a, b, c, d in FACES)
    + "</tristrips>",
    "trifans": '<trifans count="6" material="m">%s'
    + "".join(f"<p>{text_of(face)}</p>" for face in FACES)
    + "</trifans>",
}
VERTEX = '<input semantic="VERTEX" source="#v" offset="0"/>'
BINDING = """<bind_material><technique_common>
<instance_material symbol="m" target="#paint"/></technique_common></bind_material>"""
SCENE = """<library_visual_scenes><visual_scene id="s"><node>%s</node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>"""
SHOWN = SCENE % f'<instance_geometry url="#g">{BINDING}</instance_geometry>'
#: A material whose colour is an image.
TEXTURED = """<library_images><image id="i">%s</image></library_images>
<library_materials><material id="paint"><instance_effect url="#e"/></material></library_materials>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="f"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="a"><sampler2D><source>f</source></sampler2D></newparam>
<technique sid="common"><lambert><diffuse><texture texture="a" texcoord="u"/></diffuse></lambert>
</technique></profile_COMMON></effect></library_effects>"""
COLOURED = """<library_materials><material id="paint"><instance_effect url="#e"/></material>
</library_materials><library_effects><effect id="e"><profile_COMMON><technique sid="common">
<lambert><emission/><diffuse><color>0.2 0.4 0.6 1</color></diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>"""


def write(
    path: Path, primitive: str = "polylist", looks: str = COLOURED, scene: str = SHOWN,
    inputs: str = VERTEX, more: str = "",
) -> Path:  # fmt: skip
    path.write_text(
        f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Z_UP</up_axis></asset>{looks}
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="24">{CORNERS}</float_array><technique_common>
<accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
{PRIMITIVES[primitive] % inputs}{more}</mesh></geometry></library_geometries>{scene}</COLLADA>""",
        encoding="utf-8",
    )
    return path


def is_the_cube(path: Path, size: float = 2.0) -> bool:
    mesh = read_surface(path).whole
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6.0
    return len(mesh.faces) == 12 and volume == pytest.approx(size**3, rel=1e-6)


@pytest.mark.parametrize("primitive", PRIMITIVES)
def test_every_primitive_without_normals_is_read(primitive: str, tmp_path: Path) -> None:
    file = write(tmp_path / "a.dae", primitive)
    assert is_the_cube(file)
    assert [material for material, _ in read_surface(file).looks] == ["color_336699"]


@pytest.mark.parametrize("image", ["", "<init_from> </init_from>"])
def test_an_image_without_a_file_costs_no_triangles(image: str, tmp_path: Path) -> None:
    file = write(tmp_path / "a.dae", looks=TEXTURED % image)
    assert is_the_cube(file)
    found = read_surface(file)
    assert [material for material, _ in found.looks] == [""]
    assert found.notes == ("a.dae: image 'i' names no file: drawn without it",)


def test_a_material_that_does_not_exist_costs_no_triangles(tmp_path: Path) -> None:
    file = write(tmp_path / "a.dae", looks="")
    assert is_the_cube(file)
    assert "material 'paint' not found" in read_surface(file).notes[0]


@pytest.mark.parametrize("init", ["<init_from>a.png</init_from>",
                                  "<init_from><ref>a.png</ref></init_from>"])  # fmt: skip
@pytest.mark.parametrize("stride", [2, 3])
def test_a_texture_is_read_by_coordinates_of_two_or_three_numbers(
    stride: int, init: str, tmp_path: Path
) -> None:
    Image.new("RGB", (4, 4), (51, 102, 153)).save(tmp_path / "a.png")
    names = "".join(f'<param name="{name}" type="float"/>' for name in "STP"[:stride])
    numbers = " ".join(["0.5"] * stride * 8)
    source = (
        f'<source id="u"><float_array id="b" count="{8 * stride}">{numbers}</float_array>'
        f'<technique_common><accessor source="#b" count="8" stride="{stride}">{names}</accessor>'
        "</technique_common></source>"
    )
    file = write(
        tmp_path / "a.dae",
        looks=TEXTURED % init,
        inputs=VERTEX + '<input semantic="TEXCOORD" source="#u" offset="0" set="0"/>',
    )
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace('<vertices id="v">', f'{source}<vertices id="v">'), "utf-8")
    assert is_the_cube(file)
    assert [material for material, _ in read_surface(file).looks] == ["color_336699"]


@pytest.mark.parametrize("scene", ["", SHOWN.partition("<scene>")[0],
                                   SHOWN.replace("#s", "#other")])  # fmt: skip
def test_geometry_without_a_scene_is_shown(scene: str, tmp_path: Path) -> None:
    assert is_the_cube(write(tmp_path / "a.dae", scene=scene))


def test_a_skin_is_shown_as_it_was_bound(tmp_path: Path) -> None:
    skin = """<library_controllers><controller id="c"><skin source="#g">
<bind_shape_matrix>2 0 0 5 0 2 0 0 0 0 2 0 0 0 0 1</bind_shape_matrix></skin></controller>
</library_controllers>"""
    scene = skin + SCENE % f'<instance_controller url="#c">{BINDING}</instance_controller>'
    file = write(tmp_path / "a.dae", scene=scene)
    assert is_the_cube(file, size=4.0)
    assert read_surface(file).whole.vertices.mean(axis=0) == pytest.approx([5.0, 0.0, 0.0])


def test_places_of_nodes_and_of_nodes_in_the_library_add(tmp_path: Path) -> None:
    scene = (
        """<library_nodes><node id="n"><translate>0 0 3</translate>
<instance_geometry url="#g"/></node></library_nodes>"""
        + SCENE
        % (
            "<translate>1 0 0</translate><rotate>0 0 1 90</rotate><translate>4 0 0</translate>"
            '<instance_node url="#n"/>'
        )
    )
    middle = read_surface(write(tmp_path / "a.dae", scene=scene)).whole.vertices.mean(axis=0)
    assert middle == pytest.approx([1.0, 4.0, 3.0], abs=1e-6)


def test_a_file_that_is_no_xml_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.dae").write_text("<COLLADA><asset></COLLADA>", encoding="utf-8")
    with pytest.raises(ImportFileError, match=r"a.dae: is no XML: mismatched tag: line 1"):
        read_surface(tmp_path / "a.dae")


def test_decimal_commas_are_read_as_points(tmp_path: Path) -> None:
    """Exporters write the numbers of the language in which Windows runs."""
    file = write(tmp_path / "a.dae")
    text = file.read_text(encoding="utf-8").replace(CORNERS, CORNERS.replace("1", "0,5"))
    file.write_text(text, encoding="utf-8")
    assert is_the_cube(file, size=1.0)
    assert "a.dae: decimal commas read as points" in read_surface(file).notes


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_the_unit_is_read_in_every_encoding(encoding: str, tmp_path: Path) -> None:
    file = write(tmp_path / "a.dae")
    text = file.read_text(encoding="utf-8").replace("<asset>", '<asset><unit meter="0.01"/>')
    text = text.replace('<?xml version="1.0"?>', f'<?xml version="1.0" encoding="{encoding[:6]}"?>')
    file.write_text(text.replace('"utf-8-"', '"utf-8"'), encoding=encoding)
    assert is_the_cube(file, size=0.02)
