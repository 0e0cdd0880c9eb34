"""docs/your-lab.md, followed as it is written."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from trocar.cli import main
from trocar.descriptions import load_rig
from trocar.kinematics.forward import pose

PAGE = Path(__file__).parents[1] / "docs" / "your-lab.md"
TEXT = PAGE.read_text(encoding="utf-8")


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder with the page's files."""
    files = re.findall(r"<!-- file: (\S+) -->\n```json\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    assert len(files) == 3
    for name, content in files:
        (tmp_path / name).write_text(content, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_commands_of_the_page_print_what_it_shows(
    lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = dict.fromkeys(re.findall(r"^trocar (.*)$", TEXT, re.MULTILINE))
    ran = [line for line in lines if "--rig lab.toml" not in line or "--headless" in line]
    assert len(ran) == 2
    assert main(shlex.split(ran[0])) == 0
    printed = capsys.readouterr()
    (shown,) = re.findall(r"<!-- output -->\n```\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    assert shown in printed.out.replace(f"{lab}/", "")
    assert "MTMR-22222.json: favourite_colour" in printed.err
    figures = re.findall(r"[\d.]+e[-+]\d+", printed.out)
    assert len(figures) == 2  # the bases; no chain, tip or setup joint of this lab has a file
    assert max(float(figure) for figure in figures) < 1e-9  # as the page says
    assert main(shlex.split(ran[1])) == 0


def test_the_rig_of_the_page_is_what_the_page_says(lab: Path) -> None:
    assert main(["import-dvrk", "system-lab.json", "-o", "lab.toml"]) == 0
    rig = load_rig(lab / "lab.toml")
    frame = rig.arm("PSM1").base_frame
    assert frame is not None
    assert frame.name == "ECM"
    np.testing.assert_allclose(frame.pose[:3, 3], [-0.2, 0.0, 0.0])
    (teleop,) = rig.teleops
    assert (teleop.masters, teleop.slave, teleop.scale) == (("MTMR",), "PSM1", 0.3)


def test_the_picture_of_the_page_is_there() -> None:
    for name in re.findall(r"\]\((images/\S+)\)", TEXT):
        assert (PAGE.parent / name).stat().st_size > 20_000


def test_the_custom_instrument_of_the_page_is_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    pattern = r"<!-- custom: (\S+) -->\n```json\n(.*?)^```"
    files = re.findall(pattern, TEXT, re.DOTALL | re.MULTILINE)
    assert len(files) == 4
    for name, content in files:
        (tmp_path / name).write_text(content, encoding="utf-8")
    (line,) = re.findall(r"`trocar (import-dvrk system-probe[^`]*)`", TEXT)
    assert main(shlex.split(line)) == 0
    assert "MY_PROBE:420901 has no jaw" in capsys.readouterr().out
    arm = load_rig("probe.toml").arm("PSM1").arm
    tip = pose(arm.mechanism, np.zeros(7), "tip", "wrist_yaw")[:3, 3]
    assert np.linalg.norm(tip) == pytest.approx(0.01)
    assert (tmp_path / "probe_psm1_tool.toml").is_file()
