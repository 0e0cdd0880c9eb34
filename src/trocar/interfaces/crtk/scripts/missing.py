"""What a script is told that imports a part of ROS which is not there."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

#: Packages of ROS by name. Source: the index of ROS 1 Noetic and ROS 2 Jazzy, what scripts for
#: robots import most.
ROS = {
    "rospy", "rclpy", "roslib", "roslaunch", "rosbag", "rosgraph", "rosparam", "rospkg", "rosnode",
    "rostopic", "genpy", "genmsg", "catkin", "ament_index_python", "rosidl_runtime_py",
    "rosbag2_py", "launch", "launch_ros", "tf", "tf2_ros", "tf2_py", "tf2_kdl",
    "tf2_geometry_msgs", "tf_conversions", "kdl_parser_py", "urdf_parser_py", "cv_bridge",
    "image_geometry", "image_transport", "message_filters", "actionlib", "dynamic_reconfigure",
    "diagnostic_updater", "moveit_commander", "ros_numpy", "rqt_gui", "rqt_gui_py", "crtk", "dvrk",
    "dvrk_robot", "cisst_msgs", "sensor_msgs_py", "builtin_interfaces",
}  # fmt: skip
#: Packages of messages are called so.
MESSAGES = re.compile(r"\w+_(msgs|srvs|interfaces)")


class MissingPackageError(ModuleNotFoundError):
    """A package of ROS that is not there; `offered` are those that are."""

    def __init__(self, name: str, offered: Sequence[str]) -> None:
        self.offered = tuple(offered)
        super().__init__(
            f"needs the ROS package {name!r}, which is not installed for this Python; without ROS"
            f" there are: {', '.join(offered)}",
            name=name,
        )


class RosFinder:
    """The last to be asked for a module: names a package of ROS that nobody else has.

    Args:
        offered: names of packages that are there
    """

    def __init__(self, offered: Sequence[str]) -> None:
        self._offered = tuple(name for name in offered if name not in ("time", "threading"))

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002  as every finder
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> ModuleSpec | None:
        """Raise where a package of ROS is asked for.

        Raises:
            MissingPackageError: it is one
        """
        package = fullname.split(".")[0]
        if package in ROS or MESSAGES.fullmatch(package):
            raise MissingPackageError(fullname, self._offered)
        return None
