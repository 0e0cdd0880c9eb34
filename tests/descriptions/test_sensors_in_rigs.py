"""A rig's sensors are read in SI, and each mistake in one is named with what is allowed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import RigDescription, load_rig, names
from trocar.descriptions.catalogue import DATA
from trocar.descriptions.sensors import KINDS, Imu, Proximity, TipWrench
from trocar.errors import DescriptionError
from trocar.geometry.rotations import matrix_from_rpy

GOOD = """
[[sensor]]
name = "first"
kind = "{kind}"
arm = "PSM1"
{more}
"""
#: The least that each kind needs.
LEAST = {
    "joint_effort": 'joint = "yaw"',
    "tip_wrench": "",
    "contacts": "",
    "proximity": "xyz_mm = [0, -8, 0]",
    "imu": 'frame = "insertion"',
    "twist": 'frame = "insertion"',
}


def rig_file(folder: Path, sensors: str) -> Path:
    path = folder / "rig.toml"
    rig = (DATA / "rigs" / "two_psm_ecm.toml").read_text(encoding="utf-8")
    path.write_text(rig + "\n" + sensors, encoding="utf-8")
    return path


def rig(folder: Path, kind: str, more: str) -> RigDescription:
    return load_rig(rig_file(folder, GOOD.format(kind=kind, more=more)))


def test_every_kind_is_read_here() -> None:
    assert [*LEAST, "tension"] == list(KINDS)  # of bands: test_prop_blocks.py, test_props.py


def test_a_rig_has_no_sensors_unless_its_file_places_some() -> None:
    for name in names("rigs"):
        assert load_rig(name).sensors == ()


def test_what_is_left_out_of_a_wrench_and_a_ray_comes_from_the_arm(tmp_path: Path) -> None:
    (wrench,) = rig(tmp_path, "tip_wrench", "").sensors
    assert isinstance(wrench, TipWrench)
    assert (wrench.frame, wrench.beyond, wrench.rate) == ("tip", "tip", 0.0)
    np.testing.assert_array_equal(wrench.pose, np.eye(4))
    assert set(wrench.noise.values()) == {0.0}
    (ray,) = rig(tmp_path, "proximity", "xyz_mm = [1, -8, 2]").sensors
    assert isinstance(ray, Proximity)
    assert (ray.frame, ray.to_frame) == ("finger_left", "finger_right")
    np.testing.assert_allclose(ray.to_point, [1e-3, -8e-3, 2e-3])
    (back,) = rig(tmp_path, "proximity", 'xyz_mm = [0, 0, 0]\nframe = "finger_right"').sensors
    assert isinstance(back, Proximity) and back.to_frame == "finger_left"


def test_units_stand_in_the_keys_and_become_si(tmp_path: Path) -> None:
    more = 'frame = "roll"\nxyz_mm = [1, 2, 3]\nrpy_deg = [0, 0, 90]\nrate_hz = 50\n'
    (imu,) = rig(tmp_path, "imu", more + "noise_deg_s = 180.0\nnoise_m_s2 = 0.2").sensors
    assert isinstance(imu, Imu)
    np.testing.assert_allclose(imu.pose[:3, 3], [1e-3, 2e-3, 3e-3])
    np.testing.assert_allclose(imu.pose[:3, :3], matrix_from_rpy(0.0, 0.0, np.pi / 2))
    assert imu.rate == 50.0
    assert imu.noise == {"angular_velocity": pytest.approx(np.pi), "linear_acceleration": 0.2}
    (slide,) = rig(tmp_path, "joint_effort", 'joint = "insertion"\nnoise_n = 0.3').sensors
    assert slide.noise == {"effort": 0.3}


SENSOR_FAULTS = [
    ("imu", LEAST["imu"] + '\nkind_of = "x"', "kind_of", "unknown key; this table knows: arm"),
    (
        "gyro",
        "",
        "kind",
        "got 'gyro'; allowed: joint_effort, tip_wrench, contacts, proximity, imu, twist",
    ),
    ("joint_effort", "", "joint", "is missing; a text is needed"),
    ("joint_effort", 'joint = "yow"', "joint", "got 'yow'; PSM1 has no such joint; allowed: yaw,"),
    ("joint_effort", 'joint = "yaw"\nnoise_n = 1.0', "noise_n", "unknown key"),
    ("joint_effort", 'joint = "yaw"\nframe = "yaw"', "frame", "unknown key"),
    ("joint_effort", 'joint = "yaw"\nnoise_nm = -1.0', "noise", "got -1; allowed: 0 or more"),
    ("imu", "", "frame", "is missing; a text is needed"),
    ("imu", 'frame = "pitch"', "frame", "got 'pitch'; PSM1 has no such frame; allowed: base,"),
    ("imu", 'frame = "roll"\nxyz_mm = [1, 2]', "xyz_mm", "a list of 3 numbers"),
    ("imu", 'frame = "roll"\nxyz_in = [1, 2, 3]', "xyz_in", "unknown key"),
    ("imu", 'frame = "roll"\nrotation = [[1,0,0],[0,1,0],[0,0,2]]', "rotation", ""),
    ("imu", 'frame = "roll"\nrate_hz = 0', "rate_hz", "got 0; allowed: above 0"),
    ("imu", 'frame = "roll"\nrate_hz = -2.5', "rate_hz", "got -2.5; allowed: above 0"),
    ("twist", "", "frame", "is missing; a text is needed"),
    ("twist", 'frame = "roll"\nnoise_m_s = -1', "noise", "got -1; allowed: 0 or more"),
    ("tip_wrench", 'beyond = "hand"', "beyond", "got 'hand'; PSM1 has no such frame; allowed:"),
    ("proximity", "", "xyz", "is missing; allowed keys: xyz_m, xyz_mm"),
    ("proximity", 'xyz_mm = [0, 0, 0]\nto_frame = "thumb"', "to_frame", "got 'thumb'; PSM1 has"),
    ("contacts", 'frame = "skin"', "frame", "got 'skin'; PSM1 has no such frame; allowed: base,"),
]


@pytest.mark.parametrize(("kind", "more", "key", "message"), SENSOR_FAULTS)
def test_a_fault_in_a_sensor_is_named(
    kind: str, more: str, key: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(DescriptionError) as caught:
        rig(tmp_path, kind, more)
    assert caught.value.file == str(tmp_path / "rig.toml")
    assert caught.value.key == f"sensor[0].{key}"
    assert message in str(caught.value)


@pytest.mark.parametrize("kind", LEAST)
def test_a_sensor_on_an_arm_that_is_not_there_lists_the_arms(kind: str, tmp_path: Path) -> None:
    text = GOOD.format(kind=kind, more=LEAST[kind]).replace("PSM1", "PSM7")
    with pytest.raises(DescriptionError) as caught:
        load_rig(rig_file(tmp_path, text))
    assert caught.value.key == "sensor[0].arm"
    known = ", ".join(arm.name for arm in load_rig("two_psm_ecm").arms)
    assert f"got 'PSM7'; this rig has no such arm; allowed: {known}" in str(caught.value)


@pytest.mark.parametrize("kind", LEAST)
def test_only_contacts_may_be_those_of_no_arm(kind: str, tmp_path: Path) -> None:
    path = rig_file(tmp_path, GOOD.format(kind=kind, more=LEAST[kind]).replace('arm = "PSM1"', ""))
    if kind == "contacts":
        assert load_rig(path).sensors[0].arm == ""
        path.write_text(path.read_text(encoding="utf-8") + 'frame = "roll"\n', encoding="utf-8")
        with pytest.raises(DescriptionError, match=r"sensor\[0\].frame: needs arm = NAME"):
            load_rig(path)
    else:
        with pytest.raises(DescriptionError, match=r"sensor\[0\].arm: is missing"):
            load_rig(path)


def test_names_are_needed_and_told_apart(tmp_path: Path) -> None:
    one = GOOD.format(kind="contacts", more="")
    with pytest.raises(DescriptionError, match=r"sensor\[1\].name: got 'first' a second time"):
        load_rig(rig_file(tmp_path, one + one))
    with pytest.raises(DescriptionError, match=r"sensor\[0\].name: got an empty text"):
        load_rig(rig_file(tmp_path, one.replace("first", "")))
    with pytest.raises(DescriptionError, match=r"sensor: got .*; allowed: \[\[sensor\]\] tables"):
        load_rig(rig_file(tmp_path, "[sensor]\nname = 'tip'"))


def test_an_arm_without_a_jaw_has_no_pads_of_its_own(tmp_path: Path) -> None:
    bare = GOOD.format(kind="proximity", more=LEAST["proximity"]).replace("PSM1", "ECM")
    with pytest.raises(DescriptionError, match=r"sensor\[0\].frame: is missing"):
        load_rig(rig_file(tmp_path, bare))
    with pytest.raises(DescriptionError, match=r"sensor\[0\].to_frame: is missing"):
        load_rig(rig_file(tmp_path, bare + 'frame = "insertion"\n'))
    path = rig_file(tmp_path, bare + 'frame = "insertion"\nto_frame = "base"\n')
    (ray,) = load_rig(path).sensors
    assert isinstance(ray, Proximity) and ray.to_frame == "base"
