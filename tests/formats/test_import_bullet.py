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
