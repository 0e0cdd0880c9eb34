"""The modules that a script imports while it runs: crtk, dvrk, rospy, PyKDL and messages."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from trocar.messages import message_names, service_names
from trocar.scripts import crtk_client, dvrk_client, kdl
from trocar.scripts.messages import message_class, service_class
from trocar.scripts.ros import Node

#: Modules that a script imports anew, so that what waits in them waits for simulated time.
ANEW = ("queue",)
#: Packages of the robot: imported if installed, replaced by our own otherwise.
ROBOT = ("crtk", "dvrk", "PyKDL")
DVRK = ("arm", "ecm", "mtm", "psm", "suj", "system", "console", "teleop_psm")
CONVERSIONS = (
    "FrameFromPoseMsg", "FrameToPoseMsg", "FrameFromTransformMsg", "FrameToTransformMsg",
    "ArrayFromTwistMsg", "ArrayToTwistMsg", "ArrayFromWrenchMsg", "ArrayToWrenchMsg",
)  # fmt: skip


def script_modules(node: Node, folder: Path) -> dict[str, ModuleType]:
    """Return {name: module} of all that stands in for ROS.

    An installed dvrk, crtk with it, or PyKDL is taken instead, and one that lies beside the script.

    Args:
        node: the script's
        folder: where the script lies
    """
    found = message_modules()
    found["rospy"] = _module("rospy", node.names(), "What scripts use of rospy.")
    own = client_modules(type("ral", (crtk_client.ral,), {"_node_of_run": node}))
    specs = {name: PathFinder.find_spec(name, [str(folder), *sys.path]) for name in ROBOT}
    installed = {name for name, spec in specs.items() if spec is not None and spec.origin}
    if "dvrk" not in installed:
        installed -= {"crtk"}  # our dvrk stands on our crtk
    found |= {name: made for name, made in own.items() if name.split(".")[0] not in installed}
    return found


def client_modules(layer: type) -> dict[str, ModuleType]:
    """Return our own crtk and dvrk over a layer, and our own PyKDL."""
    names = ("utils", "wait_move_handle", "joystick_button", "measured_cp", *CONVERSIONS)
    crtk_names = {"ral": layer, **{name: getattr(crtk_client, name) for name in names}}
    dvrk_names = {name: getattr(dvrk_client, name) for name in DVRK}
    made = _module("crtk", crtk_names, "CRTK's client.")
    conv = _module("crtk.msg_conversions", {n: crtk_names[n] for n in CONVERSIONS}, "Conversions.")
    made.__dict__["msg_conversions"] = conv
    found = {"crtk": made, "crtk.msg_conversions": conv}
    found["dvrk"] = _module("dvrk", dvrk_names, "The dVRK's arms and console.")
    for name, value in dvrk_names.items():
        # `from dvrk.psm import psm` finds it, `dvrk.psm` stays the class
        found[f"dvrk.{name}"] = _module(f"dvrk.{name}", {name: value}, f"dvrk.{name}.")
    kdl_names = {name: getattr(kdl, name) for name in kdl.__all__}
    found["PyKDL"] = _module("PyKDL", kdl_names, "Frames, as PyKDL's.")
    return found


def message_modules() -> dict[str, ModuleType]:
    """Return {package and its .msg and .srv: module} of every message that trocar speaks."""
    kinds: dict[str, dict[str, Any]] = {}
    for name in message_names():
        package, own = name.split("/")
        kinds.setdefault(f"{package}.msg", {})[own] = message_class(name)
    for name in service_names():
        package, own = name.split("/")
        made: Any = service_class(name)
        part = kinds.setdefault(f"{package}.srv", {})
        part[own], part[f"{own}Request"] = made, made._request_class
        part[f"{own}Response"] = made._response_class
    found: dict[str, ModuleType] = {}
    for name, names in kinds.items():
        package, part = name.split(".")
        if package not in found:
            found[package] = _module(package, {}, f"The package {package}.")
        found[name] = _module(name, names, f"What {package} has.")
        found[package].__dict__[part] = found[name]
    return found


def _module(name: str, names: Mapping[str, Any], text: str) -> ModuleType:
    made = ModuleType(name, text)
    made.__dict__.update(names)
    made.__dict__["__all__"] = list(names)
    if "." not in name:
        made.__dict__["__path__"] = []
    made.__spec__ = importlib.util.spec_from_loader(name, None)
    return made


@contextmanager
def on_import(modules: Mapping[str, ModuleType], folder: Path) -> Generator[None]:
    """Let modules be found by their names, and a folder searched first, until the block ends.

    What the script imports meanwhile is forgotten afterwards, where it may hold on to them.
    """
    before, places, argv = dict(sys.modules), list(sys.path), list(sys.argv)
    version = os.environ.get("ROS_VERSION")
    os.environ["ROS_VERSION"] = "1"  # an installed crtk chooses by it, and finds our rospy
    finder = RosFinder(sorted({name.split(".")[0] for name in modules}))
    for name in ANEW if "threading" in modules else ():
        sys.modules.pop(name, None)
    sys.modules.update(modules)
    sys.path.insert(0, str(folder))
    sys.meta_path.append(finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        os.environ.pop("ROS_VERSION")
        if version is not None:
            os.environ["ROS_VERSION"] = version
        sys.path[:], sys.argv[:] = places, argv
        own = [name for name in sys.modules.keys() - before.keys() if _is_of(name, folder)]
        for name in [*modules, *ANEW, *own, "__main__"]:
            sys.modules.pop(name, None)
            if name in before:
                sys.modules[name] = before[name]


def _is_of(name: str, folder: Path) -> bool:
    """Return whether a module that a script imported belongs to it or to its robot."""
    file = getattr(sys.modules[name], "__file__", None) or ""
    return Path(file).is_relative_to(folder) or name.split(".")[0] in ROBOT


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
    """The last of the import system's finders: names a package of ROS that is missing.

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
        """Raise for a package of ROS.

        Raises:
            MissingPackageError: it is one
        """
        package = fullname.split(".")[0]
        if package in ROS or MESSAGES.fullmatch(package):
            raise MissingPackageError(fullname, self._offered)
        return None
