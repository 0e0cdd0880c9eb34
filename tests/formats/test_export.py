"""Exports to a folder: whole or not at all, and never over something of the user's."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.formats.dropped import PLAIN, drop_in
from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError, MissingExtraError, TrocarError, UnknownNameError
from trocar.formats.export import export, find_rig
from trocar.formats.folder import write_meshes
from trocar.formats.links import rig_links
from trocar.formats.meshes import mesh_names, obj
from trocar.robot.dvrk_config.arms import SERIAL


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Drop in a format that writes two small files and a folder."""
    pytest.importorskip("lxml", reason="exports need the extra 'export'")
    drop_in(monkeypatch, tmp_path_factory.mktemp("formats"), "plain", PLAIN)


@pytest.fixture
def rig():
    return lone_arm_rig(load_arm("ecm"))


def everything(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


def test_a_new_folder_and_those_above_it_are_made(tmp_path, rig):
    folder = tmp_path / "a" / "b"
    done = export(rig, "plain", folder)
    assert done.files == ("model.txt", "parts/part.txt")
    assert done.warnings == ("it is only a test",)
    assert everything(tmp_path) == ["a", "a/b", *(f"a/b/{n}" for n in everything(folder))]
    assert done.links == done.joints + 1 == len(rig_links(rig).links)


def test_an_empty_folder_is_filled(tmp_path, rig):
    export(rig, "plain", tmp_path)
    assert everything(tmp_path) == ["model.txt", "parts", "parts/part.txt"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_fails_half_way_leaves_nothing(tmp_path, rig, overwrite):
    with pytest.raises(TrocarError, match="half way"):
        export(rig, "plain", tmp_path / "new" / "folder", {"fail": True}, overwrite=overwrite)
    assert everything(tmp_path) == []


def test_a_folder_with_something_in_it_is_left_alone(tmp_path, rig):
    (tmp_path / "thesis.tex").write_text("years", encoding="utf-8")
    with pytest.raises(InputError, match=r"not empty \(got thesis.tex\); allowed: .*--overwrite"):
        export(rig, "plain", tmp_path)
    assert everything(tmp_path) == ["thesis.tex"]


def test_overwriting_replaces_what_has_the_same_name_and_nothing_else(tmp_path, rig):
    (tmp_path / "thesis.tex").write_text("years", encoding="utf-8")
    (tmp_path / "model.txt").write_text("old", encoding="utf-8")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "stale.txt").write_text("old", encoding="utf-8")
    export(rig, "plain", tmp_path, overwrite=True)
    assert everything(tmp_path) == ["model.txt", "parts", "parts/part.txt", "thesis.tex"]
    assert (tmp_path / "model.txt").read_text(encoding="utf-8") != "old"
    assert (tmp_path / "thesis.tex").read_text(encoding="utf-8") == "years"


def test_an_entry_that_cannot_be_replaced_leaves_all_as_it_was(tmp_path, rig, monkeypatch):
    (tmp_path / "model.txt").write_text("old", encoding="utf-8")
    (tmp_path / "parts").mkdir()
    rename = Path.rename

    def refuse(self: Path, target: Path) -> Path:
        if self.name == "parts" and self.parent.name == "new":
            raise PermissionError(13, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(InputError, match="cannot be written: Permission denied"):
        export(rig, "plain", tmp_path, overwrite=True)
    assert everything(tmp_path) == ["model.txt", "parts"]
    assert (tmp_path / "model.txt").read_text(encoding="utf-8") == "old"


def test_a_file_is_no_folder(tmp_path, rig):
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="is not a folder; allowed"):
        export(rig, "plain", tmp_path / "file", overwrite=True)
    with pytest.raises(InputError, match="cannot be written: Not a directory"):
        export(rig, "plain", tmp_path / "file" / "below")


def test_a_folder_that_cannot_be_written_is_an_error_of_one_line(rig):
    with pytest.raises(InputError, match="/proc/trocar: cannot be written"):
        export(rig, "plain", "/proc/trocar")


def test_an_unknown_format_lists_the_known_ones(tmp_path, rig):
    with pytest.raises(
        UnknownNameError, match=r"unknown format 'plane' \(did you mean 'plain'\?\)"
    ):
        export(rig, "plane", tmp_path)


def test_an_arm_without_masses_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="has no mass for yaw"):
        export(lone_arm_rig(load_arm(SERIAL["PSM"])), "plain", tmp_path / "new")
    assert everything(tmp_path) == []


