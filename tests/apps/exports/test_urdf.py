"""The folder of a URDF: what is in it, and what its README promises."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from trocar.apps.exports import Options, export, find_rig
from trocar.descriptions.calibrated import calibrated_rig
from trocar.errors import InputError
from trocar.modeling.links import rig_links

pytest.importorskip("lxml", reason="exports need the extra 'export'")


def test_a_folder_has_the_model_views_and_a_readme(tmp_path) -> None:
    done = export(find_rig("psm"), "urdf", tmp_path)
    assert {"README.md", "psm.urdf", "psm_drake.urdf", "rviz/trocar.rviz"} <= set(done.files)
    assert "package.xml" not in done.files and done.warnings == ()
    readme = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "| PSM1 | jaw | `PSM1_finger_left` | 2 |" in readme
    assert "LARGE_NEEDLE_DRIVER:400006" in readme and "as drawn" in readme


def test_a_package_says_its_name_wherever_it_counts(tmp_path) -> None:
    done = export(find_rig("psm"), "urdf", tmp_path, Options(package="my_psm"))
    assert {"package.xml", "CMakeLists.txt"} <= set(done.files)
    assert "<name>my_psm</name>" in (tmp_path / "package.xml").read_text(encoding="utf-8")
    assert "project(my_psm)" in (tmp_path / "CMakeLists.txt").read_text(encoding="utf-8")
    text = (tmp_path / "psm.urdf").read_text(encoding="utf-8")
    assert 'filename="meshes/' not in text


@pytest.mark.parametrize("name", ["My-PSM", "2psm", "p", "psm/../x"])
def test_a_name_that_ros_would_refuse_is_refused(name, tmp_path) -> None:
    with pytest.raises(InputError, match=r"--package: got .*allowed: a lower-case letter"):
        export(find_rig("psm"), "urdf", tmp_path / "new", Options(package=name))
    assert not list(tmp_path.iterdir())


def test_a_general_loop_is_told_to_be_a_straight_line(tmp_path, skew_overlay, rng) -> None:
    rig = calibrated_rig(find_rig("psm"), skew_overlay("psm", rng))
    (warning,) = export(rig, "urdf", tmp_path).warnings
    off = rig_links(rig).line_errors["PSM1"]
    assert warning.startswith("PSM1: its loops are no parallelograms")
    assert f"{1e3 * off:.3f} mm" in warning
    assert warning in (tmp_path / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("package", ["", "scope"])
def test_the_readme_loads_the_model_as_it_says(package, tmp_path) -> None:
    for library in ("yourdfpy", "pinocchio", "pydrake"):
        pytest.importorskip(library, reason=f"{library} is not installed (extra judges)")
    export(find_rig("ecm"), "urdf", tmp_path / "scope", Options(package=package))
    readme = (tmp_path / "scope" / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
    said = run(code, tmp_path / "scope")
    assert (said.returncode, said.stderr) == (0, "")


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", code]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=120)
