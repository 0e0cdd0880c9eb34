"""Meshes become props: weighed, taken apart, refused with what to do where they are no body."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.descriptions.records import RigDescription
from trocar.errors import InputError
from trocar.formats.importing import ImportOptions, import_file
from trocar.simulation import World

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

needs_coacd = pytest.mark.skipif(
    find_spec("coacd") is None,
    reason="coacd is not installed (extra convex)",
)


def bracket():
    """An L of two boxes, 0.1 m long and 0.02 m thick: no convex body."""
    flat = trimesh.creation.box([0.1, 0.05, 0.02])
    upright = trimesh.creation.box([0.02, 0.05, 0.08])
    upright.apply_translation([-0.04, 0.0, 0.05])
    return trimesh.boolean.union([flat, upright])


def rig_with(prop: str, folder: Path) -> RigDescription:
    (folder / "rig.toml").write_text(
        'schema = 1\nname = "bench"\nsource = "test"\n'
        '[[arm]]\nname = "PSM1"\ndescription = "psm"\non = "world"\nxyz_m = [0.0, 0.0, 0.5]\n'
        f'[[prop]]\nname = "thing"\ndescription = "{prop}"\nxyz_m = [0.3, 0.0, 0.1]\n'
        '[[pose]]\nname = "start"\n[pose.q_rad_m]\nPSM1 = [0, 0, 0.12, 0, 0, 0, 0]\n',
        encoding="utf-8",
    )
    return load_rig(folder / "rig.toml")


@needs_coacd
@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".glb"])
def test_a_bracket_is_taken_apart_and_stands_in_a_rig(suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("manifold3d", reason="trimesh needs manifold3d to draw the bracket")
    bracket().export(tmp_path / f"bracket{suffix}")
    found = import_file(tmp_path / f"bracket{suffix}", tmp_path / "thing", ImportOptions(mass=0.4))
    assert (found.kind, found.mass) == ("prop", 0.4)
    assert 2 <= found.pieces <= 8
    rig = rig_with("thing/bracket.toml", tmp_path)
    (prop,) = rig.props
    seen = [s for s in prop.shapes if s.visible]
    touched = [s for s in prop.shapes if s.collide]
    assert len(seen) == 1 and len(touched) == found.pieces
    world = World(rig)
    world.step(10)
    assert len([s for s in world.shapes() if s.kind == "mesh"]) >= 1


@needs_coacd
def test_the_pieces_fill_the_body_and_little_more(tmp_path: Path) -> None:
    pytest.importorskip("manifold3d", reason="trimesh needs manifold3d to draw the bracket")
    body = bracket()
    body.export(tmp_path / "bracket.stl")
    import_file(tmp_path / "bracket.stl", tmp_path / "thing")
    rig = rig_with("thing/bracket.toml", tmp_path)
    pieces = [s.mesh for s in rig.props[0].shapes if s.collide and s.mesh is not None]
    filled = sum(trimesh.Trimesh(p.vertices, p.faces).convex_hull.volume for p in pieces)
    assert filled == pytest.approx(body.volume, rel=0.05)
    assert body.convex_hull.volume > 1.5 * body.volume


def test_mass_and_inertia_are_those_of_the_solid(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.02)
    ball.apply_translation([0.1, 0.0, 0.0])
    ball.export(tmp_path / "ball.stl")
    found = import_file(tmp_path / "ball.stl", tmp_path / "out")
    assert found.mass == pytest.approx(1200.0 * 4.0 / 3.0 * np.pi * 0.02**3, rel=5e-3)
    text = (tmp_path / "out" / "ball.toml").read_text(encoding="utf-8")
    line = next(x for x in text.splitlines() if x.startswith("inertia_kgm2"))
    values = [float(v) for v in line.partition("[")[2].rstrip("]").split(",")]
    assert values[:3] == pytest.approx([0.4 * found.mass * 0.02**2] * 3, rel=5e-3)
    assert "com_m = [0.1" in text.replace("0.09999", "0.1")


def test_units_are_told_or_noticed(tmp_path: Path) -> None:
    needle = trimesh.creation.cylinder(radius=0.4, height=100.0)  # millimetres
    needle.export(tmp_path / "needle.stl")
    with pytest.raises(
        InputError, match=r"got a size of 100 m; allowed: 0.0005 to 10 m; in mm .*--unit"
    ):
        import_file(tmp_path / "needle.stl", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    found = import_file(tmp_path / "needle.stl", tmp_path / "out", ImportOptions(unit="mm"))
    assert found.mass == pytest.approx(1200.0 * np.pi * 4e-4**2 * 0.1, rel=0.02)


def test_a_surface_with_a_hole_is_refused_and_its_hull_offered(tmp_path: Path) -> None:
    box = trimesh.creation.box([0.1, 0.1, 0.1])
    box.update_faces(np.arange(len(box.faces)) > 1)
    box.export(tmp_path / "box.stl")
    with pytest.raises(InputError, match=r"not watertight: 4 edges .* --hull takes the convex"):
        import_file(tmp_path / "box.stl", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    found = import_file(tmp_path / "box.stl", tmp_path / "out", ImportOptions(hull=True))
    assert found.mass == pytest.approx(1.2, rel=1e-6)
    assert found.pieces == 1


def test_a_flat_surface_has_no_hull_either(tmp_path: Path) -> None:
    flat = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]])
    flat.export(tmp_path / "flat.stl")
    with pytest.raises(InputError, match="the convex hull has no volume"):
        import_file(tmp_path / "flat.stl", tmp_path / "out", ImportOptions(hull=True))


def test_nothing_is_written_over(tmp_path: Path) -> None:
    trimesh.creation.box([0.1, 0.1, 0.1]).export(tmp_path / "box.stl")
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="is not empty"):
        import_file(tmp_path / "box.stl", out)
    assert [p.name for p in out.iterdir()] == ["mine.txt"]
    import_file(tmp_path / "box.stl", out, ImportOptions(overwrite=True))
    assert sorted(p.name for p in out.iterdir()) == ["box.toml", "meshes", "mine.txt"]


@pytest.mark.parametrize("empty", ["<{0}/>", "<{0}><geometry/></{0}>"])
@pytest.mark.parametrize("part", ["visual", "collision"])
@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_a_part_without_a_shape_is_ignored_with_a_warning(
    kind: str, part: str, empty: str, tmp_path: Path
) -> None:
    size = "0.1 0.1 0.1"
    shape = f'<box size="{size}"/>' if kind == "urdf" else f"<box><size>{size}</size></box>"
    body = f'<link name="l"><visual><geometry>{shape}</geometry></visual>{{}}</link>'
    robot = f'<robot name="a">{body}</robot>'
    model = f'<sdf version="1.9"><model name="a">{body}</model></sdf>'
    sizes: list[object] = []
    for name, more in (("without", ""), ("with", empty.format(part))):
        file = tmp_path / f"{name}.{kind}"
        text = (robot if kind == "urdf" else model).format(more)
        file.write_text(text.replace(f"<{part}", f'<{part} name="{name}"'), encoding="utf-8")
        found = import_file(file, tmp_path / name)
        sizes.append((found.size, found.triangles, found.pieces))
    assert sizes[0] == sizes[1]
    assert any(f"<{part}> without a shape is ignored" in text for text in found.warnings)
