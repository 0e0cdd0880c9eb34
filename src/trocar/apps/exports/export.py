"""Write a rig in another simulator's format, into a folder that needs nothing else."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from trocar.apps.exports.formats import FORMATS
from trocar.apps.exports.task import Options, Task
from trocar.apps.folders import check_folder, whole_folder
from trocar.descriptions.records import RigDescription
from trocar.errors import InputError, UnknownNameError
from trocar.modeling.links import LinkModel, rig_links
from trocar.modeling.markup import lxml_etree
from trocar.modeling.mesh_files import mesh_names


@dataclass(frozen=True)
class Export:
    """What was written.

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
    options: Options | None = None,
    *,
    force: bool = False,
) -> Export:
    """Write a rig in a format.

    Args:
        rig: what
        format: one of `FORMATS`
        folder: where; a new folder, or an empty one
        options: what only some formats ask for
        force: replace what the folder has under the same names

    Raises:
        UnknownNameError: no such format
        InputError: the folder cannot be used, an option is for another format, or an arm has no
            masses; nothing was written
        MissingExtraError: lxml is not installed
    """
    if format not in FORMATS:
        raise UnknownNameError("format", format, FORMATS)
    _check_options(format, options or Options())
    check_folder(Path(folder).expanduser(), force)
    lxml_etree()
    model = rig_links(rig)
    with whole_folder(Path(folder), force) as built:
        task = Task(model, rig, built, mesh_names(model), options or Options())
        warnings = FORMATS[format].write(task)
        files = sorted(p.relative_to(built).as_posix() for p in built.rglob("*") if p.is_file())
    return Export(
        folder=Path(folder),
        format=format,
        files=tuple(files),
        links=len(model.links),
        joints=len(model.joints),
        triangles=_triangles(model),
        warnings=warnings,
    )


def _check_options(format: str, options: Options) -> None:  # noqa: A002 - as above
    """Refuse what the format would pass over in silence."""
    for name, value in asdict(options).items():
        if value != getattr(Options(), name) and name not in FORMATS[format].takes:
            takers = [known for known, one in FORMATS.items() if name in one.takes]
            raise InputError(
                f"--{name.replace('_', '-')}: got {value!r} with --format {format}; allowed: with"
                f" --format {' or '.join(takers)}"
            )


def _triangles(model: LinkModel) -> int:
    shapes = [s for link in model.links for s in link.shapes if s.visible]
    return sum(len(s.mesh.faces) for s in shapes if s.mesh is not None)
