"""SDF files: libsdformat finds them valid, nothing is lost, and loops and couplings are said."""

from __future__ import annotations

import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig, names
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import UnknownNameError
from trocar.formats.links import LinkModel, rig_links
from trocar.formats.sdf import VERSIONS, add_shape, card, exact, model_name, sdf, world
from trocar.formats.xml_tree import element
from trocar.geometry.rotations import rpy_from_matrix

etree = pytest.importorskip("lxml.etree", reason="lxml is not installed (extra: export)")

ARMS = names("arms")
#: A line that Debian's `ign` writes whatever it is asked.
ALWAYS = "libignition-tools-backward.so"
needs_ign = pytest.mark.skipif(
    shutil.which("ign") is None, reason="ign (sdformat) is not installed"
)


def lone(name: str, overlay: object = None) -> LinkModel:
    return rig_links(lone_arm_rig(load_arm(name, calibration=overlay)))  # type: ignore[arg-type]


def parsed(model: LinkModel, version: str = "1.9") -> Any:
    return etree.fromstring(sdf(model, version))


def named(root: Any, tag: str, name: str) -> Any:
    (found,) = root.xpath(f"//{tag}[@name='{name}']")
    return found


def numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def judged(path: Path) -> list[str]:
    """Return every line that libsdformat has to say of a file."""
    done = subprocess.run(
        ["ign", "sdf", "-k", str(path)], capture_output=True, text=True, timeout=60, check=False
    )
    lines = (done.stdout + done.stderr).splitlines()
    return [line for line in lines if line.strip() and ALWAYS not in line]


