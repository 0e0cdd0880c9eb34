"""What `trocar export --format sdf` puts into a folder."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from trocar.apps.exports import Options, export, find_rig
from trocar.cli import main
from trocar.errors import InputError, UnknownNameError

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
    done = export(find_rig("ecm"), "sdf", tmp_path / "ecm", Options(sdf_version=version))
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
    done = export(find_rig("psm"), "sdf", tmp_path / "psm", Options(sdf_version=version))
    assert len(done.warnings) == bool(loose)
    assert not loose or loose in done.warnings[0]


def test_an_unknown_version_is_refused_and_nothing_is_written(tmp_path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown SDF version '2.0'"):
        export(find_rig("ecm"), "sdf", tmp_path / "ecm", Options(sdf_version="2.0"))
    assert not list(tmp_path.iterdir())


def test_bad_input_is_one_line_and_exit_status_2(tmp_path, capfd) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine", encoding="utf-8")
    for arguments, told in (
        (["psm", "--sdf-version", "1.8", "-o", "new"], "unknown SDF version '1.8'"),
        (["psm", "-o", "full"], "is not empty (got mine.txt)"),
        (["psm_si", "-o", "new"], "has no mass for"),
        (["pms", "-o", "new"], "unknown arm or rig 'pms'"),
        (["psm", "--tool", "SPOON", "-o", "new"], "SPOON"),
        (["psm", "--calibration", "none.toml", "-o", "new"], "none.toml"),
    ):
        folder = [str(tmp_path / a) if a in ("new", "full") else a for a in arguments]
        assert main(["export", *folder, "--format", "sdf"]) == 2
        said = capfd.readouterr()
        assert told in said.err
        assert said.err.startswith("trocar: error: ")
        assert said.err.count("\n") == 1
    assert [entry.name for entry in tmp_path.rglob("*")] == ["full", "mine.txt"]


def test_a_folder_with_something_in_it_is_not_overwritten(tmp_path) -> None:
    export(find_rig("ecm"), "sdf", tmp_path)
    (tmp_path / "model.sdf").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match="is not empty"):
        export(find_rig("ecm"), "sdf", tmp_path)
    assert (tmp_path / "model.sdf").read_text(encoding="utf-8") == "mine"
    export(find_rig("ecm"), "sdf", tmp_path, force=True)
    assert (tmp_path / "model.sdf").read_text(encoding="utf-8") != "mine"


def test_an_arm_without_masses_is_refused_and_nothing_is_written(tmp_path) -> None:
    with pytest.raises(InputError, match="has no mass for"):
        export(find_rig("psm_si"), "sdf", tmp_path / "psm_si")
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
