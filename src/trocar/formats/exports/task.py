"""The task of an export, and what all formats share: meshes and READMEs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from trocar import __version__
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import RigDescription
from trocar.formats.links import LinkModel
from trocar.formats.mesh_files import mesh_files

TEMPLATES = Path(__file__).with_name("templates")


@dataclass(frozen=True)
class ExportOptions:
    """Options that only some formats take.

    Attributes:
        package: URDF: name of the ROS package that the folder becomes; "" for relative paths
        fit_tip: URDF: fit the chain of a calibrated arm to its tip
        sdf_version: SDF: "1.9", "1.7" or "1.11"
    """

    package: str = ""
    fit_tip: bool = False
    sdf_version: str = "1.9"


@dataclass(frozen=True, eq=False)
class ExportTask:
    """A rig and the folder that a format writes it into.

    Attributes:
        model: the rig as links and joints
        rig: the rig
        folder: an empty folder, that of the export once all is written
        meshes: {mesh: its name in files, without folder and ending}, each different from the others
        options: of the export
    """

    model: LinkModel
    rig: RigDescription
    folder: Path
    meshes: Mapping[Mesh, str]
    options: ExportOptions


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        title: for people
        write: fills the task's folder and returns warnings
        takes: names of the `ExportOptions` that it uses
    """

    title: str
    write: Callable[[ExportTask], tuple[str, ...]]
    takes: tuple[str, ...] = ()


def left_out(rig: RigDescription) -> tuple[str, ...]:
    """Return what a file of one robot, all of whose links hang together, does not have."""
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
    """Return which Python files of a rig act in this program only."""
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
        folder: where; is made when there is a mesh
        materials: as `mesh_files` takes them
    """
    for name, content in mesh_files(meshes, materials).items():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def filled(template: str, **values: object) -> str:
    """Return a text of `templates` with each {{name}} replaced by its value."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda match: str(values[match[1]]), text)


def readme(task: ExportTask, format: str, body: str) -> str:  # noqa: A002 - what the option is called
    """Return a README in Markdown: what all formats say around the sections of one."""
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
