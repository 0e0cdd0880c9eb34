"""The modules that a script imports while it runs: crtk, dvrk, rospy or rclpy, PyKDL, messages."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from trocar.messages import service_names
from trocar.messages.types import SECOND
from trocar.scripts import (
    bags,
    camera_models,
    crtk_client,
    dvrk_client,
    image_bridge,
    kdl,
    message_filters,
    posemath,
    ros2,
    ros2_executors,
    ros2_settings,
    transformations,
)
from trocar.scripts.messages import (
    BuiltinDuration,
    BuiltinTime,
    Edition,
    message_class,
    service_class,
)
from trocar.scripts.more_types import script_names
from trocar.scripts.ros import Node, own_arguments
from trocar.scripts.ros2 import Ros2
from trocar.scripts.ros2_time import ClockType

#: Modules that a script imports anew, so that what waits in them waits for simulated time.
ANEW = ("queue",)
#: Packages of the robot: imported if installed, replaced by our own otherwise.
ROBOT = ("crtk", "dvrk", "PyKDL")
DVRK = ("arm", "ecm", "mtm", "psm", "suj", "system", "console", "teleop_psm")
CONVERSIONS = (
    "FrameFromPoseMsg", "FrameToPoseMsg", "FrameFromTransformMsg", "FrameToTransformMsg",
    "ArrayFromTwistMsg", "ArrayToTwistMsg", "ArrayFromWrenchMsg", "ArrayToWrenchMsg",
)  # fmt: skip


def script_modules(node: Node, folder: Path, ros: Ros2 | None = None) -> dict[str, ModuleType]:
    """Return {name: module} of all that stands in for ROS.

    An installed dvrk, crtk with it, or PyKDL is taken instead, and one that lies beside the script.

    Args:
        node: the script's
        folder: where the script lies
        ros: rclpy, of a script for ROS 2
    """
    if ros is None:
        found = message_modules()
        found |= rospy_modules(node) | ros1_modules(node)
        own = client_modules(type("ral", (crtk_client.ral,), {"_node_of_run": node}))
    else:
        found = message_modules(2) | rclpy_modules(ros) | ros2_modules(ros)
        layer = type("ral", (crtk_client.Ros2Ral,), {"_node_of_run": node, "_rclpy": ros})
        own = client_modules(layer, 2)
    specs = {name: PathFinder.find_spec(name, [str(folder), *sys.path]) for name in ROBOT}
    installed = {name for name, spec in specs.items() if spec is not None and spec.origin}
    if "dvrk" not in installed:
        installed -= {"crtk"}  # our dvrk stands on our crtk
    found |= {name: made for name, made in own.items() if name.split(".")[0] not in installed}
    return found


def client_modules(layer: type, edition: Edition = 1) -> dict[str, ModuleType]:
    """Return our own crtk and dvrk over a layer, and our own PyKDL."""
    names = ("utils", "wait_move_handle", "joystick_button", "measured_cp", *CONVERSIONS)
    crtk_names = {"ral": layer, **{name: getattr(crtk_client, name) for name in names}}
    crtk_names |= crtk_client.makers(edition)
    crtk_client.utils._layer_of_run = layer  # pyright: ignore[reportPrivateUsage] - hidden from scripts
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


def rospy_modules(node: Node) -> dict[str, ModuleType]:
    """Return {name: module} of rospy, and of those inside it that scripts import."""
    names = node.names()
    found = {"rospy": _module("rospy", names, "What scripts use of rospy.")}
    for part in ("client", "core", "exceptions", "names", "rostime", "timer", "topics"):
        made = found[f"rospy.{part}"] = _module(f"rospy.{part}", names, f"rospy.{part}.")
        found["rospy"].__dict__[part] = made
    begun = {"is_initialized": lambda: node.get_node_uri() is not None}
    found["rospy.core"].__dict__.update(begun)
    return found


def ros1_modules(node: Node) -> dict[str, ModuleType]:
    """Return {name: module} of what scripts for ROS 1 import beside rospy."""
    bag = type("Bag", (bags.RosBag,), {"now": staticmethod(node.get_rostime)})
    turns = {name: getattr(transformations, name) for name in transformations.__all__}
    topic = type("Subscriber", (message_filters.TopicFilter,), {"subscriber": node.Subscriber})
    poses = {name: getattr(posemath, name) for name in posemath.__all__}
    found = {
        "cv_bridge": _module("cv_bridge", _cv_bridge(1), "Images as arrays."),
        "image_geometry": camera_model_module(),
        "message_filters": _message_filters(topic, node.flow.now_ns),
        "rosbag": _module(
            "rosbag",
            {"Bag": bag, "ROSBagException": bags.BagException, "BagMessage": bags.BagMessage},
            "Bags.",
        ),
        "roslib": _module("roslib", {"load_manifest": load_manifest}, "Paths of ROS 1's packages."),
        "tf": _module("tf", {}, "Transformations; without transforms of topics."),
        "tf_conversions": _module("tf_conversions", poses, "Poses as frames of PyKDL."),
        "tf_conversions.posemath": _module("tf_conversions.posemath", poses, "The same."),
    }
    found["tf"].__dict__["__getattr__"] = _missing_of_tf
    for package in ("tf", "tf_conversions"):
        name = f"{package}.transformations"
        found[name] = _module(name, turns, "Matrices, quaternions and angles.")
        found[package].__dict__["transformations"] = found[name]
    found["tf_conversions"].__dict__["posemath"] = found["tf_conversions.posemath"]
    return found


def _missing_of_tf(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    raise MissingPackageError(f"tf.{name}", ("tf.transformations",))


def load_manifest(package: str) -> None:
    """Do nothing: paths of packages are those of Python."""


def camera_model_module() -> ModuleType:
    """Return image_geometry."""
    kinds = (camera_models.PinholeCameraModel, camera_models.StereoCameraModel)
    return _module("image_geometry", _named(kinds), "Pixels and rays of cameras.")


def ros2_modules(ros: Ros2) -> dict[str, ModuleType]:
    """Return {name: module} of what scripts for ROS 2 import beside rclpy."""
    turns = {name: getattr(transformations, name) for name in transformations.__all__}
    names = (
        bags.StorageOptions, bags.ConverterOptions, bags.StorageFilter, bags.TopicMetadata,
    )  # fmt: skip
    readers = {
        "SequentialReader": bags.SequentialBagReader, "SequentialWriter": bags.SequentialBagWriter,
    }  # fmt: skip
    utilities = _module("rosidl_runtime_py.utilities", {"get_message": get_message}, "Types.")
    found = {
        "cv_bridge": _module("cv_bridge", _cv_bridge(2), "Images as arrays."),
        "image_geometry": camera_model_module(),
        "message_filters": _message_filters(message_filters.NodeTopicFilter, ros.flow.now_ns),
        "rosbag2_py": _module("rosbag2_py", {**_named(names), **readers}, "Bags."),
        "rosidl_runtime_py": _module("rosidl_runtime_py", {}, "Types of messages."),
        "rosidl_runtime_py.utilities": utilities,
        "tf_transformations": _module("tf_transformations", turns, "Matrices and quaternions."),
    }
    found["rosidl_runtime_py"].__dict__["utilities"] = utilities
    return found


def get_message(identifier: str) -> Any:
    """Return the class of a type such as "sensor_msgs/msg/JointState"."""
    return message_class(identifier.replace("/msg/", "/"), 2)


def _message_filters(topic: type, now_ns: Callable[[], int]) -> ModuleType:
    near = message_filters.ApproximateTimeSynchronizer
    names = {
        "Subscriber": topic,
        "SimpleFilter": message_filters.SimpleFilter,
        "TimeSynchronizer": message_filters.TimeSynchronizer,
        near.__name__: type(near.__name__, (near,), {"now_ns": staticmethod(now_ns)}),
    }
    return _module("message_filters", names, "Messages that belong together.")


def _cv_bridge(edition: Edition) -> dict[str, Any]:
    bridge = type("CvBridge", (image_bridge.ImageBridge,), {"edition": edition})
    return {"CvBridge": bridge, "CvBridgeError": image_bridge.CvBridgeError}


def rclpy_modules(ros: Ros2) -> dict[str, ModuleType]:
    """Return {name: module} of rclpy and what comes with it."""
    s, e = ros2_settings, ros2_executors
    errors = (
        ros2.RclInterruptException, ros2.NotInitializedException, ros2.InvalidTopicNameException,
        ros2.ParameterNotDeclaredException, ros2.ParameterAlreadyDeclaredException,
    )  # fmt: skip
    ends = (e.ExternalShutdownException, e.ShutdownException, e.TimeoutException)
    groups = (
        e.CallbackGroup, e.MutuallyExclusiveCallbackGroup, e.ReentrantCallbackGroup,
    )  # fmt: skip
    policies = (
        s.HistoryPolicy, s.ReliabilityPolicy, s.DurabilityPolicy, s.LivelinessPolicy,
    )  # fmt: skip
    profiles = {"QoSProfile": s.QoSProfile, **_named(policies)}
    profiles |= {f"QoS{one.__name__}": one for one in policies}
    profiles |= {
        "qos_profile_sensor_data": s.sensor_data(),
        **{
            f"qos_profile_{name}": s.QoSProfile()
            for name in ("system_default", "services_default", "default", "parameters")
        },
    }
    timing = {"Time": ros.Time, "Duration": ros.Duration, "ClockType": ClockType}
    parts: dict[str, dict[str, Any]] = {
        "callback_groups": _named(groups),
        "client": {"Client": ros.Client},
        "clock": {
            "Clock": ros.Clock, "ROSClock": ros.ROSClock,
            "ClockType": ClockType,
        },
        "context": {"Context": ros.Context},
        "duration": {"Duration": ros.Duration},
        "exceptions": {
            **_named(errors), "ROSInterruptException": ros2.RclInterruptException,
            "InvalidServiceNameException": ros2.InvalidTopicNameException,
        },
        "executors": {
            **_named(ends), "Executor": ros.Executor,
            "SingleThreadedExecutor": ros.SingleThreadedExecutor,
            "MultiThreadedExecutor": ros.MultiThreadedExecutor,
            "EventsExecutor": ros.SingleThreadedExecutor,
        },
        "logging": {
            "get_logger": ros.get_logger, "LoggingSeverity": s.Severity,
            "set_logger_level": ros.set_logger_level,
        },
        "node": {"Node": ros.Node},
        "parameter": {"Parameter": ros.Parameter, "ParameterType": s.ParameterType},
        "publisher": {"Publisher": ros.Publisher},
        "qos": profiles,
        "serialization": {
            "serialize_message": ros2.serialize_message,
            "deserialize_message": ros2.deserialize_message,
        },
        "service": {"Service": ros.Service},
        "signals": {"SignalHandlerOptions": s.SignalHandlerOptions},
        "subscription": {"Subscription": ros.Subscription},
        "task": {"Future": ros.Future, "Task": ros.Task},
        "time": {**timing, "CONVERSION_CONSTANT": SECOND},
        "timer": {"Timer": ros.Timer, "Rate": ros.Rate},
        "utilities": {
            "remove_ros_args": remove_ros_args, "get_default_context": ros.get_default_context,
            "ok": ros.ok, "shutdown": ros.shutdown, "try_shutdown": ros.try_shutdown,
            "get_rmw_implementation_identifier": lambda: "trocar",
        },
        "wait_for_message": {"wait_for_message": ros.wait_for_message},
    }  # fmt: skip
    whole = {
        "Node": ros.Node, "Parameter": ros.Parameter, "Context": ros.Context,
        "Future": ros.Future,
        **{
            name: getattr(ros, name)
            for name in (
                "init", "shutdown", "try_shutdown", "ok", "create_node", "spin", "spin_once",
                "spin_until_future_complete", "get_default_context", "get_global_executor",
            )
        },
    }  # fmt: skip
    found = {"rclpy": _module("rclpy", whole, "What scripts use of rclpy.")}
    for name, names in parts.items():
        made = _module(f"rclpy.{name}", names, f"rclpy.{name}.")
        found[f"rclpy.{name}"] = made
        found["rclpy"].__dict__[name] = made
    return found


def remove_ros_args(args: Sequence[str] | None = None) -> list[str]:
    """Return a command line without ROS's own words."""
    return own_arguments(sys.argv if args is None else args)


