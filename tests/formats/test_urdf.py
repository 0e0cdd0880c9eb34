"""The URDF of a rig, as text."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.descriptions.rigs import lone_arm_rig
from trocar.formats.links import LinkModel, rig_links
from trocar.formats.urdf import UNLIMITED, urdf

etree = pytest.importorskip("lxml.etree", reason="exports need the extra 'export'")


@pytest.fixture(scope="module")
def psm() -> LinkModel:
    return rig_links(lone_arm_rig(load_arm("psm")))


def places(model: LinkModel) -> dict[Mesh, str]:
    meshes = {s.mesh for link in model.links for s in link.shapes if s.mesh is not None}
    return {mesh: f"meshes/{mesh.name}.obj" for mesh in meshes}


def with_shapes(model: LinkModel, *shapes: Shape) -> LinkModel:
    """The first links alone, the second with these shapes."""
    links = tuple(
        replace(link, shapes=shapes if k == 1 else ()) for k, link in enumerate(model.links)
    )
    return replace(model, links=links)


def test_the_same_rig_gives_the_same_bytes_indented_by_two(psm) -> None:
    text = urdf(psm, places(psm))
    assert text == urdf(psm, places(psm))
    assert b"\n  <link name=" in text and b"\n    <inertial>" in text and b"\t" not in text


def test_joints_have_what_their_hinges_feel(psm) -> None:
    root = etree.fromstring(urdf(psm, places(psm)))
    for joint in psm.joints:
        if joint.hinge is not None and not joint.follows:
            found = root.find(f"joint[@name='{joint.name}']")
            felt = found.find("dynamics").attrib
            assert float(felt["damping"]) == pytest.approx(joint.hinge.damping)
            assert float(felt["friction"]) == pytest.approx(joint.hinge.frictionloss)
            limit = found.find("limit").attrib
            assert float(limit["effort"]) == pytest.approx(joint.effort)
            assert float(limit["velocity"]) == pytest.approx(joint.velocity)
            assert float(limit["upper"]) == pytest.approx(joint.upper)


def test_fingers_stop_where_they_meet(psm) -> None:
    limit = (
        etree.fromstring(urdf(psm, places(psm)))
        .find("joint[@name='PSM1_finger_left']/limit")
        .attrib
    )
    assert psm.joint("PSM1_finger_left").lower < 0.0 == float(limit["lower"])


def test_what_has_no_limit_gets_a_large_number() -> None:
    model = rig_links(lone_arm_rig(load_arm("mtml")))
    assert not np.isfinite(model.joint("MTML_gripper_left").velocity)
    text = urdf(model, places(model))
    assert b"inf" not in text and b"nan" not in text
    limit = etree.fromstring(text).find("joint[@name='MTML_gripper_left']/limit").attrib
    assert float(limit["velocity"]) == UNLIMITED


def test_a_capsule_is_a_cylinder_and_two_spheres(psm) -> None:
    shape = Shape("capsule", np.eye(4), np.array([0.02, 0.1, 0.0]), "steel")
    root = etree.fromstring(urdf(with_shapes(psm, shape)))
    parts = root.findall("link/collision/geometry/*")
    assert [part.tag for part in parts] == ["cylinder", "sphere", "sphere"]
    assert parts[0].attrib == {"radius": "0.02", "length": "0.2"}
    ends = [origin.get("xyz") for origin in root.findall("link/collision/origin")]
    assert ends == ["0 0 0", "0 0 -0.1", "0 0 0.1"]


def test_a_mesh_is_looked_up_where_its_file_is(psm) -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    shape = Shape("mesh", np.eye(4), np.ones(3), "cover", collide=False, weigh=False, mesh=mesh)
    model = with_shapes(psm, shape)
    for place, compiler in (
        ("meshes/a.obj", {"strippath": "false"}),
        ("package://p/meshes/a.obj", {"strippath": "true", "meshdir": "meshes"}),
    ):
        root = etree.fromstring(urdf(model, {mesh: place}))
        assert [m.get("filename") for m in root.findall("link/visual/geometry/mesh")] == [place]
        assert not root.findall("link/collision")
        assert compiler.items() <= dict(root.find("mujoco/compiler").attrib).items()


def test_each_material_is_defined_once_and_named_by_what_is_seen(psm) -> None:
    root = etree.fromstring(urdf(psm, places(psm)))
    defined = [material.get("name") for material in root.findall("material")]
    assert len(defined) == len(set(defined))
    assert {m.get("name") for m in root.findall("link/visual/material")} == set(defined)
