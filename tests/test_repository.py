"""What stands in the repository beside the code: no addresses of one machine, one version."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import trocar
from tools.docs import licences

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

# "" is what is always installed.
EXTRAS = ["", *PROJECT["optional-dependencies"]]

# Written so that no pattern matches its own line.
HOSTS = (
    r"py[p]i\.org|python[h]osted\.org|npm[j]s\.(org|com)|deb[.]debian\.org|ana[c]onda\.(org|com)"
)
INDEXES = r"--(extra-)?in[d]ex-url|--find-l[i]nks|https?://[^\"'\s]*/si[m]ple/"
HOMES = r"(?<![\w.])/(home|Users)/[a-z]\w*/|(?<![\w.])/ro[o]t/|[A-Z]:\\+Us[e]rs\\"


def tracked_texts() -> Iterator[tuple[str, str]]:
    """Each text file under version control: its path and what stands in it."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a clone: nobody says which files belong to the repository")
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in filter(None, listed.stdout.decode().split("\0")):
        content = (ROOT / name).read_bytes() if (ROOT / name).is_file() else b"\0"
        if b"\0" not in content:
            yield name, content.decode("utf-8")


def matches(pattern: str) -> list[str]:
    return [
        f"{name}:{number}: {line.strip()}"
        for name, text in tracked_texts()
        for number, line in enumerate(text.splitlines(), 1)
        if re.search(pattern, line)
    ]


def test_no_file_names_the_host_of_a_registry() -> None:
    assert not matches(HOSTS)
    assert not matches(INDEXES)


def test_no_file_names_the_home_of_a_person() -> None:
    assert not matches(HOMES)


@pytest.mark.parametrize(
    ("pattern", "line"),
    [
        (HOSTS, "https://files.python" + "hosted.org/a.whl"),
        (INDEXES, "pip install --extra-" + "index-url x"),
        (HOMES, "/ho" + "me/ann/trocar"),
        (HOMES, "C:\\Us" + "ers\\ann"),
    ],
)
def test_the_patterns_find_what_they_are_for(pattern: str, line: str) -> None:
    assert re.search(pattern, line)


