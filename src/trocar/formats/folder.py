"""The folder of an export: its task, meshes, and the README that all formats share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar import __version__
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import RigDescription
from trocar.formats.links import LinkModel
from trocar.formats.meshes import mesh_files

TEMPLATES = Path(__file__).with_name("templates")


@dataclass(frozen=True, eq=False)
class ExportTask:
    """A rig and the folder that a format writes it into.

    Attributes:
        model: the rig as links and joints
        rig: the rig
        folder: an empty folder, that of the export once all is written
        meshes: {mesh: its name in files, without folder and ending}; equal meshes share theirs
        draw: writes a picture of a rig as PNG; None: the caller cannot draw
    """

    model: LinkModel
    rig: RigDescription
    folder: Path
    meshes: Mapping[Mesh, str]
    draw: Callable[[RigDescription, Path], None] | None = None


def left_out(rig: RigDescription) -> tuple[str, ...]:
    """Return the parts of a rig that a file of one tree of links omits, a sentence each."""
    found: list[str] = []
    if names := ", ".join(prop.name for prop in rig.objects):
        found.append(f"what can be moved is not in the file: {names} (mjcf has it)")
    if names := ", ".join(band.name for band in rig.bands):
        found.append(f"elastic bands are not in the file: {names} (mjcf has them)")
    soft = [p.name for p in rig.props if p.movable is None and any(s.stiffness for s in p.shapes)]
    if soft:
        found.append(f"soft shapes are rigid in the file: {', '.join(soft)} (mjcf has them soft)")
    return (*found, *scripts_left_out(rig))


def scripts_left_out(rig: RigDescription) -> tuple[str, ...]:
    """Return the Python files of a rig that act in this program only, a sentence each."""
    found = [
        f"the script of {prop.name} is not in the file: {Path(prop.script).name}"
        for prop in rig.objects
        if prop.script
    ]
    if rig.extension:
        found.append(f"what {Path(rig.extension).name} adds to the model is in mjcf only")
    return tuple(found)


def write_meshes(
    meshes: Mapping[Mesh, str], folder: Path, materials: Mapping[Mesh, str] | None = None
) -> None:
    """Write each mesh as NAME.obj, in metres.

    Args:
        meshes: {mesh: its name}
        folder: target folder, made if there is a mesh
        materials: those of `mesh_files`
    """
    for name, content in mesh_files(meshes, materials).items():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def filled(template: str, **values: object) -> str:
    """Return a text of `templates` with each {{name}} replaced by its value."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda match: str(values[match[1]]), text)


def readme(task: ExportTask, format: str, body: str) -> str:  # noqa: A002 - what the option is called
    """Return a README in Markdown: the sections of one format between those of all."""
    model = task.model
    rows: list[Sequence[str]] = []
    for place in task.rig.arms:
        overlay = place.arm.overlay
        geometry = "as drawn" if overlay is None else f"calibrated: {Path(overlay.file).name}"
        rows.append((place.name, place.arm.name, place.arm.tool or "-", geometry))
    return filled(
        "readme.md",
        title=model.title,
        name=model.name,
        format=format,
        version=__version__,
        arms=markdown_table(("arm", "description", "instrument", "geometry"), rows),
        links=len(model.links),
        joints=len(model.joints),
        mass=f"{sum(link.mass for link in model.links):.4f}",
        body=body.strip(),
    )


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
