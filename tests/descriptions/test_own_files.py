"""A user's own files load exactly as the built-in ones, and bodies are possible."""

from __future__ import annotations

import dataclasses
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig, load_tool, names
from trocar.descriptions.catalogue import DATA

TOOLS = names("tools")


def same(one: Any, other: Any, where: str = "") -> None:
    """Assert that two records hold the same, their files aside."""
    assert type(one) is type(other), where
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            if field.name != "file":
                at = f"{where}.{field.name}"
                same(getattr(one, field.name), getattr(other, field.name), at)
    elif isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=where)
    elif isinstance(one, Mapping):
        assert list(one) == list(other), where
        for key in one:
            same(one[key], other[key], f"{where}.{key}")
    elif isinstance(one, tuple | list):
        assert len(one) == len(other), where
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            same(a, b, f"{where}[{k}]")
    else:
        assert one == other, where


@pytest.mark.parametrize("name", names("arms"))
def test_an_arm_of_ones_own_is_read_as_the_built_in_one(name: str, tmp_path: Path) -> None:
    shutil.copy(DATA / "arms" / f"{name}.toml", tmp_path / "mine.toml")
    mine = load_arm(tmp_path / "mine.toml")
    same(mine, load_arm(name))
    assert mine.file == str(tmp_path / "mine.toml")


@pytest.mark.parametrize("name", TOOLS)
def test_a_tool_of_ones_own_is_mounted_as_the_built_in_one(name: str, tmp_path: Path) -> None:
    shutil.copy(load_tool(name).file, tmp_path / "mine.toml")
    same(load_arm("psm", tmp_path / "mine.toml"), load_arm("psm", name))


@pytest.mark.parametrize("name", names("rigs"))
def test_a_rig_of_ones_own_is_read_as_the_built_in_one(name: str, tmp_path: Path) -> None:
    shutil.copy(DATA / "rigs" / f"{name}.toml", tmp_path / "mine.toml")
    same(load_rig(tmp_path / "mine.toml"), load_rig(name))


def test_a_rig_finds_the_arms_and_tools_that_lie_beside_it(tmp_path: Path) -> None:
    text = (DATA / "rigs" / "psm.toml").read_text(encoding="utf-8")
    text = text.replace('description = "psm"', 'description = "arms/mine.toml"')
    text = text.replace('tool = "LARGE_NEEDLE_DRIVER:400006"', 'tool = "tool.toml"')
    (tmp_path / "arms").mkdir()
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    shutil.copy(DATA / "arms" / "psm.toml", tmp_path / "arms" / "mine.toml")
    shutil.copy(load_tool("LARGE_NEEDLE_DRIVER:400006").file, tmp_path / "tool.toml")
    rig = load_rig(tmp_path / "rig.toml")
    same(rig, load_rig("psm"))
    assert rig.arms[0].arm.file == str(tmp_path / "arms" / "mine.toml")


@pytest.mark.parametrize("name", names("arms"))
def test_every_body_is_possible(name: str) -> None:
    """Positive mass, positive definite inertia, and no axis more than the other two together."""
    for body in load_arm(name).bodies:
        assert body.mass > 0.0
        low, middle, high = np.linalg.eigvalsh(body.inertia)
        assert low > 0.0
        assert high <= (low + middle) * 1.001  # printed with four digits


@pytest.mark.parametrize("tool", [*TOOLS, "none"])
def test_the_counterweight_balances_what_rides_on_the_insertion(tool: str) -> None:
    """Source: closed-loop paper, mu = 0.6025: it moves 0.6025 as far, so it weighs 1 / mu."""
    arm = load_arm("psm", tool)
    mechanism = arm.mechanism
    slide = mechanism.frame_index["insertion"]
    riding = sum(b.mass for b in arm.bodies if slide in mechanism.chain(b.frame))
    weight = sum(b.mass for b in arm.bodies if b.frame == "counterweight")
    assert weight * 0.6025 == pytest.approx(riding, rel=1e-12)
    if tool != "none":
        assert riding == pytest.approx(0.30, abs=0.03)


def test_tools_differ_in_what_they_weigh_down() -> None:
    masses = {
        tool: next(b.mass for b in load_arm("psm", tool).bodies if b.frame == "counterweight")
        for tool in (*TOOLS, "none")
    }
    assert masses["none"] < 0.5 * min(masses[tool] for tool in TOOLS)


def test_a_shipped_arm_is_read_once_and_an_own_one_whenever_it_is_asked_for(tmp_path):
    assert load_arm("psm") is load_arm("psm")
    assert load_arm("psm", "none") is not load_arm("psm")
    own = tmp_path / "own.toml"
    text = (DATA / "arms" / "ecm.toml").read_text(encoding="utf-8")
    for title in ("first", "second"):
        own.write_text(re.sub(r"(?m)^title = .*$", f'title = "{title}"', text), encoding="utf-8")
        assert load_arm(own).title == title
