"""Packages of others: what they register is found by name, and their faults are named."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from trocar.descriptions import load_rig, names
from trocar.descriptions.plugins import load_registered, registered
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.simulation import World

EXAMPLE = Path(__file__).parents[2] / "examples" / "plugin"


def install(folder: Path, package: str, groups: dict[str, dict[str, str]]) -> None:
    """Write what pip writes of a package's entry points."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines: list[str] = []
    for group, entries in groups.items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items()), ""]
    (info / "entry_points.txt").write_text("\n".join(lines))


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of installed packages."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    registered.cache_clear()
    yield folder
    registered.cache_clear()


@pytest.fixture
def example(site: Path) -> Path:
    """The example package, installed."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    shutil.copytree(EXAMPLE / "src", site, dirs_exist_ok=True)
    install(site, "trocar_example", project["entry-points"])
    registered.cache_clear()
    return site


@pytest.mark.usefixtures("example")
def test_the_example_package_adds_an_arm_a_tool_a_rig_and_a_prop() -> None:
    assert "long_psm" in names("arms") and "BLUNT_DRIVER:1" in names("tools")
    rig = load_rig("example_bench")
    assert rig.arms[0].arm.name == "long_psm" and rig.arms[0].arm.tool == "BLUNT_DRIVER:1"
    (dumbbell,) = rig.objects
    volume = 3.14159265 * 1e-6 * 0.016 + 4.0 / 3.0 * 3.14159265 * (1e-9 + 2 * 64e-9)
    assert dumbbell.movable is not None
    assert dumbbell.movable.mass == pytest.approx(1100.0 * volume, rel=1e-6)
    task = load_registered("tasks", "example_scene")()
    assert not task.done(World(rig)) and set(registered("scenes")) == {"example_scene"}


@pytest.mark.usefixtures("example")
def test_an_arm_follows_a_registered_controller() -> None:
    world = World("example_bench")
    arm = world.arm("PSM1")
    assert arm.forces.use_controller("float", {"damping": 2.0})
    world.step(20)
    assert arm.operating_state().state == "ENABLED"
    with pytest.raises(
        UnknownNameError, match=r"unknown controller 'flaot' \(did you mean 'float'"
    ):
        arm.forces.use_controller("flaot")
    with pytest.raises(InputError, match=r"controller float: got \{'stiffness': 1.0\}: TypeError"):
        arm.forces.use_controller("float", {"stiffness": 1.0})


def test_a_controller_that_raises_puts_its_arm_into_fault(site: Path) -> None:
    (site / "wild.py").write_text("class Wild:\n    def act(self, now):\n        return 1 / 0\n")
    install(site, "wild", {"trocar.controllers": {"wild": "wild:Wild"}})
    world = World("psm")
    world.arm("PSM1").forces.use_controller("wild")
    world.step(5)
    assert world.arm("PSM1").operating_state().state == "FAULT"


def test_the_command_line_lists_and_shows_what_a_package_adds(example: Path) -> None:
    path = os.pathsep.join([str(example), *(p for p in sys.path if p)])
    done = subprocess.run(
        [sys.executable, "-m", "trocar", "list", "rigs", "--json"],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "example_bench" in {row["name"] for row in json.loads(done.stdout)["rigs"]}


def test_a_package_that_cannot_be_imported_is_named(site: Path) -> None:
    install(site, "broken", {"trocar.arms": {"mine": "not_there:ARM"}})
    with pytest.raises(InputError, match=r"trocar.arms 'mine' of the package broken: .*not_there"):
        load_registered("arms", "mine")


def test_a_registered_thing_that_is_no_file_is_named(site: Path) -> None:
    install(site, "odd", {"trocar.rigs": {"mine": "math:pi"}})
    with pytest.raises(InputError, match=r"package odd: got 3.14.*; allowed: the path of a TOML"):
        load_rig("mine")


def test_one_name_of_two_packages_is_an_error(site: Path) -> None:
    for package, value in (("one", "math:pi"), ("two", "math:e")):
        install(site, package, {"trocar.rigs": {"mine": value}})
    with pytest.raises(InputError, match=r"got 'mine' from the package (one|two) and from the"):
        names("rigs")


@pytest.mark.usefixtures("example")
def test_an_unknown_prop_lists_the_registered_ones(tmp_path: Path) -> None:
    text = Path(load_rig("psm").file).read_text(encoding="utf-8")
    file = tmp_path / "mine.toml"
    file.write_text(f'{text}\n[[prop]]\nname = "p"\ndescription = "dumbell"\n')
    with pytest.raises(DescriptionError, match=r"got 'dumbell'; allowed: .*: dumbbell"):
        load_rig(file)
