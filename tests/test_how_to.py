"""The how-to pages, followed step by step: what they make is what they say."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from trocar.cli import main
from trocar.cli.program import build_parser
from trocar.descriptions import load_arm, load_rig, load_tool
from trocar.viewer.scene import parts_of

PAGES = Path(__file__).parents[1] / "docs" / "how-to"


def blocks(page: str, language: str) -> list[str]:
    text = (PAGES / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


@pytest.fixture
def spoon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The tool of the page on tools, made as it says."""
    monkeypatch.chdir(tmp_path)
    toml = "\n".join(blocks("design-a-tool.md", "toml"))
    (tmp_path / "spoon_grasper.toml").write_text(toml, encoding="utf-8")
    exec(compile(blocks("design-a-tool.md", "python")[1], "the mesh", "exec"), {})
    return tmp_path / "spoon_grasper.toml"


def test_the_tool_of_the_page_is_read(spoon: Path) -> None:
    tool = load_tool(spoon)
    assert tool.name == "SPOON_GRASPER:1"
    arm = load_arm("psm", spoon)
    assert np.rad2deg(arm.mechanism.upper[-1]) == pytest.approx(50.0)
    (mesh,) = (s for b in tool.parts.bodies if b.frame == "finger_left" for s in b.shapes if s.mesh)
    assert mesh.size == pytest.approx([2.6e-3, 6e-3, 3.2e-3], abs=1e-6)
    assert not mesh.collide and not mesh.weigh
    base = load_arm("psm")
    mass = {body.frame: body.mass for body in arm.bodies}
    assert set(mass) == {body.frame for body in base.bodies}
    assert mass["roll"] == pytest.approx(0.01228)


def test_the_commands_of_the_page_run(spoon: Path, capsys: pytest.CaptureFixture[str]) -> None:  # noqa: ARG001
    page = (PAGES / "design-a-tool.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if re.match(r"trocar (show|fk) ", line)]
    assert len(lines) == 2
    for line in lines:
        assert main(shlex.split(line)[1:]) == 0
        assert "SPOON_GRASPER:1" in capsys.readouterr().out


def test_the_tool_of_the_page_is_mounted_and_moves(
    spoon: Path,  # noqa: ARG001
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    names: dict[str, object] = {}
    _, _, moved, rig = blocks("design-a-tool.md", "python")
    exec(compile(moved, "design-a-tool.md", "exec"), names)
    world = names["world"]
    assert world.arm("PSM1").description.tool == "SPOON_GRASPER:1"  # type: ignore[attr-defined]
    arm = world.arm("PSM1")  # type: ignore[attr-defined]
    world.step(300)  # type: ignore[attr-defined]
    wanted = [0.2, -0.1, 0.15, 0.5, 0.3, -0.3, np.deg2rad(50)]
    # identified friction holds wrist and jaw up to 2.5 mrad short
    assert np.abs(arm.joints.readings()[0] - wanted).max() < 3e-3
    shapes = world.shapes()  # type: ignore[attr-defined]
    seen = [s for s in shapes if s.kind == "mesh" and s.frame.startswith("finger")]
    assert [s.frame for s in seen] == ["finger_left", "finger_right"]
    assert not any(s.collide for s in seen)
    (part,) = parts_of([seen[0]])
    assert len(part.faces) > 400 and np.abs(part.vertices).max() < 0.02
    assert not caplog.records
    exec(compile(rig, "design-a-tool.md", "exec"), names)
    world = names["world"]
    assert world.arm("PSM2").description.tool == "SPOON_GRASPER:1"  # type: ignore[attr-defined]
    assert capsys.readouterr().out


CONSOLE_PAGE = (PAGES / "drive-from-a-dvrk-console.md").read_text(encoding="utf-8")
SYSTEMS = Path(__file__).parents[1] / "examples" / "dvrk_console"


@pytest.mark.parametrize("line", re.findall(r"^trocar .*$", CONSOLE_PAGE, re.MULTILINE))
def test_the_commands_of_the_page_on_a_console_are_understood(line: str) -> None:
    words = shlex.split(line, comments=True)[1:]
    args = build_parser([words[0]]).parse_args(words)
    assert args.ros1
    assert not load_rig(args.rig).teleops  # whose topics would be the other console's


@pytest.mark.parametrize("path", sorted(SYSTEMS.glob("*.json")), ids=lambda path: path.stem)
def test_a_system_of_the_page_takes_arms_from_ros_that_a_rig_of_the_page_serves(path: Path) -> None:
    assert path.name in CONSOLE_PAGE
    system = json.loads(path.read_text(encoding="utf-8"))
    remote = {
        one["constructor-arg"]["Name"]: one["class-name"]
        for one in system["component_manager"]["components"]
    }
    arms = {arm["name"]: arm for arm in system["arms"]}
    kinds = {"PSM": "dvrk_psm_from_ros", "MTM": "dvrk_mtm_from_ros", "ECM": "dvrk_arm_from_ros"}
    for name, kind in remote.items():
        arm = arms[name]
        assert arm["component"] == arm["interface"] == name and arm["skip_ROS_bridge"]
        assert kinds[arm["type"].removesuffix("_GENERIC")] == kind
    served = [{arm.name for arm in load_rig(rig).arms} for rig in ("two_psm_ecm", "mtm")]
    assert any(set(remote) <= names for names in served)
    for teleop in system["consoles"][0]["teleop_PSMs"]:
        assert {teleop["MTM"], teleop["PSM"]} <= set(arms)