def test_the_version_has_one_home() -> None:
    assert "version" not in PROJECT
    assert PROJECT["dynamic"] == ["version"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", trocar.__version__)


def test_changelog_citation_and_package_name_the_same_newest_release() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    unreleased, newest, *_ = re.findall(r"^## (.+)", changelog, re.MULTILINE)
    assert unreleased == "[Unreleased]"
    found = re.fullmatch(r"\[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)", newest)
    assert found, newest
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (str(citation["version"]), str(citation["date-released"])) == found.groups()
    assert trocar.__version__ == found[1]


def pins() -> dict[str, str]:
    """The version that constraints.txt gives each package."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    found = [Requirement(line) for line in lines if line and not line.startswith("#")]
    for requirement in found:
        assert re.fullmatch(r"==[^*,]+", str(requirement.specifier)), str(requirement)
    return {canonicalize_name(r.name): str(r.specifier)[2:] for r in found}


def test_each_pin_is_a_version_that_is_asked_for() -> None:
    pinned = pins()
    for requirement in (r for extra in EXTRAS for r in licences.requirements(extra)):
        version = pinned[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), str(requirement)


def test_whatever_an_installation_pulls_in_is_pinned() -> None:
    seen = {name for extra in EXTRAS for name in licences.installs(extra)}
    assert {"numpy", "mujoco", "websockets", "pluggy"} <= seen
    assert seen <= set(pins())


def hashed() -> dict[str, tuple[str, int]]:
    """What requirements.txt gives each package: its version, and how many hashes."""
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8").replace("\\\n", " ")
    found: dict[str, tuple[str, int]] = {}
    for line in text.splitlines():
        if line and not line.startswith("#"):
            pinned, *hashes = re.split(r" +--hash=sha256:(?=[0-9a-f]{64}\b)", line.strip())
            requirement = Requirement(pinned)
            name = canonicalize_name(requirement.name)
            assert name not in found, name
            found[name] = (str(requirement.specifier), len(hashes))
    return found


def test_everything_that_make_run_installs_has_hashes_at_its_pinned_version() -> None:
    pinned, wheels = pins(), hashed()
    needed = licences.installs("all") | licences.installs("") | licences.installs("build")
    assert {"numpy", "mujoco", "websockets", "mcap", "pip"} <= needed
    assert needed <= set(wheels)
    assert wheels.keys() >= {"hatchling", "editables", "pathspec"}
    wrong = {name: wheel for name, wheel in wheels.items() if wheel[0] != f"=={pinned[name]}"}
    assert not wrong, "make hashes"
    assert not [name for name, (_, count) in wheels.items() if count == 0]
    # Wheels of Linux, macOS and Windows, for Python 3.11 to 3.13.
    assert min(wheels[name][1] for name in ("numpy", "lxml", "msgspec", "zstandard")) >= 15


def test_make_run_installs_nothing_but_wheels_with_known_hashes() -> None:
    said = subprocess.run(
        ["make", "--dry-run", "--always-make", "PYTHON=python3", "run"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    installs = re.findall(r"-m pip install (.*?)(?:;|$)", said, re.MULTILINE)
    assert len(installs) == 2
    assert "--require-hashes --only-binary :all: --requirement requirements.txt" in installs[0]
    assert "--no-deps --no-build-isolation --editable ." in installs[1]


@pytest.mark.parametrize(("system", "programs"), [("", "bin"), ("Windows_NT", "Scripts")])
def test_make_finds_the_environments_programs_on_every_system(system: str, programs: str) -> None:
    said = subprocess.run(
        ["make", "--dry-run", "--always-make", "PYTHON=python3", f"OS={system}", "test", "run"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert set(re.findall(r"\.venv/(\w+)/python", said)) == {programs}


def test_the_page_on_licences_has_every_pinned_package_as_it_declares_itself() -> None:
    written = licences.written()
    assert set(written) == set(pins())
    installed = [name for name in pins() if version_here(name) == pins()[name]]
    assert len(installed) > 20
    wrong = {
        name: (written[name][0], said)
        for name in installed
        if (said := licences.licence(name)) != written[name][0]
    }
    assert not wrong, "make licences"
    assert not [name for name, (said, _) in written.items() if said in ("", "UNKNOWN")]


def version_here(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def test_a_proprietary_wheel_comes_by_the_extra_judges_alone() -> None:
    written = licences.written()
    proprietary = {name for name, (said, _) in written.items() if "proprietary" in said}
    assert proprietary == {"drake", "mosek"}
    assert {written[name][1] for name in proprietary} == {"judges"}
    for extra in ("all", "test", "dev"):
        assert not licences.installs(extra) & proprietary, extra
        assert "drake" not in {r.name for r in licences.requirements(extra)}, extra


def test_on_linux_for_arm_make_run_builds_what_has_no_wheels(tmp_path: Path) -> None:
    machine = tmp_path / "uname"
    machine.write_text('#!/bin/sh\n[ "$1" = -m ] && echo aarch64 || echo Linux\n')
    machine.chmod(0o755)
    said = subprocess.run(
        ["make", "--dry-run", "--always-make", "PYTHON=python3", "run"],
        cwd=ROOT,
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert re.search(r"requirements\.txt +--no-binary glcontext,moderngl,ruckig;", said)


def test_the_extra_all_holds_every_extra_that_needs_no_compiler_and_no_package_of_the_system() -> (
    None
):
    extras = PROJECT["optional-dependencies"]
    (all_of_them,) = map(Requirement, extras["all"])
    apart = {"all", "cad", "cluster", "judges", "clients", "docs", "test", "browser", "dev"}
    apart |= {"learn", "gpu"}  # gigabytes where PyTorch is made for CUDA
    assert all_of_them.extras == set(extras) - apart
