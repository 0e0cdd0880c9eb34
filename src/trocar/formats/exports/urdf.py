"""A folder with a URDF: what ROS, RViz, pinocchio, Drake, MuJoCo and yourdfpy load."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from trocar import __version__
from trocar.errors import InputError
from trocar.formats.exports.task import (
    ExportTask,
    filled,
    left_out,
    markdown_table,
    readme,
    write_meshes,
)
from trocar.formats.links import LinkModel, link_poses
from trocar.formats.mesh_files import seen_materials
from trocar.formats.tip_chain import fit_tips
from trocar.formats.urdf import late_leaders, urdf, urdf_tree

#: Names that ROS 1 and ROS 2 both accept. Source: REP 144, "Naming Rules".
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9_]+")

#: The camera's distance over the largest extent of the links' origins. Source: chosen by eye.
DISTANCE = 1.7
DESCRIPTION_TOPIC = """Description Source: Topic
      Description Topic:
        Durability Policy: Transient Local
        Reliability Policy: Reliable
        Value: /robot_description"""

PACKAGE_FILES = """
| `package.xml`, `CMakeLists.txt` | a ROS package, for ROS 1 (catkin) and ROS 2 (ament) |"""


def write_urdf(task: ExportTask) -> tuple[str, ...]:
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
    if task.options.fit_tip:
        task = replace(task, model=fit_tips(task.model, task.rig))
    prefix = f"package://{package}/meshes" if package else "meshes"
    places = {mesh: f"{prefix}/{stem}.obj" for mesh, stem in task.meshes.items()}
    write_meshes(task.meshes, task.folder / "meshes", seen_materials(task.model))
    _write(task.folder / f"{name}.urdf", urdf(task.model, places))
    _write(task.folder / f"{name}_drake.urdf", urdf(task.model, places, friction=False))
    _write(task.folder / "rviz" / "trocar.rviz", rviz_config(task.model, 1).encode())
    _write(task.folder / "rviz" / "trocar_ros2.rviz", rviz_config(task.model, 2).encode())
    _write(task.folder / "rviz" / "start.yaml", start_message(task.model).encode())
    if package:
        # Source: REP 149 (format 3), and the documentation of catkin and ament_cmake.
        title = escape(task.model.title)
        manifest = filled("package.xml", package=package, version=__version__, title=title)
        _write(task.folder / "package.xml", manifest.encode())
        _write(task.folder / "CMakeLists.txt", filled("CMakeLists.txt", package=package).encode())
    warnings = _warnings(task)
    _write(task.folder / "README.md", _readme(task, name, warnings).encode())
    return warnings


def file_name(name: str) -> str:
    """Return what a rig's file is called: its name with nothing that a shell would trip over."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_") or "robot"


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)


def _warnings(task: ExportTask) -> tuple[str, ...]:
    found = list(left_out(task.rig))
    fitted = task.options.fit_tip
    how = "helper joints fit the chain to the tip" if fitted else "passive joints mimic linearly"
    found += [
        f"{arm}: its loops are not parallelograms, and no tree moves as they do: {how}; off by up"
        f" to {1e3 * error.tip:.3f} mm and {1e3 * error.tip_angle:.2f} mrad at the tip,"
        f" {1e3 * error.worst:.3f} mm at {error.frame}"
        + ("" if fitted else " (--fit-tip fits the chain to the tip)")
        for arm, error in task.model.line_errors.items()
    ]
    if fitted and not task.model.line_errors:
        found.append("--fit-tip: nothing to fit, for all loops are parallelograms")
    found += [
        f"{follower} mimics {leader}, later in alphabetical order: pinocchio rejects this"
        for follower, leader in late_leaders(urdf_tree(task.model))
    ]
    return tuple(found)


def _readme(task: ExportTask, name: str, warnings: tuple[str, ...]) -> str:
    package = task.options.package
    joints = [
        (joint.arm, joint.hinge.joint.name, f"`{joint.name}`", f"{joint.hinge.weight:g}")
        for joint in task.model.joints
        if joint.hinge is not None and joint.hinge.joint is not None
    ]
    body = filled(
        "urdf.md",
        name=name,
        package_files=PACKAGE_FILES if package else "",
        package_dirs="[Path.cwd().parent]" if package else '["."]',
        drake=f'parser.package_map().Add("{package}", ".")\n' if package else "",
        rviz=filled("rviz.md", name=name).strip()
        if package
        else "RViz finds meshes in ROS packages only: export with `--package NAME`.",
        joints=markdown_table(("arm", "joint", "is the URDF's", "times"), joints),
        warnings="".join(f"\n- {text}" for text in warnings)
        and "\n## Warnings\n" + "".join(f"\n- {text}" for text in warnings),
    )
    return readme(task, "urdf", body)


def rviz_config(model: LinkModel, ros: int) -> str:
    """Return a view of a rig for RViz.

    Source: what RViz 1.14 (ROS 1) saves, pared down; rviz_default_plugins for the names in ROS 2.

    Args:
        ros: 1 or 2, whose classes have different names
    """
    places = link_poses(model, model.start)
    at = np.array([places[link.name][:3, 3] for link in model.links if link.arm])
    low, high = at.min(axis=0), at.max(axis=0)
    x, y, z = 0.5 * (low + high)
    plugin = "rviz" if ros == 1 else "rviz_default_plugins"
    source = "Robot Description: robot_description" if ros == 1 else DESCRIPTION_TOPIC
    return filled(
        "view.rviz",
        panel="rviz" if ros == 1 else "rviz_common",
        plugin=plugin,
        source=source,
        floor=f"{min(pose[2, 3] for pose in places.values()):.4g}",
        x=f"{x:.4g}",
        y=f"{y:.4g}",
        z=f"{z:.4g}",
        distance=f"{DISTANCE * float((high - low).max()) + 0.3:.4g}",
    )


def start_message(model: LinkModel) -> str:
    """Return a sensor_msgs/JointState of the pose "start", in YAML."""
    tree = urdf_tree(model)
    own = [joint.name for joint in tree.joints if joint.kind != "fixed" and not joint.follows]
    values = ", ".join(f"{tree.start[name] + 0.0:.6g}" for name in own)
    names = ", ".join(own)
    return f"header: auto\nname: [{names}]\nposition: [{values}]\nvelocity: []\neffort: []\n"
