"""What a format is asked to write, and what it promises."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import RigDescription
from trocar.modeling.links import LinkModel


@dataclass(frozen=True)
class Options:
    """What only some formats ask for.

    Attributes:
        package: URDF: name of the ROS package that the folder becomes; "" for relative paths
        sdf_version: SDF: "1.9", "1.7" or "1.11"
    """

    package: str = ""
    sdf_version: str = "1.9"


@dataclass(frozen=True, eq=False)
class Task:
    """What a format is asked to write.

    Attributes:
        model: the rig as links and joints
        rig: the rig
        folder: an empty folder, that of the export once all is written
        meshes: {mesh: its name in files, without folder and ending}, each different from the others
        options: what the user wants of this format
    """

    model: LinkModel
    rig: RigDescription
    folder: Path
    meshes: Mapping[Mesh, str]
    options: Options


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        title: for people
        write: fills the task's folder and returns warnings: what the user should know
        takes: names of the `Options` that it looks at
    """

    title: str
    write: Callable[[Task], tuple[str, ...]]
    takes: tuple[str, ...] = ()


def left_out(rig: RigDescription) -> tuple[str, ...]:
    """Return what a file of one robot, all of whose links hang together, does not have."""
    names = ", ".join(prop.name for prop in rig.objects)
    return (f"what can be moved is not in the file: {names} (mjcf has it)",) if names else ()
