"""Write docs/scene-list.md: the built-in scenes, from their files."""

from __future__ import annotations

from pathlib import Path

from trocar.descriptions import names
from trocar.descriptions.catalogue import load_scene

PAGE = Path(__file__).parents[2] / "docs" / "scene-list.md"
TEXT = """\
# Every scene

`trocar play SCENE` runs one: see [Scenes](scenes.md).

<!-- Written by make docs. -->

| scene | arms | task | time limit [s] |
|---|---|---|---|"""


def page() -> str:
    """Return the page as Markdown."""
    rows = [TEXT]
    for name in names("scenes"):
        scene = load_scene(name)
        arms = ", ".join(scene.arms)
        rows.append(f"| `{name}` | {arms} | {scene.title} | {scene.time_limit:g} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
