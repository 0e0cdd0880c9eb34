"""Nothing heavy is loaded before it is needed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import trocar

SRC = Path(__file__).parents[1] / "src"
HEAVY = {"mujoco", "viser", "scipy", "ruckig", "numpy", "rich"}

IMPORT = "import trocar, sys; print(*sys.modules)"
COMMAND = """
import sys
from trocar.cli import main
sys.argv = ["trocar", "{}"]
try:
    end = main()
except SystemExit as status:
    end = status.code
assert not end, end
print(*sys.modules)
"""


def loaded_by(code: str) -> set[str]:
    """Names of the modules that a fresh Python holds after running some code."""
    result = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(SRC)},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return set(result.stdout.splitlines()[-1].split())


def test_importing_trocar_loads_no_other_library() -> None:
    loaded = loaded_by(IMPORT)
    assert "trocar" in loaded
    assert not loaded & HEAVY


def test_help_is_printed_before_any_heavy_library_is_loaded() -> None:
    loaded = loaded_by(COMMAND.format("--help"))
    assert "trocar.cli" in loaded
    assert not loaded & HEAVY


def test_the_catalogue_is_listed_without_physics_or_yaml() -> None:
    loaded = loaded_by(COMMAND.format("list"))
    assert "trocar.descriptions.cameras" in loaded
    assert not loaded & {"mujoco", "viser", "ruckig", "yaml"}


def test_a_heavy_library_would_be_seen() -> None:
    assert loaded_by("import numpy, sys; print(*sys.modules)") & HEAVY == {"numpy"}


def test_the_front_door_has_what_it_says_and_opens_on_first_use() -> None:
    code = "import trocar, sys; print({n: hasattr(trocar, n) for n in trocar.__all__})"
    assert not loaded_by("import trocar, sys; dir(trocar); print(*sys.modules)") & HEAVY
    result = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(SRC)},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert result.stdout.strip() == str(dict.fromkeys(trocar.__all__, True))
