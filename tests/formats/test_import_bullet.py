"""URDF in Bullet's dialect: its header, <contact>, and inertias that are placeholders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from tests.formats.test_import_collisions import touched
from trocar.errors import InputError
from trocar.formats.importing import import_file

BLOCK = """<?xml version="{version}"?>
<robot name="block"><link name="base">
 <contact><lateral_friction value="0.8"/><rolling_friction value="0.01"/>
  <contact_erp value="1.0"/></contact>
 <inertial><mass value="0.01"/>
  <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>
 <visual><geometry><box size="0.02 0.02 0.02"/></geometry></visual>
 <collision concave="yes"><geometry><box size="0.02 0.02 0.02"/></geometry></collision>
</link></robot>"""
#: Inertia of the block [kg m^2].
TRUE = 0.01 * 2 * 0.02**2 / 12


def block(folder: Path, version: str = "0.0", inertia: float = TRUE) -> Path:
    text = BLOCK.format(version=version, inertia=inertia)
    (folder / "block.urdf").write_text(text, encoding="utf-8")
    return folder / "block.urdf"


def inertia_of(file: str) -> list[float]:
    text = Path(file).read_text(encoding="utf-8")
    line = next(x for x in text.splitlines() if x.startswith("inertia_kgm2"))
    return [float(v) for v in line.partition("[")[2].rstrip("]").split(",")]


@pytest.mark.parametrize("version", ["0.0", "1.0", "1.1", "2"])
def test_a_header_of_any_version_is_read(version: str, tmp_path: Path) -> None:
    assert import_file(block(tmp_path, version), tmp_path / "out").pieces == 1


def test_lateral_friction_is_taken_and_the_rest_named(tmp_path: Path) -> None:
    found = import_file(block(tmp_path), tmp_path / "out")
    assert [shape.friction for shape in touched(found)] == [0.8]
    ignored = [text for text in found.warnings if "of <contact> is ignored" in text]
    assert ["rolling_friction" in text or "contact_erp" in text for text in ignored] == [True] * 2


@pytest.mark.parametrize("tag", ["lateral_fricton", "inertia"])
def test_an_unknown_contact_is_refused(tag: str, tmp_path: Path) -> None:
    file = block(tmp_path)
    text = file.read_text(encoding="utf-8").replace("lateral_friction", tag)
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=f"<{tag}> is unknown inside <contact>; allowed: lateral_"):
        import_file(file, tmp_path / "out")


def test_an_inertia_beyond_mass_and_size_is_replaced(tmp_path: Path) -> None:
    found = import_file(block(tmp_path, inertia=1.0), tmp_path / "out")
    assert inertia_of(found.file)[:3] == pytest.approx([TRUE] * 3, rel=1e-6)
    assert any("1 kg m^2, where 0.01 kg within 0.0173 m" in text for text in found.warnings)


@pytest.mark.parametrize("factor", [0.1, 1.0, 5.0])
def test_a_plausible_inertia_is_kept(factor: float, tmp_path: Path) -> None:
    found = import_file(block(tmp_path, inertia=factor * TRUE), tmp_path / "out")
    assert inertia_of(found.file)[:3] == pytest.approx([factor * TRUE] * 3, rel=1e-9)
    assert not any("no possible body" in text for text in found.warnings)


def test_a_shape_of_no_size_is_left_out_and_named(tmp_path: Path) -> None:
    file = block(tmp_path)
    none = '<visual><geometry><box size="0 0 0"/></geometry></visual><collision concave'
    text = file.read_text(encoding="utf-8").replace("<collision concave", none)
    file.write_text(text, encoding="utf-8")
    found = import_file(file, tmp_path / "out")
    assert any("<box> of no size" in warning for warning in found.warnings)
    assert np.allclose(found.size, 0.02)


def changed(folder: Path, old: str, new: str) -> Path:
    file = block(folder)
    file.write_text(file.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("old", "new", "tags"),
    [
        ("<contact>", "<geometry/><material/><contact>", "<geometry> inside <link>"),
        ('<link name="base">', '<frame/><link name="base">', "<frame> inside <robot>"),
        ("<visual>", "<visual><bullet/>", "<bullet> inside <visual>"),
        ('<collision concave="yes">', "<collision><skin/>", "<skin> inside <collision>"),
        ("<geometry>", "<geometry><material/>", "<material> inside <geometry>"),
    ],
)
def test_an_unknown_element_is_ignored_and_named(
    old: str, new: str, tags: str, tmp_path: Path
) -> None:
    """As RViz's and Bullet's readers do, in silence."""
    found = import_file(changed(tmp_path, old, new), tmp_path / "out")
    assert found.pieces == 1
    assert any(f"{tags} is unknown and ignored" in text for text in found.warnings)


@pytest.mark.parametrize("tag", ["colision", "visuall", "inertail"])
def test_a_misspelled_element_is_refused(tag: str, tmp_path: Path) -> None:
    file = changed(tmp_path, "<contact>", f"<{tag}/><contact>")
    with pytest.raises(InputError, match=f"<{tag}> is unknown inside <link>: did you mean <"):
        import_file(file, tmp_path / "out")


@pytest.mark.parametrize("shape", ['<plane normal="0 0 1"/>', '<cdf filename="a.cdf"/>'])
def test_a_colliding_shape_without_a_solid_is_ignored_and_named(shape: str, tmp_path: Path) -> None:
    old = '<collision concave="yes"><geometry><box size="0.02 0.02 0.02"/></geometry></collision>'
    new = f"<collision><geometry>{shape}</geometry></collision>"
    found = import_file(changed(tmp_path, old, new), tmp_path / "out")
    assert found.pieces == 0
    tag = shape[1:].partition(" ")[0]
    assert f"<{tag}> of a <collision> is ignored" in found.warnings


@pytest.mark.parametrize("blank", ["\n", "  \n\n", "\ufeff\n"])
def test_blank_lines_before_the_header_are_read(blank: str, tmp_path: Path) -> None:
    file = changed(tmp_path, '<?xml version="0.0"?>', blank + '<?xml version="1.0"?>')
    assert import_file(file, tmp_path / "out").pieces == 1
    text = file.read_text(encoding="utf-8").replace("<visual>", "<wrong></visual>")
    file.write_text(text, encoding="utf-8")
    line = 1 + text[: text.index("<wrong>")].count("\n")
    with pytest.raises(InputError, match=f"block.urdf:{line}: is not XML"):
        import_file(file, tmp_path / "out2")


def test_limits_the_other_way_round_mean_none(tmp_path: Path) -> None:
    """Source: Bullet's URDF reader: a hinge with lower above upper is free."""
    more = """<link name="tip"><inertial><mass value="0.1"/>
 <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
 <limit lower="1" upper="0" effort="1" velocity="1"/></joint></robot>"""
    found = import_file(changed(tmp_path, "</robot>", more), tmp_path / "out")
    assert found.joints == ("hinge",)
    assert "joint hinge: limits 1 to 0 mean none, as in Bullet" in found.warnings


def test_a_robot_of_absurd_size_is_told_of_its_meshes_scale(tmp_path: Path) -> None:
    file = changed(tmp_path, '<box size="0.02 0.02 0.02"/>', '<box size="200 20 20"/>')
    with pytest.raises(InputError, match=r'in mm it would be plausible: scale="..." of its <mesh>'):
        import_file(file, tmp_path / "out")
