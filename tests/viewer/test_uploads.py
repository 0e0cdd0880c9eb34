"""Uploaded files: what is understood, where they are placed, and what is refused."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from tests.viewer.visitor import visiting
from trocar.descriptions import load_rig
from trocar.descriptions.catalogue import load_scene
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform
from trocar.simulation import World
from trocar.viewer import Gallery, uploads
from trocar.viewer.own_things import LOAD, OwnThings
from trocar.viewer.server import LocalServer, serving
from trocar.viewer.uploads import MOST_BYTES, archive, check_size, placed_rig, understand

BLOCK = b"v 0 0 0\nv 50 0 0\nv 0 50 0\nv 0 0 50\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
ARM = b"""<robot name="pointer">
  <link name="base"/>
  <link name="stick">
    <inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>
    </inertial>
    <visual><geometry><box size="0.02 0.02 0.2"/></geometry></visual>
  </link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="stick"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""
POSE = transform(matrix_from_rpy(0.3, -0.2, 0.5), np.array([0.05, 0.1, 0.4]))


@pytest.fixture(scope="module")
def block() -> Any:
    return understand("my block.obj", BLOCK, unit="mm", taken=("my_block",))


def test_a_mesh_is_an_object_whose_size_mass_and_name_are_those_of_the_file(block: Any) -> None:
    assert (block.kind, block.name) == ("prop", "my_block_2")
    assert "50 x 50 x 50 mm, 0.025 kg, 4 triangles" in block.lines[1]
    ((pose, shapes),) = block.bodies
    assert pose == pytest.approx(np.eye(4), abs=1e-12)
    triangles = shapes[0].triangles
    assert triangles is not None
    corners = triangles[0] @ shapes[0].pose[:3, :3].T + shapes[0].pose[:3, 3]
    assert corners.max(axis=0) == pytest.approx([0.05, 0.05, 0.05])
    assert corners.min(axis=0) == pytest.approx([0.0, 0.0, 0.0])


@pytest.mark.parametrize("movable", [True, False])
def test_the_saved_rig_has_the_thing_where_its_handle_stood(
    block: Any, movable: bool, tmp_path: Path
) -> None:
    file = placed_rig(load_rig("two_psm_ecm").file, block, POSE, movable=movable)
    with zipfile.ZipFile(io.BytesIO(archive(file))) as packed:
        packed.extractall(tmp_path)
    world = World(tmp_path / "rig.toml")
    assert {*load_rig("two_psm_ecm").poses} == {*world.rig.poses}
    if movable:
        assert world.object("my_block_2").measured_cp().matrix == pytest.approx(POSE, abs=1e-9)
    else:
        assert "my_block_2" in {prop.name for prop in world.rig.props} - {*world.objects}


def test_a_scene_with_files_beside_it_takes_an_object(block: Any) -> None:
    world = World(placed_rig(load_scene("peg-board").rig.file, block, POSE, movable=True))
    assert {"ring1", "my_block_2"} <= {*world.objects}


def test_a_robot_is_an_arm_that_stands_beside_the_others() -> None:
    arm = understand("pointer.urdf", ARM)
    assert (arm.kind, arm.name) == ("arm", "pointer")
    assert "joints turn" in arm.lines[0]
    world = World(placed_rig(load_rig("psm").file, arm, POSE, movable=False))
    assert {*world.arms} == {"PSM1", "pointer"}
    with pytest.raises(InputError, match="is a scene, which takes objects"):
        placed_rig(load_scene("peg-board").rig.file, arm, POSE, movable=False)


