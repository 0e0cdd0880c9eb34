"""Views for RViz, and the joint states of the pose that a rig starts in.

Source: what RViz 1.14 (ROS 1) saves, pared down; rviz_default_plugins for the names in ROS 2.
"""

from __future__ import annotations

import numpy as np

from trocar.modeling.links import LinkModel, link_poses
from trocar.modeling.urdf import urdf_tree

#: The camera's distance over the largest extent of the links' origins. Source: chosen by eye.
DISTANCE = 1.7
#: Where the camera stands: above the horizon, and around it [rad]. Source: chosen by eye.
PITCH, YAW = 0.3, 0.9


def rviz_config(model: LinkModel, ros: int) -> str:
    """Return a view of a rig.

    Args:
        ros: 1 or 2, whose classes have different names
    """
    places = link_poses(model, model.start)
    at = np.array([places[link.name][:3, 3] for link in model.links if link.arm])
    low, high = at.min(axis=0), at.max(axis=0)
    x, y, z = 0.5 * (low + high)
    plugin = "rviz" if ros == 1 else "rviz_default_plugins"
    source = "Robot Description: robot_description" if ros == 1 else DESCRIPTION_TOPIC
    return VIEW.format(
        panel="rviz" if ros == 1 else "rviz_common",
        plugin=plugin,
        source=source,
        floor=f"{min(pose[2, 3] for pose in places.values()):.4g}",
        focus=f"X: {x:.4g}, Y: {y:.4g}, Z: {z:.4g}",
        distance=f"{DISTANCE * float((high - low).max()) + 0.3:.4g}",
        pitch=PITCH,
        yaw=YAW,
    )


def start_message(model: LinkModel) -> str:
    """Return a sensor_msgs/JointState of the pose "start", in YAML."""
    tree = urdf_tree(model)
    own = [joint.name for joint in tree.joints if joint.kind != "fixed" and not joint.follows]
    values = ", ".join(f"{tree.start[name] + 0.0:.6g}" for name in own)
    names = ", ".join(own)
    return f"header: auto\nname: [{names}]\nposition: [{values}]\nvelocity: []\neffort: []\n"


DESCRIPTION_TOPIC = """Description Source: Topic
      Description Topic:
        Durability Policy: Transient Local
        Reliability Policy: Reliable
        Value: /robot_description"""

VIEW = """Panels:
  - Class: {panel}/Displays
    Name: Displays
Visualization Manager:
  Displays:
    - Class: {plugin}/Grid
      Name: Grid
      Enabled: true
      Cell Size: 0.25
      Plane Cell Count: 16
      Color: 190; 194; 200
      Offset: {{X: 0, Y: 0, Z: {floor}}}
    - Class: {plugin}/RobotModel
      Name: RobotModel
      Enabled: true
      {source}
      Collision Enabled: false
      Visual Enabled: true
    - Class: {plugin}/TF
      Name: TF
      Enabled: false
  Global Options:
    Background Color: 255; 255; 255
    Fixed Frame: world
    Frame Rate: 30
  Tools:
    - Class: {plugin}/MoveCamera
  Views:
    Current:
      Class: {plugin}/Orbit
      Name: Current View
      Target Frame: world
      Distance: {distance}
      Focal Point: {{{focus}}}
      Pitch: {pitch}
      Yaw: {yaw}
Window Geometry:
  Width: 1280
  Height: 900
"""
