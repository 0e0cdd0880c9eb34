"""A folder with a URDF: what ROS, RViz, pinocchio, Drake, MuJoCo and yourdfpy load."""

from __future__ import annotations

import re
from pathlib import Path

from trocar.apps.exports.meshes import write_meshes
from trocar.apps.exports.ros_package import cmake_lists, package_xml
from trocar.apps.exports.rviz import rviz_config, start_message
from trocar.apps.exports.task import Task, left_out
from trocar.apps.exports.urdf_readme import urdf_readme
from trocar.errors import InputError
from trocar.modeling.mesh_files import seen_materials
from trocar.modeling.urdf import late_leaders, urdf, urdf_tree

#: Names that ROS 1 and ROS 2 both accept. Source: REP 144, "Naming Rules".
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9_]+")


def write_urdf(task: Task) -> tuple[str, ...]:
    """Fill a folder with a rig's URDF.

    Raises:
        InputError: no name for a ROS package
    """
    package, name = task.options.package, file_name(task.model.name)
    if package and not PACKAGE_NAME.fullmatch(package):
        raise InputError(
            f"--package: got {package!r}; allowed: a lower-case letter, then lower-case letters,"
            " digits and underscores (REP 144)"
        )
    prefix = f"package://{package}/meshes" if package else "meshes"
    places = {mesh: f"{prefix}/{stem}.obj" for mesh, stem in task.meshes.items()}
    write_meshes(task.meshes, task.folder / "meshes", seen_materials(task.model))
    _write(task.folder / f"{name}.urdf", urdf(task.model, places))
    _write(task.folder / f"{name}_drake.urdf", urdf(task.model, places, friction=False))
    _write(task.folder / "rviz" / "trocar.rviz", rviz_config(task.model, 1).encode())
    _write(task.folder / "rviz" / "trocar_ros2.rviz", rviz_config(task.model, 2).encode())
    _write(task.folder / "rviz" / "start.yaml", start_message(task.model).encode())
    if package:
        _write(task.folder / "package.xml", package_xml(package, task.model.title).encode())
        _write(task.folder / "CMakeLists.txt", cmake_lists(package).encode())
    warnings = _warnings(task)
    _write(task.folder / "README.md", urdf_readme(task, name, warnings).encode())
    return warnings


def file_name(name: str) -> str:
    """Return what a rig's file is called: its name with nothing that a shell would trip over."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_") or "robot"


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)


def _warnings(task: Task) -> tuple[str, ...]:
    found = list(left_out(task.rig))
    found += [
        f"{arm}: its loops are no parallelograms; the passive joints mimic straight lines, and the"
        f" worst frame stands up to {1e3 * off:.3f} mm from where it belongs"
        for arm, off in task.model.line_errors.items()
    ]
    found += [
        f"{follower} mimics {leader}, which sorting by name brings later: pinocchio refuses that"
        for follower, leader in late_leaders(urdf_tree(task.model))
    ]
    return tuple(found)
