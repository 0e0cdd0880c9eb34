"""A scene of one's own: one TOML file and one class, as docs/how-to/add-a-scene.md has it."""

from pathlib import Path

import pytest

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "add-a-scene.md"


def block(language: str) -> str:
    """Return the first block of a language in the how-to."""
    return HOW_TO.read_text(encoding="utf-8").split(f"```{language}\n")[1].split("```")[0]


@pytest.fixture
def touch(tmp_path: Path) -> Path:
    """Return the path of the how-to's scene."""
    (tmp_path / "touch.py").write_text(block("python"), encoding="utf-8")
    path = tmp_path / "touch.toml"
    path.write_text(block("toml"), encoding="utf-8")
    return path
