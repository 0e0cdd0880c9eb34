"""The folder of an SDF, and the program for Drake that docs/exports.md shows."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import UnknownNameError
from trocar.formats.export import export, find_rig
from trocar.kinematics.forward import pose

etree = pytest.importorskip("lxml.etree", reason="lxml is not installed (extra: export)")


def test_the_folder_has_model_world_card_and_readme(tmp_path) -> None:
    done = export(find_rig("psm"), "sdf", tmp_path / "psm")
    own = [name for name in done.files if not name.startswith("meshes/")]
    assert own == ["README.md", "model.config", "model.sdf", "psm.world.sdf"]
    card = etree.parse(tmp_path / "psm" / "model.config")
    assert (tmp_path / "psm" / card.findtext("sdf")).is_file()


@pytest.mark.parametrize("name", ["psm", "full_cart_mtm"])
def test_every_mesh_that_a_file_names_lies_beside_it_and_no_other(name, tmp_path) -> None:
    done = export(find_rig(name), "sdf", tmp_path / name)
    named = {uri.text for uri in etree.parse(tmp_path / name / "model.sdf").iter("uri")}
    assert named == {file for file in done.files if file.startswith("meshes/")}


@pytest.mark.parametrize("version", ["1.7", "1.9", "1.11"])
def test_the_version_is_the_one_asked_for(version, tmp_path) -> None:
    done = export(find_rig("ecm"), "sdf", tmp_path / "ecm", {"sdf_version": version})
    for file in ("model.sdf", "ecm.world.sdf"):
        assert etree.parse(done.folder / file).getroot().get("version") == version
    assert not done.warnings  # an ECM has no coupling that is no loop


@pytest.mark.parametrize(
    ("version", "loose"),
    [
        ("1.7", "PSM1_counterweight "),
        ("1.9", "PSM1_counterweight, PSM1_finger_right "),
        ("1.11", ""),
    ],
)
def test_what_gazebo_lets_go_is_a_warning(version, loose, tmp_path) -> None:
    done = export(find_rig("psm"), "sdf", tmp_path / "psm", {"sdf_version": version})
    assert len(done.warnings) == bool(loose)
    assert not loose or loose in done.warnings[0]


def test_an_unknown_version_is_refused_and_nothing_is_written(tmp_path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown SDF version '2.0'"):
        export(find_rig("ecm"), "sdf", tmp_path / "ecm", {"sdf_version": "2.0"})
    assert not list(tmp_path.iterdir())


def test_the_readme_names_loops_and_couplings(tmp_path) -> None:
    export(find_rig("psm"), "sdf", tmp_path / "psm")
    text = (tmp_path / "psm" / "README.md").read_text(encoding="utf-8")
    assert "`PSM1_c1_joint`, `PSM1_c2_joint`" in text
    assert "| PSM1_counterweight_joint | 0.6025 * PSM1_insertion_joint |" in text
    export(find_rig("suj_psm1"), "sdf", tmp_path / "suj")
    assert "## Loops" not in (tmp_path / "suj" / "README.md").read_text(encoding="utf-8")


@pytest.mark.skipif(shutil.which("ign") is None, reason="ign (sdformat) is not installed")
def test_the_world_is_valid_wherever_it_lies(tmp_path) -> None:
    export(find_rig("psm"), "sdf", tmp_path / "any name")
    done = subprocess.run(
        ["ign", "sdf", "-k", "psm.world.sdf"],
        cwd=tmp_path / "any name",
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.strip() == "Valid."


PAGE = (Path(__file__).parents[2] / "docs" / "exports.md").read_text(encoding="utf-8")


def test_drake_simulates_the_exported_arm_with_its_loops(tmp_path, monkeypatch, capsys) -> None:
    pytest.importorskip("pydrake", reason="pydrake is not installed (extra: judges)")
    export(find_rig("psm"), "sdf", tmp_path / "psm_sdf")
    monkeypatch.chdir(tmp_path)
    programs = re.findall(r"^```py\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    (program,) = (text for text in programs if "pydrake" in text)
    capsys.readouterr()
    said: dict[str, object] = {}
    exec(compile(program, "exports.md", "exec"), said)
    printed = capsys.readouterr().out
    first, second = (np.array(line.strip("[]").split(), float) for line in printed.splitlines())
    arm = load_arm("psm")
    expected = pose(arm.mechanism, np.array([0, 0.3, 0.12, 0, 0, 0, 0]), "tip", "rcm")[:3, 3]
    assert np.abs(first - expected).max() < 1e-9
    assert np.abs(second - expected).max() < 5e-4  # a soft servo under gravity
    shown = re.findall(r"^\[ .*\]$", PAGE, re.MULTILINE)
    for line, value in zip(shown, (first, second), strict=True):
        # The servo's sag is that of the masses, which may be known better one day.
        assert np.abs(np.array(line.strip("[]").split(), float) - value).max() < 1e-4
