"""The gallery of the web viewer: every scene and rig, with figures that stand in the docs."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from trocar.cli.gallery import controls, figures_of, gallery, load
from trocar.descriptions import names
from trocar.viewer import Choice
from trocar.viewer.gallery import PICTURES

DOCS = Path(__file__).parents[2] / "docs"
FIGURES = tomllib.loads(PICTURES.joinpath("figures.toml").read_text(encoding="utf-8"))


def test_every_scene_and_rig_has_a_card_and_a_picture() -> None:
    found = gallery("psm")
    for kind, shelf in (("scene", "scenes"), ("rig", "rigs")):
        for name in names(shelf):  # type: ignore[arg-type]
            assert found.choose(f"{kind}/{name}"), name
            assert PICTURES.joinpath(f"{name}.jpg").is_file(), name


def test_the_figures_are_those_of_the_docs() -> None:
    rows = re.findall(
        r"^\| ([a-z0-9-]+) \| (\d+) of (\d+) \| ([\d.]+) \+- ",
        (DOCS / "scenes.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert len(rows) > 20
    for name, met, of, time_s in rows:
        assert FIGURES[name]["success"] == [int(met), int(of)], name
        assert FIGURES[name]["time_s"] == float(time_s), name
    assert set(FIGURES) == set(names("scenes"))
    assert "50 of 50" in figures_of("needle-pick") and figures_of("own") == ""


def test_a_choice_becomes_a_world_and_a_scene_has_its_policy() -> None:
    world, task = load(Choice("rig", "psm"))
    assert world.rig.name == "psm" and task is None
    world, task = load(Choice("scene", "needle-reach"))
    assert task is not None and task.task.world is world
    shown = controls(task)
    assert (shown.driver, shown.arms) == ("scripted policy", task.task.arms)
    assert shown.drives() == "scripted policy"
    shown.take()
    assert shown.drives() == ""
