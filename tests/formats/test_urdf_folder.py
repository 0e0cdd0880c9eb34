"""The folder of a URDF: its files, what its README promises, and its views for RViz."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from trocar.descriptions.calibrated import calibrated_rig
from trocar.errors import InputError
from trocar.formats.export import export, find_rig
from trocar.formats.links import rig_links
from trocar.formats.urdf import rviz_config, start_message, urdf_tree

pytest.importorskip("lxml", reason="exports need the extra 'export'")


def test_a_folder_has_the_model_views_and_a_readme(tmp_path) -> None:
    done = export(find_rig("psm"), "urdf", tmp_path)
    assert {"README.md", "psm.urdf", "psm_drake.urdf", "rviz/trocar.rviz"} <= set(done.files)
    assert "package.xml" not in done.files and done.warnings == ()
    readme = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "| PSM1 | jaw | `PSM1_finger_left` | 2 |" in readme
    assert "LARGE_NEEDLE_DRIVER:400006" in readme and "as drawn" in readme


def test_a_package_says_its_name_wherever_it_counts(tmp_path) -> None:
    done = export(find_rig("psm"), "urdf", tmp_path, {"package": "my_psm"})
    assert {"package.xml", "CMakeLists.txt"} <= set(done.files)
    assert "<name>my_psm</name>" in (tmp_path / "package.xml").read_text(encoding="utf-8")
    assert "project(my_psm)" in (tmp_path / "CMakeLists.txt").read_text(encoding="utf-8")
    text = (tmp_path / "psm.urdf").read_text(encoding="utf-8")
    assert 'filename="meshes/' not in text


@pytest.mark.parametrize("name", ["My-PSM", "2psm", "p", "psm/../x"])
def test_a_name_that_ros_would_refuse_is_refused(name, tmp_path) -> None:
    with pytest.raises(InputError, match=r"--package: got .*allowed: a lower-case letter"):
        export(find_rig("psm"), "urdf", tmp_path / "new", {"package": name})
    assert not list(tmp_path.iterdir())


def test_a_general_loop_is_told_to_be_a_straight_line(tmp_path, skew_overlay, rng) -> None:
    rig = calibrated_rig(find_rig("psm"), skew_overlay("psm", rng))
    (warning,) = export(rig, "urdf", tmp_path).warnings
    off = rig_links(rig).line_errors["PSM1"]
    assert warning.startswith("PSM1: its loops are not parallelograms")
    assert f"{1e3 * off.worst:.3f} mm at {off.frame} (--fit-tip" in warning
    assert f"{1e3 * off.tip:.3f} mm and {1e3 * off.tip_angle:.2f} mrad at the tip" in warning
    assert warning in (tmp_path / "README.md").read_text(encoding="utf-8")


def test_a_tip_is_fitted_in_a_urdf_of_a_calibrated_arm_alone(tmp_path) -> None:
    (warning,) = export(find_rig("ecm"), "urdf", tmp_path / "a", {"fit_tip": True}).warnings
    assert warning == "--fit-tip: nothing to fit, for all loops are parallelograms"
    with pytest.raises(InputError, match=r"--fit-tip: got True .*allowed: with --format urdf"):
        export(find_rig("ecm"), "sdf", tmp_path / "b", {"fit_tip": True})


@pytest.mark.parametrize("package", ["", "scope"])
def test_the_readme_loads_the_model_as_it_says(package, tmp_path) -> None:
    for library in ("yourdfpy", "pinocchio", "pydrake"):
        pytest.importorskip(library, reason=f"{library} is not installed (extra judges)")
    export(find_rig("ecm"), "urdf", tmp_path / "scope", {"package": package})
    readme = (tmp_path / "scope" / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
    said = run(code, tmp_path / "scope")
    assert (said.returncode, said.stderr) == (0, "")


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", code]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("name", ["psm", "mtml", "full_cart"])
def test_the_message_has_each_joint_that_mimics_none_where_the_rig_starts(name) -> None:
    model = rig_links(find_rig(name))
    found = dict(re.findall(r"^(name|position): \[(.*)\]$", start_message(model), re.MULTILINE))
    values = zip(found["name"].split(", "), map(float, found["position"].split(", ")), strict=True)
    own = {j.name for j in urdf_tree(model).joints if j.kind != "fixed" and not j.follows}
    message = dict(values)
    assert set(message) == own
    for joint, value in message.items():
        assert value == pytest.approx(model.start[joint], rel=1e-5)


def test_the_view_looks_at_the_middle_of_the_rig() -> None:
    arm, cart = (rviz_config(rig_links(find_rig(name)), 1) for name in ("psm", "full_cart"))
    assert distance(arm) < 2.0 < distance(cart)
    assert "Fixed Frame: world" in cart


def distance(view: str) -> float:
    (found,) = re.findall(r"Distance: (\S+)", view)
    return float(found)


def test_each_ros_has_the_classes_of_its_own_rviz() -> None:
    model = rig_links(find_rig("ecm"))
    classes = [set(re.findall(r"Class: (\w+)/", rviz_config(model, ros))) for ros in (1, 2)]
    assert classes == [{"rviz"}, {"rviz_common", "rviz_default_plugins"}]