@pytest.mark.slow
@needs_ign
def test_libsdformat_finds_worlds_and_the_older_version_valid_and_warns_of_nothing(
    tmp_path, rng, skew_overlay
) -> None:
    everything = rig_links(load_rig("full_cart_mtm"))
    skew = lone("psm", skew_overlay("psm", rng))
    files = {
        "model.sdf": sdf(everything, "1.7"),
        "skew.sdf": sdf(skew, "1.7"),
        "world.sdf": world(everything, "1.9"),
        "older_world.sdf": world(everything, "1.7"),
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        assert judged(tmp_path / name) == ["Valid."], name


@needs_ign
@pytest.mark.slow
def test_libsdformat_finds_every_arm_and_rig_valid_and_warns_of_nothing(
    tmp_path, rng, skew_overlay
) -> None:
    models = [lone(name) for name in ARMS] + [rig_links(load_rig(name)) for name in names("rigs")]
    models += [lone(name, skew_overlay(name, rng)) for name in ("psm", "ecm")]
    paths = [tmp_path / f"{k}.sdf" for k in range(len(models))]
    for path, model in zip(paths, models, strict=True):
        path.write_bytes(sdf(model, "1.9"))
    with ThreadPoolExecutor(2) as pool:
        for model, lines in zip(models, pool.map(judged, paths), strict=True):
            assert lines == ["Valid."], model.name


@needs_ign
def test_libsdformat_would_complain_of_a_name_that_is_there_twice(tmp_path) -> None:
    path = tmp_path / "model.sdf"
    path.write_bytes(sdf(lone("ecm")).replace(b"ECM_yaw_joint", b"ECM_yaw"))
    assert judged(path) != ["Valid."]


@pytest.mark.parametrize("version", VERSIONS)
def test_every_massive_link_is_a_link_and_every_other_a_frame(version) -> None:
    model = rig_links(load_rig("full_cart_mtm"))
    root = parsed(model, version)
    massive = {link.name for link in model.links if link.mass}
    frames = {link.name for link in model.links[1:]} - massive
    assert {link.get("name") for link in root.iter("link")} == massive | {"ground"}
    assert {frame.get("name") for frame in root.iter("frame")} == frames


def test_every_number_reads_back_as_the_float_that_it_is() -> None:
    model = lone("psm")
    root = parsed(model)
    joints = {joint.child: joint for joint in model.joints}
    for link in model.links[1:]:
        if not link.mass:
            continue
        made = named(root, "link", link.name)
        pose = joints[link.name].pose
        expected = [*pose[:3, 3], *rpy_from_matrix(pose[:3, :3])]
        assert numbers(made.findtext("pose")) == expected
        inertial = made.find("inertial")
        assert float(inertial.findtext("mass")) == link.mass
        assert numbers(inertial.findtext("pose", "0 0 0 0 0 0")) == [*link.com, 0.0, 0.0, 0.0]
        for tag, at in (("ixx", (0, 0)), ("ixy", (0, 1)), ("iyz", (1, 2)), ("izz", (2, 2))):
            assert float(inertial.findtext(f"inertia/{tag}")) == link.inertia[at]
    assert exact([0.1, -0.0, 1e-300]) == "0.1 0.0 1e-300"


@pytest.mark.parametrize("name", names("rigs"))
def test_every_inertia_in_the_file_is_a_possible_bodys(name) -> None:
    for inertial in parsed(rig_links(load_rig(name))).iter("inertial"):
        values = {e.tag: float(e.text) for e in inertial.find("inertia")}
        x, y, z = values["ixy"], values["ixz"], values["iyz"]
        matrix = [[values["ixx"], x, y], [x, values["iyy"], z], [y, z, values["izz"]]]
        least, middle, most = np.linalg.eigvalsh(matrix)
        assert float(inertial.findtext("mass")) > 0.0
        assert least > 0.0
        assert least + middle >= most * (1.0 - 1e-9)


def test_the_same_rig_gives_the_same_bytes() -> None:
    assert sdf(rig_links(load_rig("psm"))) == sdf(rig_links(load_rig("psm")))


def test_a_loop_is_a_hinge_between_its_links_and_a_ball_where_hinges_are_skew(
    rng, skew_overlay, parallel_overlay
) -> None:
    cases = {"drawn": None, "parallel": parallel_overlay("psm", rng)}
    for overlay in cases.values():
        made = named(parsed(lone("psm", overlay)), "joint", "PSM1_c1_joint")
        assert made.get("type") == "revolute"
        assert (made.findtext("parent"), made.findtext("child")) == (
            "PSM1_pitch_front",
            "PSM1_pitch_bottom",
        )
    skew = named(parsed(lone("psm", skew_overlay("psm", rng))), "joint", "PSM1_c1_joint")
    assert (skew.get("type"), skew.findtext("child")) == ("ball", "PSM1_c1_pin")


def test_what_a_loop_determines_has_no_limit_and_no_motor() -> None:
    limit = named(parsed(lone("psm")), "joint", "PSM1_pitch_end_joint").find("axis/limit")
    assert [(e.tag, e.text) for e in limit] == [("effort", "0.0")]


def test_stops_and_springs_are_those_of_the_description() -> None:
    finger = named(parsed(lone("psm")), "joint", "PSM1_finger_left_joint")
    assert float(finger.findtext("axis/limit/lower")) == 0.0  # where the other finger is
    gripper = named(parsed(lone("mtml")), "joint", "MTML_gripper_left_joint").find("axis")
    spring = lone("mtml").joint("MTML_gripper_left").hinge
    assert spring is not None
    assert float(gripper.findtext("dynamics/spring_stiffness")) == spring.stiffness
    assert float(gripper.findtext("dynamics/spring_reference")) == spring.rest
    assert gripper.find("limit/velocity") is None  # it has no motor that would have one


def test_couplings_are_gears_in_1_7_drakes_in_1_9_and_mimics_in_1_11() -> None:
    drake = "{http://drake.mit.edu}mimic"
    finger, weight = "PSM1_finger_right_joint", "PSM1_counterweight_joint"
    root = parsed(lone("psm"), "1.9")
    said = dict(named(root, "joint", weight).find(drake).attrib)
    assert said == {"joint": "PSM1_insertion_joint", "multiplier": "0.6025", "offset": "0.0"}
    assert b"drake:mimic" in sdf(lone("psm"), "1.9")
    root = parsed(lone("psm"), "1.11")
    said = named(root, "joint", finger).find("axis/mimic")
    assert said.get("joint") == "PSM1_finger_left_joint"
    assert [float(e.text) for e in said] == [-1.0, 0.0, 0.0]
    (gear,) = parsed(lone("psm"), "1.7").xpath("//joint[@type='gearbox']")
    assert gear.findtext("parent") == "PSM1_finger_left"
    assert gear.findtext("child") == "PSM1_finger_right"
    assert gear.findtext("gearbox_reference_body") == "PSM1_wrist_yaw"
    assert float(gear.findtext("gearbox_ratio")) == 1.0  # theta_2 = -gearbox_ratio * theta_1


def test_a_calibrated_arm_differs_from_the_drawn_one_in_what_the_overlay_moved(
    rng, skew_overlay
) -> None:
    overlay = skew_overlay("psm", rng)
    drawn, real = parsed(lone("psm")), parsed(lone("psm", overlay))

    def texts(root: Any, tag: str) -> dict[str, str | None]:
        return {e.get("name"): e.findtext("pose") for e in root.iter(tag)}

    before, after = texts(drawn, "link"), texts(real, "link")
    moved = {name for name in before if before[name] != after[name]}
    # The passive hinges are among them: they would stand differently as the loops close elsewhere.
    assert moved == {f"PSM1_{name}" for name in overlay.frames}
    assert set(after) - set(before) == {"PSM1_c1_pin", "PSM1_c2_pin"}
    assert texts(drawn, "frame") == texts(real, "frame")
    unmoved = set(before) - moved - {"ground"}
    for name in unmoved:
        links = [named(root, "link", name) for root in (drawn, real)]
        if name == "PSM1_base":  # it carries the yaw axis, which its shape follows
            for shape in [e for k in links for e in k if e.tag in ("visual", "collision")]:
                shape.getparent().remove(shape)
        same = [etree.tostring(link) for link in links]
        assert same[0] == same[1], name
    for name in texts(drawn, "joint"):
        if "_c1_" not in name and "_c2_" not in name:
            same = [etree.tostring(named(root, "joint", name)) for root in (drawn, real)]
            assert same[0] == same[1], name


def shape_of(kind: str, version: str = "1.9", **more: Any) -> Any:
    link = element("link", {"name": "a"})
    mesh = more.get("mesh")
    shape = Shape(kind, np.eye(4), np.array([0.1, 0.2, 0.3]), "cover", **more)  # type: ignore[arg-type]
    add_shape(link, "a_0", shape, "", version, {mesh: "part"} if mesh else {})
    return link


def test_shapes_keep_their_sizes() -> None:
    assert numbers(shape_of("box").findtext("visual/geometry/box/size")) == [0.2, 0.4, 0.6]
    assert float(shape_of("sphere").findtext("collision/geometry/sphere/radius")) == 0.1
    for kind in ("cylinder", "capsule"):
        found = shape_of(kind).find(f"visual/geometry/{kind}")
        assert (float(found.findtext("radius")), float(found.findtext("length"))) == (0.1, 0.4)


def test_before_1_8_a_capsule_is_a_cylinder_between_two_balls() -> None:
    made = shape_of("capsule", "1.7")
    kinds = [geometry[0].tag for geometry in made.xpath("visual/geometry")]
    assert kinds == ["cylinder", "sphere", "sphere"]
    heights = [numbers(pose.text)[2] for pose in made.xpath("visual/pose")]
    assert heights == [-0.2, 0.2]


def test_what_is_not_seen_has_no_visual_and_what_touches_nothing_no_collision() -> None:
    mesh = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    hidden = shape_of("mesh", mesh=mesh, visible=False)
    assert [e.tag for e in hidden] == ["collision"]
    assert hidden.findtext("collision/geometry/mesh/uri") == "meshes/part.obj"
    assert [e.tag for e in shape_of("mesh", mesh=mesh, collide=False)] == ["visual"]


def test_things_that_stand_in_the_world_are_shapes_of_the_ground() -> None:
    model = rig_links(load_rig("psm"))
    ground = named(parsed(model), "link", "ground")
    table = next(link for link in model.links if link.name == "table")
    poses = ground.xpath("visual/pose[@relative_to='table']")
    assert len(poses) == len(table.shapes) > 0
    assert ground.find("inertial") is None


def test_a_world_has_ground_where_the_floor_is_and_the_model_as_it_is() -> None:
    model = rig_links(load_rig("full_cart"))
    root = etree.fromstring(world(model, "1.9"))
    ground = named(root, "model", "ground_plane")
    assert numbers(ground.findtext("pose") or "0 0 0")[2] == 0.0
    inside = etree.tostring(named(root, "model", "full_cart"), method="c14n")
    assert inside.count(b"<joint") == sdf(model).count(b"<joint")
    alone = etree.fromstring(world(lone("psm"), "1.9"))
    assert numbers(named(alone, "model", "ground_plane").findtext("pose"))[2] == -0.75


def test_the_card_names_file_and_version() -> None:
    made = etree.fromstring(card(lone("psm"), "1.7", "model.sdf"))
    assert made.findtext("name") == model_name(lone("psm")) == "lone_psm"
    assert (made.find("sdf").get("version"), made.findtext("sdf")) == ("1.7", "model.sdf")


def test_an_unknown_version_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown SDF version '1.8'.*known: 1.9, 1.7, 1.11"):
        sdf(lone("ecm"), "1.8")