def _named(classes: Sequence[type]) -> dict[str, Any]:
    return {one.__name__: one for one in classes}


def message_modules(edition: Edition = 1) -> dict[str, ModuleType]:
    """Return {package and its .msg and .srv: module} of every message that trocar speaks."""
    kinds: dict[str, dict[str, Any]] = {}
    for name in script_names():
        package, own = name.split("/")
        kinds.setdefault(f"{package}.msg", {})[own] = message_class(name, edition)
    for name in service_names():
        package, own = name.split("/")
        made: Any = service_class(name, edition)
        part = kinds.setdefault(f"{package}.srv", {})
        part[own] = made
        if edition == 1:
            part[f"{own}Request"] = made._request_class
            part[f"{own}Response"] = made._response_class
    if edition == 2:
        kinds["builtin_interfaces.msg"] = {"Time": BuiltinTime, "Duration": BuiltinDuration}
        kinds["rcl_interfaces.msg"] = {
            **_named((ros2_settings.ParameterValue, ros2_settings.ParameterDescriptor)),
            **_named((ros2_settings.SetParametersResult, ros2_settings.ParameterType)),
            "FloatingPointRange": ros2_settings.NumberRange,
            "IntegerRange": ros2_settings.NumberRange,
        }
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
def on_import(
    modules: Mapping[str, ModuleType], folder: Path, edition: Edition = 1
) -> Generator[None]:
    """Let modules be found by their names, and a folder searched first, until the block ends.

    What the script imports meanwhile is forgotten afterwards, where it may hold on to them.
    """
    before, places, argv = dict(sys.modules), list(sys.path), list(sys.argv)
    version = os.environ.get("ROS_VERSION")
    os.environ["ROS_VERSION"] = str(edition)  # an installed crtk chooses by it
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