def test_without_lxml_the_extra_is_named(tmp_path, rig, monkeypatch):
    monkeypatch.setitem(sys.modules, "lxml", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trocar\[export\]'"):
        export(rig, "plain", tmp_path / "new")
    assert everything(tmp_path) == []


def test_a_name_of_both_is_the_arm_alone_and_a_path_the_rig():
    alone = find_rig("psm")
    assert (alone.name, [a.name for a in alone.arms], alone.props) == ("psm", ["PSM1"], ())
    rig = find_rig(load_rig("psm").file)
    assert [a.name for a in rig.arms] == ["PSM1"] and rig.props
    assert len(find_rig("two_psm_ecm").arms) == 3


def test_tools_are_mounted_on_a_lone_arm_or_on_a_named_one():
    tool = "MARYLAND_BIPOLAR_FORCEPS:400172"
    assert find_rig("psm", [tool]).arms[0].arm.tool == tool
    pair = find_rig("two_psm_ecm", [f"PSM2={tool}"])
    assert [a.arm.tool == tool for a in pair.arms] == [False, True, False]
    with pytest.raises(InputError, match=r"--tool: got '.*'; allowed: ARM=TOOL, .*PSM1, PSM2, ECM"):
        find_rig("two_psm_ecm", [tool])


def test_calibrations_go_onto_the_arms_of_their_kind(parallel_overlay, rng, tmp_path):
    from trocar.descriptions.overlay import write_overlay

    file = tmp_path / "mine.toml"
    write_overlay(file, parallel_overlay("psm", rng))
    assert find_rig("psm", (), [str(file)]).arms[0].arm.overlay is not None
    pair = find_rig("two_psm_ecm", (), [f"PSM2={file}"])
    assert [a.arm.overlay is not None for a in pair.arms] == [False, True, False]


def test_an_unknown_subject_lists_arms_and_rigs():
    with pytest.raises(UnknownNameError, match=r"unknown arm or rig 'psn' .*full_cart.*suj_psm1"):
        find_rig("psn")


def triangle(x: float) -> Mesh:
    return Mesh(np.array([[0.0, 0.0, 0.0], [x, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]]))


def test_a_mesh_is_written_in_metres_with_indices_from_one(tmp_path):
    assert obj(triangle(0.125)) == b"v 0 0 0\nv 0.125 0 0\nv 0 1 0\nf 1 2 3\n"
    shaded = replace(triangle(1.0), normals=np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert obj(shaded).endswith(b"vn 0 0 1\n" * 3 + b"f 1//1 2//2 3//3\n")
    coloured = obj(triangle(1.0), "steel").decode()
    assert coloured.startswith("mtllib materials.mtl\nv ") and "usemtl steel\nf 1 2 3" in coloured
    write_meshes({triangle(0.1): "a", triangle(0.2): "b"}, tmp_path / "meshes")
    assert everything(tmp_path) == ["meshes", "meshes/a.obj", "meshes/b.obj"]


def test_colours_lie_beside_the_meshes_that_name_them(tmp_path):
    one, two = triangle(0.1), triangle(0.2)
    write_meshes({one: "seen", two: "touched"}, tmp_path, {one: "drape"})
    assert everything(tmp_path) == ["materials.mtl", "seen.obj", "touched.obj"]
    colours = (tmp_path / "materials.mtl").read_text(encoding="utf-8")
    assert colours.startswith("newmtl drape\nKa 0.175 0.29 0.31\nKd 0.35 0.58 0.62\nKs 0.05")
    assert "mtllib" in (tmp_path / "seen.obj").read_text(encoding="utf-8")
    assert "mtllib" not in (tmp_path / "touched.obj").read_text(encoding="utf-8")


def test_meshes_that_are_alike_are_one_file_and_others_of_the_same_name_another(rig):
    def model(*meshes: Mesh):
        shapes = [Shape("mesh", np.eye(4), np.ones(3), "steel", mesh=mesh) for mesh in meshes]
        found = rig_links(rig)
        links = tuple(replace(link, shapes=()) for link in found.links)
        return replace(found, links=(replace(links[0], shapes=tuple(shapes)), *links[1:]))

    one, same, other = (replace(triangle(x), name="part") for x in (0.1, 0.1, 0.2))
    assert list(mesh_names(model(one, same, other)).values()) == ["part", "part", "part_2"]
    assert list(mesh_names(model(triangle(0.3))).values()) == ["world"]


def test_meshes_that_nobody_sees_or_touches_are_no_files(rig):
    found = rig_links(rig)
    meshes = {s.mesh for link in found.links for s in link.shapes if s.visible or s.collide}
    assert set(mesh_names(found)) == meshes - {None}
    assert any(s.mesh and s.mesh not in meshes for link in found.links for s in link.shapes)


def test_no_meshes_make_no_folder(tmp_path, rig):
    bare = tuple(replace(b, shapes=()) for b in rig.arms[0].arm.bodies)
    arm = replace(rig.arms[0], arm=replace(rig.arms[0].arm, bodies=bare))
    assert mesh_names(rig_links(replace(rig, arms=(arm,), props=()))) == {}
    write_meshes({}, tmp_path / "meshes")
    assert everything(tmp_path) == []


def test_an_option_for_another_format_is_refused(tmp_path, rig):
    with pytest.raises(InputError, match=r"--package: got 'p' with --format sdf; allowed: .*urdf"):
        export(rig, "sdf", tmp_path / "new", {"package": "p"})
    with pytest.raises(InputError, match=r"--sdf-version: got '1.7' .*allowed: with --format sdf"):
        export(rig, "plain", tmp_path / "new", {"sdf_version": "1.7"})
    assert everything(tmp_path) == []


def test_an_option_that_no_format_has_lists_those_of_all(tmp_path, rig):
    with pytest.raises(
        UnknownNameError, match=r"unknown option 'packages' \(did you mean 'package'"
    ):
        export(rig, "urdf", tmp_path / "new", {"packages": "p"})
    assert everything(tmp_path) == []
