"""The README of an exported folder: what every format says, around what each one adds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from trocar import __version__
from trocar.apps.exports.task import Task


def readme(task: Task, format: str, sections: Mapping[str, str]) -> str:  # noqa: A002
    """Return a README in Markdown.

    Args:
        task: what was exported
        format: "urdf", ...
        sections: {heading: text} of the format, in their order
    """
    model = task.model
    parts = [
        f"# {model.title}",
        f"Written by `trocar export {model.name} --format {format}` (trocar {__version__}) from the"
        " description of the robot; edit that, not this. SI units and radians; joint names, signs"
        " and zeros are those of the da Vinci Research Kit.",
        _arms(task),
        f"{len(model.links)} links, {len(model.joints)} joints,"
        f" {sum(link.mass for link in model.links):.4f} kg.",
    ]
    parts += [f"## {heading}\n\n{text.strip()}" for heading, text in sections.items()]
    parts.append(
        "## Licence\n\nBSD-3-Clause, (c) the trocar authors. Not a product of Intuitive Surgical,"
        " and not for use on patients."
    )
    return "\n\n".join(parts) + "\n"


def _arms(task: Task) -> str:
    rows = ["| arm | description | instrument | geometry |", "|---|---|---|---|"]
    for place in task.rig.arms:
        overlay = place.arm.overlay
        geometry = "as drawn" if overlay is None else f"calibrated: {Path(overlay.file).name}"
        rows.append(f"| {place.name} | {place.arm.name} | {place.arm.tool or '-'} | {geometry} |")
    return "\n".join(rows)