def test_a_configuration_of_a_dvrk_that_lacks_a_file_names_it() -> None:
    system = json.dumps({"arms": [{"name": "PSM1", "type": "PSM", "arm-file": "missing.json"}]})
    with pytest.raises(InputError, match=r"system\.json"):
        understand("system.json", system.encode())


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", b"x", r"a\.txt: unknown ending '\.txt'; allowed: \.stl, \.obj"),
        ("a.stl", b"", "a.stl: is empty"),
        ("a.stl", b"nothing of the kind", r"a\.stl"),
        ("../../a.urdf", b"<robot", r"a\.urdf"),
        ("a.json", b"[]", r"a\.json"),
        ("a.obj", b"v 0 0 0\nv 5000 0 0\nv 0 5000 0\nf 1 2 3\n", "--unit mm"),
    ],
)
def test_a_file_that_is_nothing_is_one_clear_error(name: str, content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        understand(name, content)
    assert str(uploads.folder()) not in str(caught.value)


def test_a_file_that_is_too_large_is_refused_with_the_bound() -> None:
    check_size("a.stl", MOST_BYTES)
    with pytest.raises(InputError, match=r"a\.stl: got 50\.1 MB; allowed: up to 50 MB"):
        check_size("a.stl", 50_100_000)


def test_an_import_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "PATIENCE_S", 0.01)
    with pytest.raises(InputError, match=r"a\.obj: not imported within 0\.01 s"):
        understand("a.obj", BLOCK)


def test_a_rig_built_in_python_has_no_file_to_place_it_in(block: Any) -> None:
    with pytest.raises(InputError, match="built in Python"):
        placed_rig("", block, POSE, movable=True)


class Seated:
    """A desk whose person drives."""

    seat = ""

    def __init__(self, browser: Any) -> None:
        self.browser = browser


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    with serving("127.0.0.1", 0, "test") as found:
        yield found


def folder_of(server: LocalServer) -> tuple[Any, Any, Gallery]:
    gallery, desk = Gallery(tuple, "psm"), Seated(server)
    rig = load_rig("psm").file
    return OwnThings(cast(Any, desk), gallery, rig, ("PSM1",), np.zeros(3)), desk, gallery


def test_a_thing_is_shown_where_its_handle_stands_and_loaded_there(server: LocalServer) -> None:
    folder, _, gallery = folder_of(server)
    with visiting(server) as visitor:
        visitor.use("Unit", "mm")
        visitor.upload("Upload a file", "my block.obj", BLOCK)
        visitor.wait(lambda: "an object" in visitor.text("own"))
        visitor.wait(lambda: visitor.node("/own/handle/body_0"))
        visitor.drag("/own/handle", (0.0, 0.1, 0.4))
        visitor.use("Thing", LOAD)
        visitor.wait(lambda: gallery.chosen)
        assert gallery.chosen is not None and gallery.chosen.kind == "rig"
        placed = World(gallery.chosen.name).object("my_block").measured_cp().matrix
        assert placed[:3, 3] == pytest.approx([0.0, 0.1, 0.4])
        folder.close()
        assert not [name for name in visitor.read().nodes if name.startswith("/own/")]


def test_a_file_that_is_nothing_leaves_its_error_and_who_watches_uploads_nothing(
    server: LocalServer,
) -> None:
    folder, desk, gallery = folder_of(server)
    with visiting(server) as visitor:
        visitor.upload("Upload a file", "a.stl", b"")
        visitor.wait(lambda: "a.stl: is empty" in visitor.text("own"))
        desk.seat = "another browser drives"
        visitor.upload("Upload a file", "my block.obj", BLOCK)
        assert "a.stl: is empty" in visitor.text("own")  # not "importing my block.obj ..."
        desk.seat = ""
        visitor.use("Thing", LOAD)
        assert gallery.chosen is None and "a.stl: is empty" in visitor.text("own")
        folder.close()


def test_a_file_that_is_announced_too_large_is_never_taken(server: LocalServer) -> None:
    folder_of(server)
    with visiting(server) as visitor:
        sizes = (MOST_BYTES, MOST_BYTES + 1)
        sent = [visitor.upload("Upload a file", "a.stl", b"first part", size) for size in sizes]
        assert "allowed: up to 50 MB" in visitor.text("own")
        assert visitor.acknowledged & {*sent} == {sent[0]}
