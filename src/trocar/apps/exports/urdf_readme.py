"""What the README of a URDF says."""

from __future__ import annotations

from trocar.apps.exports.readme import readme
from trocar.apps.exports.task import Task


def urdf_readme(task: Task, name: str, warnings: tuple[str, ...]) -> str:
    """Return the README of a folder whose model is NAME.urdf."""
    package = task.options.package
    sections = {
        "What is here": FILES.format(name=name) + (PACKAGE_FILES if package else ""),
        "To load it": LOAD.format(
            name=name,
            pin="[Path.cwd().parent]" if package else '["."]',
            drake=f'parser.package_map().Add("{package}", ".")\n' if package else "",
        ),
        "To see it in RViz": RVIZ.format(name=name)
        if package
        else "RViz finds meshes in ROS packages only: export with `--package NAME`.",
        "Joints": _joints(task),
        "What URDF cannot say": LOST,
    }
    if warnings:
        sections["Warnings"] = "\n".join(f"- {text}" for text in warnings)
    return readme(task, "urdf", sections)


def _joints(task: Task) -> str:
    rows = ["| arm | joint | is the URDF's | times |", "|---|---|---|---|"]
    for joint in task.model.joints:
        if joint.hinge is not None and joint.hinge.joint is not None:
            public, weight = joint.hinge.joint.name, joint.hinge.weight
            rows.append(f"| {joint.arm} | {public} | `{joint.name}` | {weight:g} |")
    return "\n".join(rows) + "\n\n" + MIMIC


FILES = """| file | |
|---|---|
| `{name}.urdf` | the robot; its root is the link `world` |
| `{name}_drake.urdf` | the same without dry friction, which Drake does not have and warns of |
| `meshes/` | what links look like and collide with, in metres (none where all are simple shapes) |
| `rviz/trocar.rviz`, `rviz/trocar_ros2.rviz` | views for RViz of ROS 1 and of ROS 2 |
| `rviz/start.yaml` | a JointState of the pose "start" |"""

PACKAGE_FILES = """
| `package.xml`, `CMakeLists.txt` | a ROS package, for ROS 1 (catkin) and ROS 2 (ament) |"""

LOAD = """In this folder, in Python:

```python
import mujoco, pinocchio, yourdfpy
from pathlib import Path
from pydrake.all import AddMultibodyPlantSceneGraph, DiagramBuilder, Parser

yourdfpy.URDF.load("{name}.urdf")
mujoco.MjModel.from_xml_path("{name}.urdf")

model = pinocchio.buildModelFromUrdf("{name}.urdf", mimic=True)
pinocchio.buildGeomFromUrdf(
    model, "{name}.urdf", pinocchio.GeometryType.VISUAL, package_dirs={pin}
)

plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), time_step=1e-3)
parser = Parser(plant)
{drake}parser.AddModels("{name}_drake.urdf")
plant.Finalize()
```

Drake reads `mimic` in plants with a time step only."""

RVIZ = """ROS 1, the folder above this one in `ROS_PACKAGE_PATH`, `roscore` running:

```
rosparam set robot_description -t {name}.urdf
rosrun robot_state_publisher robot_state_publisher &
rostopic pub -s -r 10 /joint_states sensor_msgs/JointState "$(cat rviz/start.yaml)" &
rviz -d rviz/trocar.rviz
```

ROS 2, after `colcon build` in a workspace with this folder in `src`, and sourcing it:

```
ros2 run robot_state_publisher robot_state_publisher {name}.urdf &
ros2 topic pub -r 10 /joint_states sensor_msgs/msg/JointState "$(cat rviz/start.yaml)" &
rviz2 -d rviz/trocar_ros2.rviz
```"""

MIMIC = """\
All other joints mimic these. A joint that follows two stands as two joints about one axis, with a
link between them that has a millionth of the mass. `_and_` in the name of a joint brings it, when
names are sorted, behind the joints that it mimics, which pinocchio wants to know first."""

LOST = """\
- Closed loops: passive joints `mimic` the coordinates that the loop gives them; forces do not go
  around it. The formats sdf and mjcf have real loops.
- Springs (a master's gripper), the inertia of rotors, gains of the motors.
- Which links may touch: neighbours overlap at their joints, so leave contacts of neighbours out.
- Where a number is not known, as the largest speed of a gripper, the limit is 1000."""
