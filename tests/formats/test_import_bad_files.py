"""Each fault of a foreign file is one error that says where; nothing is written."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from tests.formats.texts import MJCF, SDF, URDF
from trocar.errors import InputError
from trocar.formats.importing import ImportOptions, import_file

FAULTS = [
    (
        '<link name="base">',
        '<lnk/><link name="base">',
        r"robot.urdf:3: <lnk> is unknown inside <robot>: did you mean <link>",
    ),
    ("<mass value", "<weight value", r"<weight> is unknown inside <inertial>|lacks <mass>"),
    ('<parent link="base"/>', '<parent link="floor"/>', "names link 'floor'; known: base"),
    ('type="revolute"', 'type="floating"', "got the type 'floating'; allowed: fixed, revolute"),
    ('xyz="1 2 -1"', 'xyz="0 0 0"', "axis of length 0"),
    ('xyz="1 2 -1"', 'xyz="1 2"', "got '1 2'; allowed: 3 finite numbers"),
    (
        '<child link="thumb"/>',
        '<child link="finger"/>',
        "has two parent joints, 'grip' and 'grip2'",
    ),
    ('<child link="fore"/>', '<child link="upper"/>', "has two parent joints"),
    ('<mimic joint="grip"', '<mimic joint="gripper"', "mimics 'gripper', which does not exist"),
    ('<mimic joint="grip"', '<mimic joint="grip2"', "'grip2' mimics itself"),
    ('<box size="0.2 0.2 0.1"/>', '<mesh filename="a.stl"/>', "'a.stl' not found .searched"),
    (
        '<box size="0.2 0.2 0.1"/>',
        '<box size="200 200 100"/>',
        "got a size of 200 m; allowed: 0.0005",
    ),
    ("</robot>", "", r"robot.urdf:\d+: is not XML"),
    ("<robot", "<car", "is not XML|is not a robot"),
]


@pytest.mark.parametrize(("old", "new", "problem"), FAULTS)
def test_a_fault_in_a_urdf_is_named(old: str, new: str, problem: str, tmp_path: Path) -> None:
    assert old in URDF
    (tmp_path / "robot.urdf").write_text(URDF.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=problem):
        import_file(tmp_path / "robot.urdf", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["robot.urdf"]


def test_an_inertia_of_no_body_is_mended_and_said(tmp_path: Path) -> None:
    text = URDF.replace('ixx="1e-4" iyy="1e-4" izz="1e-5"', 'ixx="1e-4" iyy="1e-4" izz="5e-4"', 1)
    (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
    found = import_file(tmp_path / "robot.urdf", tmp_path / "out")
    assert any("finger" in w and "no possible body" in w for w in found.warnings)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('<pose relative_to="left">', '<pose relative_to="nobody">', "names 'nobody'; known: "),
        ('relative_to="left">', 'relative_to="bar">', "form a cycle"),
        ("<pose>1 2 3", "<pose>1 2", "got '1 2 0 0 0.5'; allowed: 6"),
        ('<link name="base"/>', '<link name="base"/><actor/>', "<actor> is unknown inside <model>"),
        ('type="revolute"', 'type="screw"', "got the type 'screw'"),
        ('type="revolute">', 'type="universal"><axis2/>', "got the type 'universal'; allowed: fix"),
    ],
)
def test_a_fault_in_an_sdf_is_named(old: str, new: str, problem: str, tmp_path: Path) -> None:
    assert old in SDF
    text = SDF.replace(old, new, 1).format(block=0.0, rest=0.1)
    (tmp_path / "robot.sdf").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=problem):
        import_file(tmp_path / "robot.sdf", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("<connect", "<weld", "rejected by MuJoCo|is not supported"),
        (
            'name="rocker" axis="0 1 0"',
            'name="rocker" type="ball"',
            "is a ball joint; allowed: hinge",
        ),
        (
            'name="peak" pos="0 0 {rest}"',
            'name="peak" pos="0 0 0.05"',
            "'closing' has a loop error of 0.0",
        ),
        ("<geom", "<gem", "rejected by MuJoCo"),
    ],
)
def test_a_fault_in_an_mjcf_is_named(old: str, new: str, problem: str, tmp_path: Path) -> None:
    assert old in MJCF
    text = MJCF.replace(old, new, 1).format(block=0.0, rest=0.1)
    (tmp_path / "robot.xml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=problem):
        import_file(tmp_path / "robot.xml", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_files_that_nobody_knows_are_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.step").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match=r"unknown format '.step'; allowed: .urdf, .xacro, .sdf"):
        import_file(tmp_path / "robot.step", tmp_path / "out")
    with pytest.raises(InputError, match="no such file"):
        import_file(tmp_path / "gone.urdf", tmp_path / "out")


def test_a_passive_joint_that_is_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.sdf").write_text(SDF.format(block=0.0, rest=0.1), encoding="utf-8")
    with pytest.raises(InputError, match="passive joint 'elbow'; known: crank, rocker, top"):
        import_file(tmp_path / "robot.sdf", tmp_path / "out", ImportOptions(passive=("elbow",)))
