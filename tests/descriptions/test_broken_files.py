"""Each message that a person can meet whose file is broken: file, key, got, allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from trocar.descriptions import load_arm, load_rig, load_tool
from trocar.descriptions.catalogue import DATA
from trocar.errors import DescriptionError, TrocarError, UnknownNameError
from trocar.modeling.build import lone_rig
from trocar.robot.dvrk_config.arms import SERIAL
from trocar.simulation import World

PSM = DATA / "arms" / "psm.toml"
TOOL = DATA / "tools" / "LARGE_NEEDLE_DRIVER_400006.toml"
RIG = DATA / "rigs" / "suj_two_psm_ecm.toml"


def edited(source: Path, folder: Path, old: str, new: str) -> Path:
    text = source.read_text(encoding="utf-8")
    assert old in text, old
    path = folder / f"my_{source.name}"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


YAW = 'solid = "psm/yaw"'
ARM_FAULTS = [
    ("schema = 1", "schema = 2", "schema", "got 2; allowed: 1"),
    ("schema = 1", "", "schema", "got None; allowed: 1"),
    ('name = "psm"', "", "name", "is missing; a text is needed"),
    ('name = "psm"', "name = 7", "name", "got 7; allowed: a text"),
    ('type = "PSM"', 'type = "UR5"', "type", "got 'UR5'; allowed: PSM, ECM, SUJ, MTM"),
    ('root = "base"', 'root = "rcm"', "root", "got 'rcm'; allowed: the first frame"),
    ('relative_to = "rcm"', 'relative_to = "rmc"', "frame", "did you mean 'rcm'"),
    ('tip = "insertion"', 'color = "red"\ntip = "insertion"', "color", "unknown key"),
    (
        "stall_nm = 7.31\n",
        "",
        "joint[0].stall",
        "got inf with a no-load speed of 9.7; allowed: both",
    ),
    (
        "stall_nm = 7.31",
        "stall_nm = 3.0",
        "joint[0].stall",
        "allowed: both or none, and effort_max",
    ),
    ("lower_rad = -1.588", "", "joint[0].lower", "allowed keys: lower_rad, lower_deg"),
    (
        "lower_rad = -1.588",
        "lower_rad = -1.588\nlower_deg = -91.0",
        "joint[0].lower_deg",
        "contradicts lower_rad",
    ),
    ("lower_rad = -1.588", "lower_mm = -1.588", "joint[0].lower", "is missing"),
    ("lower_rad = -1.588", "lower_rad = nan", "joint[0].lower_rad", "a finite number"),
    ("lower_rad = -1.588", 'lower_rad = "low"', "joint[0].lower_rad", "got 'low'"),
    ("lower_rad = -1.588", "lower_rad = true", "joint[0].lower_rad", "a finite number"),
    ("lower_rad = -1.588", "lower_rad = 2.0", "joint[0].lower", "less than the upper limit 1.588"),
    ('kind = "revolute"', 'kind = "ball"', "joint[0].kind", "allowed: revolute, prismatic"),
    ("effort_max_nm = 3.316101", "effort_max_nm = -3.3", "joint[0].effort_max", "above 0"),
    ("drive = { yaw = 1.0 }", "drive = {}", "joint[0].drive", "one frame = weight"),
    ("drive = { yaw = 1.0 }", "drive = { jaw = 1.0 }", "frame", "unknown frame 'jaw'"),
    ("drive = { yaw = 1.0 }", "drive = { yaw = 2.0 }", "joint yaw.drive", "allowed: the inverse"),
    ("drive = { yaw = 1.0 }", "drive = 1.0", "joint[0].drive", "allowed: a table"),
    ('parent = "base"', 'parent = "bose"', "frame", "comes before its parent 'bose'"),
    ('dh = "modified"', 'dh = "craig"', "frame[2].dh", "allowed: modified, standard"),
    ("q = { yaw = 1.0 }", "", "frame[2].q", "a moving frame needs q"),
    ("q = { yaw = 1.0 }", "q = { yow = 1.0 }", "frame", "unknown joint 'yow'"),
    (
        "q = { yaw = 1.0 }",
        "q = { yaw = 1.0 }\nlower_deg = 1.0\nupper_deg = 1.0",
        "frame[2].lower",
        "less than the upper limit",
    ),
    ('motion = "revolute"', 'motion = "sliding"', "frame[2].motion", "fixed, revolute, prismatic"),
    ("xyz_mm = [0.0, 486.4, 0.0]", "xyz_mm = [0.0, 486.4]", "frame[1].xyz_mm", "list of 3 numbers"),
    (
        "xyz_mm = [0.0, 486.4, 0.0]",
        "rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 2]]",
        "frame[1].rotation",
        "",
    ),
    ("xyz_mm = [0.0, 486.4, 0.0]", "xyz_in = [0, 19, 0]", "frame[1].xyz_in", "unknown key"),
    ('frame_a = "pitch_front"', 'frame_a = "pitch_frnt"', "frame", "did you mean 'pitch_front'"),
    ('passive = ["pitch_front", "pitch_bottom"]', "passive = []", "closure[0].passive", "two"),
    (
        'passive = ["pitch_front", "pitch_bottom"]',
        'passive = ["roll", "pitch_bottom"]',
        "frame",
        "is not moved by 'roll'",
    ),
    ('guard = ["pitch_end", "pitch_back"]', 'guard = ["pitch_end"]', "closure[1].guard", "none"),
    ("mass_kg = 1.4705", "mass_kg = 0.0", "body[0].mass_kg", "got 0; allowed: above 0"),
    ("mass_kg = 1.4705", "mass_mg = 1470500.0", "body[0].mass", "allowed keys: mass_kg"),
    (
        "inertia_kgm2 = [0.0095, 0.0082, 0.0095, 0.0, 0.0, 0.0]",
        "inertia_kgm2 = [0.1, 0.01, 0.01, 0, 0, 0]",
        "body[1].inertia_kgm2",
        "exceeds the sum of the others",
    ),
    (
        "inertia_kgm2 = [0.0095, 0.0082, 0.0095, 0.0, 0.0, 0.0]",
        "inertia_kgm2 = [0.01, 0.01, 0.0, 0, 0, 0]",
        "body[1].inertia_kgm2",
        "allowed above 0",
    ),
    ('[[body]]\nframe = "yaw"', '[[body]]\nframe = "yow"', "body.frame", "got 'yow'"),
    (YAW, 'shape = [{ kind = "cone" }]', "body[0].shape[0].kind", "box, capsule, cylinder"),
    (
        YAW,
        'shape = [{ kind = "sphere", center_mm = [0, 0, 0], radius_mm = 0 }]',
        "body[0].shape[0].radius",
        "must be positive",
    ),
    (YAW, 'shape = [{ kind = "box", material = "gold" }]', "body[0].shape[0].material", "casting"),
    (YAW, 'shape = [{ kind = "box", color = "red" }]', "body[0].shape[0].color", "six digits"),
    (
        YAW,
        'shape = [{ kind = "box", color = "#aabbcc", material = "steel" }]',
        "body[0].shape[0].color",
        "contradicts material",
    ),
    (YAW, 'solid = "psm/yow"', "body[0].solid", "got 'psm/yow'; allowed: psm/base, psm/yaw"),
    (YAW, 'solid = "yaw"', "body[0].solid", "allowed: "),
    (YAW, "touches = true", "body[0].touches", "false where there is no `solid`"),
    (
        YAW,
        'solid = "psm/yaw"\ntouches = "hull"',
        "body[0].touches",
        'true, false, "box", "capsule"',
    ),
    (YAW, "", "body[0].inertia_kgm2", "no shape to compute it from"),
    ("ratio = 0.6025", "ratio = 0.0", "counterweight.ratio", "above 0"),
    ('joint = "insertion"\nratio', 'joint = "insert"\nratio', "counterweight.joint", "'insert'"),
    ("yaw = { coulomb_nm", "yow = { coulomb_nm", "friction.identified", "got 'yow'"),
    ("coulomb_nm = 0.0500", "coulomb_nm = -0.05", "friction.identified.yaw", "allowed: 0 or more"),
    ("insertion = { mass_kg = 0.31 }", "slide = { mass_kg = 0.31 }", "rotor", "got 'slide'"),
    ("yaw = [120.0, 0.0, 6.0], ", "", "control.dvrk.pid", "has no gains for yaw"),
    ("yaw = [120.0, 0.0, 6.0], ", "yaw = [120.0], ", "control.dvrk.pid.yaw", "list of 3 numbers"),
    ("yaw = [120.0, 0.0, 6.0], ", "yaw = [-1.0, 0, 0], ", "control.dvrk.pid.yaw", "0 or more"),
    ("q_rad_m = [0.0, 0.0, 0.12]", "q_rad_m = [0.0, 0.0]", "pose[0].q_rad_m", "list of 3 numbers"),
    ("q_rad_m = [0.0, 0.0, 0.12]", "q_rad_m = [0.0, 0.0, 1.2]", "pose home", "allowed"),
    ("gravity_compensation = true", "gravity_compensation = 1", "control.dvrk", "true, false"),
]


@pytest.mark.parametrize(("old", "new", "key", "message"), ARM_FAULTS)
def test_a_fault_in_an_arm_is_named(old, new, key, message, tmp_path):
    path = edited(PSM, tmp_path, old, new)
    with pytest.raises(DescriptionError) as caught:
        load_arm(path)
    text = str(caught.value)
    assert caught.value.file == str(path)
    assert text.startswith(f"{path}: {key}")
    assert message in text


@pytest.mark.parametrize(
    ("old", "new", "key", "message"),
    [
        ("[-1.5632, 0.0, 0.0, 0.0],", "[-1.5632, 0.0, 0.0],", "coupling.actuator", "4 numbers"),
        ("[-1.5632, 0.0, 0.0, 0.0],", "[0.0, 0.0, 0.0, 0.0],", "coupling.actuator", "invertible"),
        ("stop_lower_rad = 0.0", "stop_lower_rad = -3.0", "joint[3].stop_lower", "inside"),
        ('tip = "tip"', "", "tip", "is missing"),
    ],
)
def test_a_fault_in_a_tool_is_named(old, new, key, message, tmp_path):
    path = edited(TOOL, tmp_path, old, new)
    with pytest.raises(DescriptionError) as caught:
        load_tool(path)
    assert str(caught.value).startswith(f"{path}: {key}")
    assert message in str(caught.value)


def test_a_spring_is_for_the_last_joint_and_pushes(tmp_path):
    text = (DATA / "arms" / "mtml.toml").read_text(encoding="utf-8")
    spring = "spring = { stiffness_nm_per_rad = 0.1, rest_deg = 90.0 }"
    path = tmp_path / "arm.toml"
    on_yaw = text.replace("drive = { outer_yaw = 1.0 }", f"drive = {{ outer_yaw = 1.0 }}\n{spring}")
    path.write_text(on_yaw, encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"joint outer_yaw\.spring: allowed: on the last"):
        load_arm(path)
    path.write_text(text.replace("rad = 0.1, rest", "rad = -0.1, rest"), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"spring\.stiffness: got -0\.1; allowed: above 0"):
        load_arm(path)


RIG_FAULTS = [
    ('name = "PSM1"\ndescription = "psm"', 'name = "PSM1"\ndescription = "pzm"', "", "arm 'pzm'"),
    ('on = "SUJ_PSM1"', 'on = "PSM1"', "on", "no earlier arm; allowed: world"),
    ('on = "SUJ_PSM1"', 'on = "SUJ_PSM9"', "on", "got 'SUJ_PSM9'; no earlier arm; allowed: world"),
    ('frame = "mount"', 'frame = "mnt"', "frame", "got 'mnt'"),
    ('name = "PSM2"', 'name = "PSM1"', "name", "got 'PSM1' a second time"),
    ('name = "start"', 'name = "begin"', "pose", 'a rig needs the pose "start"'),
    ("PSM1 = [0.0, 0.0, 0.12,", "PSM1 = [9.0, 0.0, 0.12,", "PSM1", "allowed: [-1.588"),
    ("PSM1 = [0.0, 0.0, 0.12,", "PSM1 = [0.0, 0.12,", "PSM1", "list of 7 numbers"),
    ("PSM1 = [0.0, 0.0, 0.12,", "PSM7 = [0.0, 0.0, 0.12,", "", '"start" places every arm'),
    ('name = "home"', 'name = "work"', "pose", "got 'work' a second time"),
    ('name = "floor"', 'name = "table"', "prop", "got 'table' a second time"),
    ("share = ", "share = 7", "share", "above 0 to 1"),
    ('on = "SUJ_PSM1"', 'on = "HRSV"', "on", "got 'HRSV'; no earlier arm; allowed: world"),
    ('name = "PSM1"\ndescription', 'name = "HRSV"\ndescription', "name", "the stereo display"),
    (
        "schema = 1",
        'schema = 1\nreference_arm = "PSM4"',
        "reference_arm",
        "'PSM4'; allowed: PSM1",
    ),
]


@pytest.mark.parametrize(("old", "new", "key", "message"), RIG_FAULTS)
def test_a_fault_in_a_rig_is_named(old, new, key, message, tmp_path):
    path = edited(RIG, tmp_path, old, new)
    with pytest.raises(TrocarError) as caught:
        load_rig(path)
    assert isinstance(caught.value, DescriptionError | UnknownNameError)
    assert key in str(caught.value)
    assert message in str(caught.value)


def test_what_is_no_toml_and_what_is_not_there_is_said(tmp_path):
    broken = tmp_path / "broken.toml"
    broken.write_text("name = \n", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"broken.toml: is not TOML: .*line 1"):
        load_arm(broken)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DescriptionError, match=r"broken.toml: cannot be read"):
        load_arm(broken)
    with pytest.raises(DescriptionError, match="there is no such file"):
        load_arm(tmp_path / "missing.toml")
    with pytest.raises(DescriptionError, match="there is no such file"):
        load_rig(tmp_path)
    with pytest.raises(UnknownNameError, match=r"unknown arm 'pms'.*did you mean 'psm'"):
        load_arm("pms")
    with pytest.raises(UnknownNameError, match=r"unknown tool 'KNIFE'.*LARGE_NEEDLE_DRIVER:400006"):
        load_arm("psm", "KNIFE")
    with pytest.raises(UnknownNameError, match="unknown rig"):
        load_rig("../arms/psm")


def test_a_name_longer_than_a_file_s_can_be_is_unknown():
    with pytest.raises(UnknownNameError, match="unknown arm"):
        load_arm("a" * 100_000)
    with pytest.raises(UnknownNameError, match="unknown tool"):
        load_arm("psm", "a" * 100_000)
    with pytest.raises(DescriptionError, match="there is no such file"):
        load_rig("a" * 100_000 + ".toml")


def test_a_tool_on_an_arm_that_takes_none_is_rejected():
    with pytest.raises(DescriptionError, match=r"no tool .* can be mounted"):
        load_arm("ecm", "LARGE_NEEDLE_DRIVER:400006")


def test_an_arm_without_masses_says_why_it_cannot_be_simulated():
    with pytest.raises(TrocarError, match=r"serial_psm: cannot be simulated, no mass for"):
        World(lone_rig(load_arm(SERIAL["PSM"])))


def test_a_loop_that_cannot_close_is_rejected(tmp_path):
    path = edited(PSM, tmp_path, "point_a_mm = [516.0, 0.0, 0.0]", "point_a_mm = [916.0, 0, 0]")
    with pytest.raises(TrocarError, match="loop error"):
        World(lone_rig(load_arm(path)))
