"""A folder of MJCF has what MuJoCo Menagerie wants of a robot's, and its README holds."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.calibrated import apply_overlay
from trocar.descriptions.records import Gains
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import TrocarError
from trocar.formats.export import export, find_rig

ROOT = Path(__file__).parents[2]
#: The shortest file that begins as a PNG does.
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(autouse=True)
def lxml() -> None:
    pytest.importorskip("lxml", reason="exports need the extra 'export'")


def draw(_rig: object, path: Path) -> None:
    """Draw nothing, for pictures take a second and OpenGL."""
    path.write_bytes(PNG)


def blocks(folder: Path) -> list[str]:
    """Return the Python examples of a folder's README."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["psm", "full_cart"])
def test_the_folder_has_what_menagerie_wants(name, tmp_path):
    done = export(find_rig(name), "mjcf", tmp_path / "out", draw=draw)
    assert {f for f in done.files if not f.startswith("assets/")} == {
        "CHANGELOG.md", "LICENSE", "README.md", f"{name}.png", f"{name}.xml", f"{name}_mjx.xml",
        f"{name}_pid.xml", "scene.xml", "scene_mjx.xml",
    }  # fmt: skip
    assert done.warnings == ()
    licence = (tmp_path / "out" / "LICENSE").read_text(encoding="utf-8")
    assert licence == (ROOT / "LICENSE").read_text(encoding="utf-8")
    again = export(find_rig(name), "mjcf", tmp_path / "again", draw=draw)
    for file in done.files:
        assert (again.folder / file).read_bytes() == (done.folder / file).read_bytes(), file


def test_plain_mujoco_loads_every_file_without_trocar(tmp_path):
    folder = export(find_rig("psm"), "mjcf", tmp_path / "out").folder
    code = (
        "import mujoco, pathlib, sys\n"
        "for file in sorted(pathlib.Path('.').glob('*.xml')):\n"
        "    model = mujoco.MjModel.from_xml_path(str(file))\n"
        "    print(file, model.nq)\n"
        "assert 'trocar' not in sys.modules\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0 and not ran.stderr
    assert ran.stdout.split() == [
        word
        for name in ("psm", "psm_mjx", "psm_pid", "scene", "scene_mjx")
        for word in (f"{name}.xml", "13")
    ]
    assert not list(folder.glob("MUJOCO_LOG.TXT"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["psm", "mtml", "two_psm_ecm"])
def test_the_examples_of_the_readme_run(name, tmp_path, monkeypatch):
    folder = export(find_rig(name), "mjcf", tmp_path / "out").folder
    monkeypatch.chdir(folder)
    Path("your_scene.xml").write_text("<mujoco><worldbody/></mujoco>", encoding="utf-8")
    use, attach = blocks(folder)
    exec(use, {})
    found: dict[str, Any] = {}
    exec(attach, found)
    model = found["model"]
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE
    assert model.nu == 2 * sum(len(a.arm.joints) for a in find_rig(name).arms)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["psm", "full_cart"])
def test_the_readme_has_the_source_of_every_mass_and_gain_and_the_versions(name, tmp_path):
    rig = find_rig(name)
    folder = export(rig, "mjcf", tmp_path / "out").folder
    text = (folder / "README.md").read_text(encoding="utf-8")
    for place in rig.arms:
        for body in place.arm.bodies:
            assert body.source and " ".join(body.source.split()).replace("|", "/") in text
        for joint in place.arm.joints:
            assert f"| {joint.name} |" in text
        assert place.arm.control["dvrk"].source.rstrip(".") in text
    assert "MuJoCo 3.13.0 or later" in text and '<option timestep="0.001"' in text


def test_a_calibrated_arm_is_written_as_it_is(tmp_path, skew_overlay, rng):
    overlay = replace(skew_overlay("psm", rng), file="robots/serial_17.toml")
    rig = replace(lone_arm_rig(apply_overlay(load_arm("psm"), overlay)), name="psm")
    folder = export(rig, "mjcf", tmp_path / "out").folder
    assert "calibrated: serial_17.toml" in (folder / "CHANGELOG.md").read_text(encoding="utf-8")
    drawn = export(find_rig("psm"), "mjcf", tmp_path / "drawn").folder
    one, other = ((f / "psm.xml").read_text(encoding="utf-8") for f in (folder, drawn))
    assert one.count("<connect") == 8 and other.count("<connect") == 2


def test_a_picture_that_cannot_be_drawn_is_a_warning(tmp_path):
    def fail(*_: object) -> None:
        raise TrocarError("no OpenGL to draw with: nothing there")

    done = export(find_rig("ecm"), "mjcf", tmp_path / "out", draw=fail)
    assert done.warnings == ("without a picture: no OpenGL to draw with: nothing there",)
    assert not list(done.folder.glob("*.png"))
    assert "ecm.png" not in (done.folder / "README.md").read_text(encoding="utf-8")


def test_what_a_position_servo_cannot_do_is_said(tmp_path):
    rig = find_rig("ecm")
    arm = rig.arms[0].arm
    gains = {**arm.control["dvrk"].pid, "yaw": Gains(400.0, 5.0, 30.0)}
    control = {"dvrk": replace(arm.control["dvrk"], pid=gains)}
    changed = replace(rig, arms=(replace(rig.arms[0], arm=replace(arm, control=control)),))
    done = export(changed, "mjcf", tmp_path / "out")
    assert done.warnings == (
        "ECM: the integral gain of yaw is in ecm_pid.xml only; position servos have none",
    )
    pid = mujoco.MjModel.from_xml_path(str(done.folder / "ecm_pid.xml"))
    assert pid.actuator("yaw").gainprm[0] == 5.0 and pid.na == 1
