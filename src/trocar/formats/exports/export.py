"""Write a rig in another simulator's format, into a folder that needs nothing else."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from trocar.descriptions import RigDescription, load_arm, load_rig, names, rig_with_tool
from trocar.descriptions.calibrated import calibrated_rig
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError, UnknownNameError
from trocar.formats.exports.mjcf import write_mjcf
from trocar.formats.exports.sdf import write_sdf
from trocar.formats.exports.task import ExportOptions, ExportTask, Format
from trocar.formats.exports.urdf import write_urdf
from trocar.formats.links import rig_links
from trocar.formats.markup import lxml_etree
from trocar.formats.mesh_files import mesh_names
from trocar.outputs import check_folder, whole_folder

#: {name after --format: the format}
FORMATS: dict[str, Format] = {
    "mjcf": Format("MJCF: MuJoCo, as MuJoCo Menagerie has robots", write_mjcf),
    "urdf": Format(
        "URDF: ROS, RViz, pinocchio, Drake, MuJoCo, yourdfpy", write_urdf, ("package", "fit_tip")
    ),
    "sdf": Format("SDF: Gazebo, Drake", write_sdf, ("sdf_version",)),
}


@dataclass(frozen=True)
class Export:
    """A written folder.

    Attributes:
        folder: where
        format: "urdf", ...
        files: every file, relative to the folder, sorted
        links, joints: how many the rig has, fixed joints included
        triangles: of the meshes that are seen, each link's counted
        warnings: what the user should know of this file
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
    options: ExportOptions | None = None,
    *,
    overwrite: bool = False,
) -> Export:
    """Write a rig in a format.

    Args:
        rig: what
        format: one of `FORMATS`
        folder: where; a new folder, or an empty one
        options: see `ExportOptions`
        overwrite: replace what the folder has under the same names

    Raises:
        UnknownNameError: no such format
        InputError: the folder cannot be used, an option is for another format, or an arm has no
            masses; nothing was written
        MissingExtraError: lxml is not installed
    """
    if format not in FORMATS:
        raise UnknownNameError("format", format, FORMATS)
    chosen = options or ExportOptions()
    for name, value in asdict(chosen).items():
        if value != getattr(ExportOptions(), name) and name not in FORMATS[format].takes:
            takers = [known for known, one in FORMATS.items() if name in one.takes]
            raise InputError(
                f"--{name.replace('_', '-')}: got {value!r} with --format {format}; allowed: with"
                f" --format {' or '.join(takers)}"
            )
    check_folder(folder, overwrite)
    lxml_etree()
    model = rig_links(rig)
    with whole_folder(folder, overwrite) as built:
        task = ExportTask(model, rig, built, mesh_names(model), chosen)
        warnings = FORMATS[format].write(task)
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
    """Return the rig that a name stands for: an arm alone and without props, or a rig.

    Args:
        name: a built-in arm or rig, or the path of a TOML file; a name of both is the arm
        tools: "TOOL" of a lone arm, or "ARM=TOOL" of an arm in a rig
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
        return True  # load_arm says what is wrong with it
