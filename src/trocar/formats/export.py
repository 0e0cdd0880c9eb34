"""Write a rig in another simulator's format, into a folder that needs nothing else."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from trocar.descriptions import RigDescription, load_arm, load_rig, names, rig_with_tool
from trocar.descriptions.calibrated import calibrated_rig
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError, UnknownNameError
from trocar.formats.folder import ExportTask
from trocar.formats.format import formats
from trocar.formats.links import rig_links
from trocar.formats.meshes import mesh_names
from trocar.formats.xml_tree import lxml_etree
from trocar.outputs import check_folder, whole_folder


@dataclass(frozen=True)
class Export:
    """A written folder.

    Attributes:
        folder: its path
        format: "urdf", ...
        files: every file, relative to the folder, sorted
        links, joints: their numbers, fixed joints included
        triangles: their number in visible meshes, each link's counted
        warnings: parts of the rig that the files omit or change
    """

    folder: Path
    format: str
    files: tuple[str, ...]
    links: int
    joints: int
    triangles: int
    warnings: tuple[str, ...]


def export(
    rig: RigDescription,
    format: str,  # noqa: A002 - what the option is called
    folder: str | Path,
    options: Mapping[str, object] | None = None,
    *,
    draw: Callable[[RigDescription, Path], None] | None = None,
    overwrite: bool = False,
) -> Export:
    """Write a rig in a format.

    Args:
        rig: its description
        format: one of `formats()` that is written
        folder: a new folder, or an empty one
        options: options of the format by name: {"sdf_version": "1.11"}
        draw: writes a picture of a rig as PNG, for formats whose folder has one; it may raise a
            `TrocarError`; None: no picture
        overwrite: replace files of the same names

    Raises:
        UnknownNameError: no such format
        InputError: the folder cannot be used, an option is for another format, or an arm has no
            masses; nothing was written
        MissingExtraError: lxml is not installed
    """
    known = {name: one for name, one in formats().items() if one.write is not None}
    if format not in known or (write := known[format].write) is None:
        raise UnknownNameError("format", format, known)
    chosen = dict(options or {})
    for name, value in chosen.items():
        takers = [known_as for known_as, one in known.items() if name in one.option_names]
        if not takers:
            every = [option for one in known.values() for option in one.option_names]
            raise UnknownNameError("option", name, every)
        if format not in takers:
            raise InputError(
                f"--{name.replace('_', '-')}: got {value!r} with --format {format}; allowed: with"
                f" --format {' or '.join(takers)}"
            )
    check_folder(folder, overwrite)
    lxml_etree()
    model = rig_links(rig)
    with whole_folder(folder, overwrite) as built:
        task = ExportTask(model, rig, built, mesh_names(model), draw)
        warnings = write(task, **chosen)
        files = sorted(p.relative_to(built).as_posix() for p in built.rglob("*") if p.is_file())
    return Export(
        folder=Path(folder),
        format=format,
        files=tuple(files),
        links=len(model.links),
        joints=len(model.joints),
        triangles=sum(
            len(shape.mesh.faces)
            for link in model.links
            for shape in link.shapes
            if shape.visible and shape.mesh is not None
        ),
        warnings=warnings,
    )


def find_rig(
    name: str | Path, tools: Sequence[str] = (), calibrations: Sequence[str] = ()
) -> RigDescription:
    """Return the rig of a name: an arm alone and without props, or a rig.

    Args:
        name: a built-in arm or rig, or the path of a TOML file; a name of both is the arm
        tools: "TOOL" for a lone arm, or "ARM=TOOL" for an arm of a rig
        calibrations: overlays as for `load_rig`: "FILE", or "ARM=FILE"

    Raises:
        UnknownNameError: no such arm, rig or tool
        InputError, DescriptionError: a file is broken, or fits none of the arms
    """
    if _is_arm(name):
        arm = load_arm(name)
        rig = replace(lone_arm_rig(arm), name=arm.name)
    else:
        rig = load_rig(name)
    lone = rig.arms[0].name if len(rig.arms) == 1 else ""
    for request in tools:
        to, given, tool = request.rpartition("=")
        if not tool or (given and not to) or not (to or lone):
            allowed = f"ARM=TOOL, ARM one of {', '.join(a.name for a in rig.arms)}"
            raise InputError(f"--tool: got {request!r}; allowed: {allowed}")
        rig = rig_with_tool(rig, to or lone, tool)
    return calibrated_rig(rig, list(calibrations) or None)


def _is_arm(name: str | Path) -> bool:
    text = str(name)
    if not text.endswith(".toml"):
        if text not in (*names("arms"), *names("rigs")):
            known = sorted({*names("arms"), *names("rigs")})
            raise UnknownNameError("arm or rig", text, known)
        return text in names("arms")
    try:
        with Path(name).expanduser().open("rb") as file:
            return "arm" not in tomllib.load(file)
    except (OSError, ValueError):
        return True  # load_arm reports the problem
