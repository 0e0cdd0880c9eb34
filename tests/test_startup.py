"""Nothing heavy is loaded before it is needed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

SRC = Path(__file__).parents[1] / "src"
HEAVY = {"mujoco", "viser", "scipy", "ruckig", "numpy"}

IMPORT = "import trocar, sys; print(*sys.modules)"
HELP = """
import sys
from trocar.cli import main
sys.argv = ["trocar", "--help"]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
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
    loaded = loaded_by(HELP)
    assert "trocar.cli" in loaded
    assert not loaded & HEAVY


def test_a_heavy_library_would_be_seen() -> None:
    assert loaded_by("import numpy, sys; print(*sys.modules)") & HEAVY == {"numpy"}
