"""The example on images of another renderer: the needle is found and followed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
pytest.importorskip("cv2", reason="needs the extra vision")


@pytest.mark.slow
def test_a_needle_in_images_of_mujocos_renderer_is_followed() -> None:
    result = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "vision" / "foreign_images.py")],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    if result.returncode and re.search("EGL|OpenGL|gl", result.stderr.splitlines()[-1]):
        pytest.skip("MuJoCo's renderer needs OpenGL by EGL")
    assert result.returncode == 0, result.stderr
    rows = [line.split() for line in result.stdout.splitlines()]
    assert len(rows) == 11 and all(row[1] == "tracking" for row in rows[-8:])
    # A pixel is 0.11 mm; 12 times that in depth, to a twentieth of a pixel.
    assert max(float(row[2]) for row in rows[-8:]) < 0.8
