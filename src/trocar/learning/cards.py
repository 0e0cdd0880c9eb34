"""Cards of datasets: card.toml for programs, README.md for people and dataset pages."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from trocar.descriptions.table import toml_text
from trocar.errors import LogError
from trocar.learning.lerobot import Feature
from trocar.recording.metadata import versions

#: Version of the keys of card.toml.
FORMAT = 1
#: Seeds or files that README.md lists; card.toml has all. Source: our own choice.
LISTED = 20
#: Head of README.md, by which dataset pages list and preview the data. Source: LeRobot's template.
HEAD = """---
task_categories:
- robotics
tags:
- LeRobot
- dVRK
- {tag}
configs:
- config_name: default
  data_files: data/*/*.parquet
---
"""


def scene_of_card(folder: Path) -> str:
    """Return the scene of a dataset by its card; "" without a card, or of recordings.

    Raises:
        LogError: a torn card
    """
    path = folder / "card.toml"
    if not path.is_file():
        return ""
    try:
        card = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as problem:
        raise LogError(str(path), f"is torn or no card: {problem}") from problem
    return str(card.get("scene", ""))


def write_card(
    folder: Path,
    title: str,
    about: Mapping[str, Any],
    features: Mapping[str, Feature],
    *,
    simulated: bool,
) -> None:
    """Write card.toml and README.md.

    Args:
        folder: of the dataset
        title: of README.md
        about: entries of the card; texts, numbers, lists and tables of these
        features: columns of the dataset
        simulated: whether the data are of a simulation
    """
    made = versions()
    card = {
        "format": FORMAT,
        **about,
        "versions": {key: made[key] for key in ("trocar", "mujoco", "numpy")},
    }
    (folder / "card.toml").write_text(toml_text(card), encoding="utf-8", newline="\n")
    rows = [
        f"| {key.replace('_', ' ')} | {_shown(value)} |"
        for key, value in card.items()
        if key != "format" and value not in ("", [], {})
    ]
    columns = [
        f"| `{name}` | {len(one.names)} | {one.dtype} | {one.frame or '-'} |"
        f" {', '.join(one.names[:7])}{', ...' if len(one.names) > 7 else ''} |"
        for name, one in features.items()
    ]
    text = "\n".join(
        [
            HEAD.format(tag="simulation" if simulated else "recording"),
            f"# {title}",
            "",
            "| | |",
            "|---|---|",
            *rows,
            "",
            "`card.toml` has the same for programs. Positions are in metres, angles in radians,"
            " quaternions w first; columns that begin with `next.` are those after the period."
            " Columns without a frame and `observation.state` are explained in trocar's"
            " documentation.",
            "",
            "| column | numbers | type | frame | names |",
            "|---|---|---|---|---|",
            *columns,
            "",
        ]
    )
    (folder / "README.md").write_text(text, encoding="utf-8", newline="\n")


def _shown(value: Any) -> str:
    """Return a value of the card for a cell of a table."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {one}" for k, one in cast(Mapping[str, Any], value).items())
    if isinstance(value, list):
        entries = cast(list[Any], value)
        more = f", ... ({len(entries)})" if len(entries) > LISTED else ""
        return ", ".join(str(one) for one in entries[:LISTED]) + more
    return f"{value:.4g}" if isinstance(value, float) else str(value)
