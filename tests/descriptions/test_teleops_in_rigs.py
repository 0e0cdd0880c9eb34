"""A rig's teleoperations and base frames are read in SI; each mistake names what is allowed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import RigDescription, load_rig, names
from trocar.descriptions.catalogue import DATA
from trocar.errors import DescriptionError

TOOL = """
[[teleop]]
kind = "psm"
master = "MTMR"
slave = "PSM1"
{more}
"""
SCOPE = """
[[teleop]]
kind = "ecm"
masters = ["MTML", "MTMR"]
slave = "ECM"
"""


def rig(folder: Path, more: str, base: str = "full_cart_mtm") -> RigDescription:
    path = folder / "rig.toml"
    text = (DATA / "rigs" / f"{base}.toml").read_text(encoding="utf-8").partition("[[teleop]]")[0]
    path.write_text(text + "\n" + more, encoding="utf-8")
    return load_rig(path)


def test_a_rig_has_no_teleoperation_unless_its_file_has_one() -> None:
    for name in names("rigs"):
        known: tuple[str, ...] = ()
        if name in ("full_cart_mtm", "full_cart_mtm_si"):
            known = ("MTMR_PSM1", "MTML_PSM2", "MTML_PSM3", "MTML_MTMR_ECM")
        assert tuple(teleop.name for teleop in load_rig(name).teleops) == known


def test_what_is_left_out_is_as_in_the_dvrk(tmp_path: Path) -> None:
    tool, scope = rig(tmp_path, TOOL.format(more="") + SCOPE).teleops
    assert (tool.name, tool.kind, tool.masters, tool.slave) == (
        "MTMR_PSM1", "psm", ("MTMR",), "PSM1",
    )  # fmt: skip
    assert (scope.name, scope.masters, scope.slave) == ("MTML_MTMR_ECM", ("MTML", "MTMR"), "ECM")
    assert tool.scale == scope.scale == 0.2
    assert math.degrees(tool.orientation_tolerance) == pytest.approx(5.0)
    assert math.degrees(tool.gripper_threshold) == pytest.approx(40.0)
    assert math.degrees(tool.jaw_rate_after_clutch) == pytest.approx(36.0)
    assert tool.align
    assert not tool.rotation_locked


def test_units_stand_in_the_keys(tmp_path: Path) -> None:
    more = (
        "scale = 0.4\norientation_tolerance_rad = 0.2\njaw_rate_deg_s = 90.0\ngripper_max_deg = 30"
    )
    (tool,) = rig(tmp_path, TOOL.format(more=more)).teleops
    assert tool.scale == 0.4
    assert tool.orientation_tolerance == 0.2
    assert tool.jaw_rate == pytest.approx(math.pi / 2)
    assert tool.gripper_max == pytest.approx(math.pi / 6)


def test_a_master_may_be_no_arm_of_the_rig_for_it_may_be_a_real_one(tmp_path: Path) -> None:
    (tool,) = rig(tmp_path, TOOL.format(more=""), base="psm").teleops
    assert tool.masters == ("MTMR",)


@pytest.mark.parametrize(
    ("got", "message"),
    [
        (TOOL.format(more='kind = "x"').replace('kind = "psm"\n', ""), r"kind: got 'x'.*psm, ecm"),
        (TOOL.replace("PSM1", "PSM9").format(more=""), r"slave: got 'PSM9'; allowed: PSM1, PSM2"),
        (TOOL.replace("MTMR", "ECM").format(more=""), r"master: got 'ECM'; allowed: an MTM"),
        (TOOL.format(more="scale = 1.5"), r"scale: got 1.5; allowed: above 0 to 1"),
        (TOOL.format(more="jaw_rate_deg_s = 0"), r"jaw_rate: got 0; allowed: above 0"),
        (TOOL.format(more="speed = 1"), r"teleop\[0\].speed: unknown key"),
        (TOOL.format(more="") * 2, r"name: got 'MTMR_PSM1' a second time"),
        (TOOL.format(more="gripper_zero_deg = 70"), r"gripper_zero: got .* below gripper_max"),
        (
            SCOPE.replace('"MTML", ', ""),
            r"masters: got \['MTMR'\]; allowed: the left and the right",
        ),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, got: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        rig(tmp_path, got)


def test_a_scope_cannot_be_driven_where_none_is(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="none, for this rig has no ECM"):
        rig(tmp_path, SCOPE, base="psm")


def test_a_base_frame_says_what_poses_are_told_in(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    text = (DATA / "rigs" / "psm.toml").read_text(encoding="utf-8")
    base_frame = 'base_frame = { name = "ECM", xyz_mm = [-200, 0, 0], rpy_deg = [0, 0, 90] }'
    path.write_text(text.replace('name = "PSM1"\n', f'name = "PSM1"\n{base_frame}\n', 1))
    frame = load_rig(path).arm("PSM1").base_frame
    assert frame is not None
    assert frame.name == "ECM"
    np.testing.assert_allclose(frame.pose[:3, 3], [-0.2, 0.0, 0.0])
    np.testing.assert_allclose(frame.pose[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    path.write_text(path.read_text().replace('name = "ECM", ', ""))
    with pytest.raises(DescriptionError, match=r"arm\[0\].base_frame.name: is missing"):
        load_rig(path)
