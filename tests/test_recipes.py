"""docs/recipes.md: its commands and files work (its Python runs in tests/test_pages.py)."""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.test_docs import SERVES
from trocar.cli import main
from trocar.descriptions import load_rig
from trocar.simulation import World

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "recipes.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", TEXT, re.DOTALL | re.MULTILINE))


def blocks(section: str, language: str) -> list[str]:
    (text,) = [body for title, body in SECTIONS.items() if section in title]
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def run(line: str, *more: str) -> None:
    words = shlex.split(line)
    assert words[0] == "trocar"
    more = more or (() if "--headless" in words else SERVES.get(words[1], ()))
    if "--no-page" in words and "--port" in more:
        more = ("--duration", "0.2", "--websocket-port", "0")
    assert main([*words[1:], *more]) == 0


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_there_are_twelve() -> None:
    assert len(SECTIONS) == 12


def test_the_tip_is_where_the_camera_shows_it(opengl: str) -> None:  # noqa: ARG001
    from trocar.rendering import Endoscope

    names: dict[str, object] = {}
    exec(compile(blocks("tip in the camera", "python")[0], "recipes.md", "exec"), names)
    world = names["world"]
    assert isinstance(world, World)
    tip = world.true_state("PSM1").world[:3, 3]
    drawn = Endoscope(world).capture().project(tip, eye=0)
    np.testing.assert_allclose(names["pixel"], drawn, atol=1e-6)  # type: ignore[arg-type]


def test_a_phantom_lies_under_the_instrument(here: Path) -> None:
    pytest.importorskip("trimesh", reason="the extra `all` is not installed")
    import trimesh

    trimesh.creation.box((80.0, 60.0, 20.0)).export(here / "phantom.stl")
    commands = blocks("phantom", "sh")
    run(commands[0].strip())
    (rig,) = blocks("phantom", "toml")
    (here / "phantom_rig.toml").write_text(rig, encoding="utf-8")
    run(commands[1].strip())
    assert [prop.name for prop in load_rig(here / "phantom_rig.toml").props] == ["phantom"]


def test_slow_motion_and_a_server_without_a_display_run(here: Path) -> None:  # noqa: ARG001
    (slow,) = blocks("slow motion", "sh")
    run(slow.splitlines()[0])
    assert (
        "trocar play peg-board --speed 0.2" in slow
    )  # runs as tests/cli/test_slow_motion.py has it
    (server,) = blocks("without a display", "sh")
    run(server.strip(), "--duration", "0.1", "--websocket-port", "0")


def test_a_second_psm_has_its_own_tool(here: Path) -> None:
    (rig,) = blocks("second PSM", "toml")
    (here / "two.toml").write_text(rig, encoding="utf-8")
    world = World(here / "two.toml")
    world.arm("PSM2").move_jp([0.1, 0.0, 0.13, 0.0, 0.0, 0.0]).wait()
    assert world.arm("PSM2").description.tool == "PROGRASP_FORCEPS:400093"


def test_a_script_runs(here: Path, capsys: pytest.CaptureFixture[str]) -> None:  # noqa: ARG001
    (python,) = blocks("dVRK script", "python")
    exec(compile(python, "recipes.md", "exec"), {})
    (command,) = blocks("dVRK script", "sh")
    run(command.strip(), "--rig", "psm")
    assert "0.2" in capsys.readouterr().out


def test_a_student_s_simulator_starts(here: Path) -> None:  # noqa: ARG001
    (loop,) = blocks("twenty students", "sh")
    (line,) = [line.strip() for line in loop.splitlines() if line.strip().startswith("trocar")]
    line = line.removesuffix(" &").replace("$((9100 + k))", "0").replace("$k", "7")
    run(line, "--duration", "0.1")


def test_the_docker_file_copies_what_is_there_and_serves_as_the_page_says() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    for sources in re.findall(r"^COPY (.*) \S+$", text, re.MULTILINE):
        assert all((ROOT / name).exists() for name in sources.split())
    (extra,) = re.findall(r"pip install .*'\.\[(\w+)\]'", text)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert extra in project["project"]["optional-dependencies"]
    (build,) = blocks("Docker", "sh")
    inside = build.splitlines()[1].partition("trocar ")[2]
    run(f"trocar {inside}", "--duration", "0.1", "--websocket-port", "0")
