"""Write docs/learning-scenes.md: where each built-in scene can run, from the scenes' files."""

from __future__ import annotations

from pathlib import Path

from trocar.descriptions import names
from trocar.descriptions.catalogue import load_scene
from trocar.learning.scene_support import scene_support

PAGE = Path(__file__).parents[2] / "docs" / "learning-scenes.md"
TEXT = """\
# Where each scene runs

Every scene runs in one world (`Task`, `trocar play`). `SceneBatch` and `WarpScene`
([scenes on a GPU](learning-gpu.md)) have the rules of most tasks in arrays of worlds. An
[MJX file](learning-gpu.md#mjx) has the bodies, joints, contacts and servos, not the task; MuJoCo
compiles it, and it was not loaded into MJX.

<!-- Written by make docs. -->

| scene | batch on CPU threads | MuJoCo Warp | MJX file |
|---|---|---|---|"""


def page() -> str:
    """Return the page as Markdown."""
    rows = [TEXT]
    for name in names("scenes"):
        found = scene_support(load_scene(name))
        cells = [
            f"no: {reason.partition(';')[0]}" if reason else "yes"
            for reason in (found.batch, found.warp)
        ]
        mjx = f"no: {found.mjx}" if found.mjx else "not tried"
        rows.append(f"| `{name}` | {' | '.join(cells)} | {mjx} |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
