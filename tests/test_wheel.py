"""The wheel holds all that trocar needs, and works from any folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

import trocar

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "trocar"
SCRIPTS = "Scripts" if os.name == "nt" else "bin"

pytestmark = pytest.mark.slow
needs_simulation = pytest.mark.skipif(
    not (PACKAGE / "cli" / "sim.py").exists(), reason="there is no trocar sim yet"
)


def run(*command: str | Path, cwd: Path) -> str:
    """Run a command with nothing of this checkout in its environment; return what it prints."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    result = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env=kept,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert result.returncode == 0, f"{command}\n{result.stdout}\n{result.stderr}"
    return result.stdout


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Skip where pip can get nothing, not even the one package that builds the wheel."""
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "hatchling"]
    folder = str(tmp_path_factory.mktemp("index"))
    if subprocess.run([*pip, "--dest", folder], capture_output=True, check=False).returncode:
        pytest.skip("pip reaches no package index to build and install from")


@pytest.fixture(scope="module")
def wheel(index: None, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: ARG001
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder]
    run(*pip, "--build-constraint", ROOT / "constraints.txt", ROOT, cwd=folder)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def scripts(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of commands of an environment that holds the wheel and what it asks for."""
    home = tmp_path_factory.mktemp("clean") / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", home, cwd=home.parent)
    scripts = home / SCRIPTS
    pip = [sys.executable, "-m", "pip", "--python", scripts / "python", "install", "--quiet"]
    run(*pip, "--constraint", ROOT / "constraints.txt", wheel, cwd=home.parent)
    return scripts


def test_the_wheel_holds_every_file_of_the_package(wheel: Path) -> None:
    ours = {
        path.relative_to(PACKAGE.parent).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    packed = set(zipfile.ZipFile(wheel).namelist())
    assert ours <= packed
    assert any(name.endswith("licenses/LICENSE") for name in packed)


def test_the_wheel_is_of_this_version_and_fits_every_machine(wheel: Path) -> None:
    assert wheel.name == f"trocar-{trocar.__version__}-py3-none-any.whl"


def test_the_wheel_alone_is_imported(scripts: Path, tmp_path: Path) -> None:
    told = run(scripts / "python", "-c", "import trocar; print(trocar.__file__)", cwd=tmp_path)
    assert Path(told.strip()).is_relative_to(scripts.parent)


def trocar_json(scripts: Path, folder: Path, *arguments: str) -> dict[str, Any]:
    return json.loads(run(scripts / "trocar", *arguments, "--json", cwd=folder))


@needs_simulation
def test_the_installed_cart_moves(scripts: Path, tmp_path: Path) -> None:
    told = trocar_json(scripts, tmp_path, "sim", "--headless", "--duration", "1")
    assert told["rig"] == "full_cart"
    assert told["simulated_s"] == pytest.approx(1.0)
    assert told["branch_ok"] is True


def test_the_installed_arm_knows_where_its_tip_is(scripts: Path, tmp_path: Path) -> None:
    told = trocar_json(scripts, tmp_path, "fk", "psm", "0", "0", "0.1", "0", "0", "0")
    assert told["arm"] == "psm"
    # Shaft along the axis of the remote centre: insertion 0.1 - 0.4318 + 0.4162 of the Large
    # Needle Driver 400006, then 0.0091 from wrist pitch to wrist yaw, both straight ahead.
    # Source: the dVRK's PSM.json and tool file.
    depth = sum(row[3] ** 2 for row in told["pose"][:3]) ** 0.5
    assert depth == pytest.approx(0.1 - 0.4318 + 0.4162 + 0.0091, abs=1e-9)
