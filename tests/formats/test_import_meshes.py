"""Meshes that robots' files name: found, told from pointers to them, and read once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

import trimesh

from tests.formats.texts import SDF, URDF
from trocar.descriptions import load_arm, meshes
from trocar.errors import DescriptionError, InputError
from trocar.formats.importing import ImportOptions, import_file
from trocar.formats.surfaces import read_surface

BOX = '<box size="0.2 0.2 0.1"/>'
#: As git stores a large file. Source: git-lfs docs/spec.md.
POINTER = (
    "version https://git-lfs.github.com/spec/v1\n"
    "oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\n"
    "size 247284\n"
)


def cube(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((0.1, 0.1, 0.1)).export(path)
    return path


@pytest.mark.parametrize("uri", ["model://bars//meshes/a.STL", "package://bars///meshes/a.STL"])
def test_slashes_too_many_in_a_uri_are_one(uri: str, tmp_path: Path) -> None:
    """As dvrk_env's own ecm.sdf has them."""
    cube(tmp_path / "bars" / "meshes" / "a.STL")
    visual = f'<visual name="v"><geometry><mesh><uri>{uri}</uri></mesh></geometry></visual>'
    text = SDF.format(block=0.0, rest=0.1).replace(
        '<link name="base"/>', f'<link name="base">{visual}</link>'
    )
    file = tmp_path / "bars" / "robot.sdf"
    file.write_text(text, encoding="utf-8")
    assert import_file(file, tmp_path / "out").triangles == 12


@pytest.mark.parametrize("name", ["a.stl", "a.dae", "a.obj"])
def test_a_git_lfs_pointer_is_called_so(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(POINTER, encoding="utf-8")
    file = tmp_path / "robot.urdf"
    file.write_text(URDF.replace(BOX, f'<mesh filename="{name}"/>'), encoding="utf-8")
    said = rf"{name}: is a Git LFS pointer to a file of 247284 bytes; .*`git lfs pull`"
    with pytest.raises(InputError, match=said):
        import_file(file, tmp_path / "out")
    with pytest.raises(InputError, match=said):
        import_file(tmp_path / name, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_robot_s_file_can_be_a_git_lfs_pointer_too(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(POINTER, encoding="utf-8")
    with pytest.raises(InputError, match=r"robot.urdf: is a Git LFS pointer"):
        import_file(tmp_path / "robot.urdf", tmp_path / "out")


def test_so_can_a_mesh_of_one_s_own(tmp_path: Path) -> None:
    file = tmp_path / "robot.urdf"
    cube(tmp_path / "a.stl")
    file.write_text(URDF.replace(BOX, '<mesh filename="a.stl"/>'), encoding="utf-8")
    arm = Path(import_file(file, tmp_path / "out").file)
    (mesh,) = (tmp_path / "out" / "meshes").iterdir()
    mesh.write_text(POINTER, encoding="utf-8")
    with pytest.raises(DescriptionError, match="is a Git LFS pointer"):
        load_arm(arm)


def test_each_mesh_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A UR5 names each of seven meshes of 14,000 triangles once or twice."""
    cube(tmp_path / "a.stl")
    mesh = '<geometry><mesh filename="a.stl"/></geometry>'
    links = f'<link name="base"><visual>{mesh}</visual><collision>{mesh}</collision>'
    file = tmp_path / "robot.urdf"
    file.write_text(URDF.replace('<link name="base">', links), encoding="utf-8")
    read: Counter[str] = Counter()
    load, read_input = trimesh.load, meshes.read_input

    def loaded(path, **options):
        read[path.name] += 1
        return load(path, **options)

    def bytes_of(path, most):
        read[path.name] += 1
        return read_input(path, most)

    monkeypatch.setattr(trimesh, "load", loaded)
    monkeypatch.setattr(meshes, "read_input", bytes_of)
    found = import_file(file, tmp_path / "out")
    monkeypatch.undo()
    written = {p.name for p in (Path(found.file).parent / "meshes").iterdir()}
    assert len(written) == 2  # what is seen, and the hull that is touched
    assert +read == dict.fromkeys({"a.stl", *written}, 1)


def test_corners_that_an_stl_repeats_are_written_once(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)  # 642 corners, 1280 triangles
    ball.export(tmp_path / "ball.stl")
    mesh = '<visual><geometry><mesh filename="ball.stl" scale="0.1 0.1 0.1"/></geometry></visual>'
    file = tmp_path / "robot.urdf"
    file.write_text(URDF.replace('<link name="base">', f'<link name="base">{mesh}'), "utf-8")
    found = import_file(file, tmp_path / "out")
    (written,) = (Path(found.file).parent / "meshes").iterdir()
    lines = written.read_text().splitlines()
    assert [sum(line.startswith(key) for line in lines) for key in "vf"] == [642, 1280]


def test_a_normal_that_is_no_number_is_not_logged(tmp_path: Path, caplog) -> None:
    corners = ("0 0 0", "1 0 0", "0 1 0")
    rows = ["facet normal x 0 1", "outer loop", *(f"vertex {c}" for c in corners)]
    file = tmp_path / "flat.stl"
    file.write_text("\n".join(["solid s", *rows, "endloop", "endfacet", "endsolid s", ""]))
    assert len(read_surface(file).whole.faces) == 1
    assert not caplog.records


def test_a_name_without_a_folder_is_looked_for_in_package_folders(tmp_path: Path) -> None:
    cube(tmp_path / "meshes" / "a.stl")
    file = tmp_path / "robot.urdf"
    file.write_text(URDF.replace(BOX, '<mesh filename="a.stl"/>'), encoding="utf-8")
    with pytest.raises(InputError, match=r"'a.stl' not found .* --package-path DIR"):
        import_file(file, tmp_path / "out")
    options = ImportOptions(packages=(tmp_path / "meshes",))
    assert import_file(file, tmp_path / "out", options).triangles >= 12


def test_a_scan_of_points_alone_is_told_of_surfaces(tmp_path: Path) -> None:
    rows = "0 0 0\n1 0 0\n0 1 0\n"
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    text = f"{head}property float z\nend_header\n{rows}"
    (tmp_path / "scan.ply").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="has 3 points or lines and no triangles; allowed: a surf"):
        import_file(tmp_path / "scan.ply", tmp_path / "out")


def test_a_triangle_without_its_corner_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "a.glb"
    scene = trimesh.Scene(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    data = scene.export(file_type="glb")
    assert isinstance(data, bytes)
    index = data.index(
        (0).to_bytes(4, "little") + (1).to_bytes(4, "little") + (2).to_bytes(4, "little")
    )
    file.write_bytes(data[:index] + (9).to_bytes(4, "little") + data[index + 4 :])
    with pytest.raises(InputError, match="has a triangle at corner 9; allowed: 0 to 2"):
        import_file(file, tmp_path / "out")


def test_a_surface_that_is_flat_but_for_rounding_has_no_hull(tmp_path: Path) -> None:
    flat = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 1e-16], [1, 1, 0], [0, 1, 1e-16]], [[0, 1, 2], [0, 2, 3]]
    )
    flat.export(tmp_path / "flat.obj")
    with pytest.raises(InputError, match="planar or linear"):
        import_file(tmp_path / "flat.obj", tmp_path / "out", ImportOptions(hull=True))
