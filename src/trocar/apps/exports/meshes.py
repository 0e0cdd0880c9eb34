"""The meshes of an export, written into its folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from trocar.descriptions.meshes import Mesh
from trocar.modeling.mesh_files import mesh_files


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
