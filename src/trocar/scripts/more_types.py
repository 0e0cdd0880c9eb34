"""Messages of ROS that scripts exchange among themselves, and that the robot has no topic of.

They go from the script to the script only: no transport and no bag has them. Source of the fields:
ROS's common messages as ROS 1 Noetic and ROS 2 Humble both have them.
"""

from __future__ import annotations

from functools import cache

from trocar.errors import UnknownNameError
from trocar.messages import MessageType, message_names, message_type
from trocar.messages.types import read_constants, read_fields

_NUMBERS = {
    "Byte": "int8", "Char": "uint8", "Int8": "int8", "Int16": "int16", "Int64": "int64",
    "UInt8": "uint8", "UInt16": "uint16", "UInt32": "uint32", "UInt64": "uint64",
}  # fmt: skip
_ARRAYS = {
    "Float32": "float32", "Int8": "int8", "Int16": "int16", "Int32": "int32", "Int64": "int64",
    "UInt8": "uint8", "UInt16": "uint16", "UInt32": "uint32", "UInt64": "uint64",
}  # fmt: skip
_HEADER = "std_msgs/Header header\n"
#: {type: its fields}
TEXTS: dict[str, str] = {
    **{f"std_msgs/{name}": f"{kind} data" for name, kind in _NUMBERS.items()},
    **{
        f"std_msgs/{name}MultiArray": f"std_msgs/MultiArrayLayout layout\n{kind}[] data"
        for name, kind in _ARRAYS.items()
    },
    "std_msgs/Time": "builtin_interfaces/Time data",
    "std_msgs/Duration": "builtin_interfaces/Duration data",
    "std_msgs/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "geometry_msgs/Point32": "float32 x\nfloat32 y\nfloat32 z",
    "geometry_msgs/Polygon": "geometry_msgs/Point32[] points",
    "geometry_msgs/PolygonStamped": f"{_HEADER}geometry_msgs/Polygon polygon",
    "geometry_msgs/Pose2D": "float64 x\nfloat64 y\nfloat64 theta",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/PoseWithCovarianceStamped": f"{_HEADER}geometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Accel": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/AccelStamped": f"{_HEADER}geometry_msgs/Accel accel",
    "sensor_msgs/ChannelFloat32": "string name\nfloat32[] values",
    "sensor_msgs/PointCloud": (
        f"{_HEADER}geometry_msgs/Point32[] points\nsensor_msgs/ChannelFloat32[] channels"
    ),
    "sensor_msgs/PointField": (
        "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n"
        "uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\n"
        "string name\nuint32 offset\nuint8 datatype\nuint32 count"
    ),
    "sensor_msgs/PointCloud2": (
        f"{_HEADER}uint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
        "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense"
    ),
    "sensor_msgs/Temperature": f"{_HEADER}float64 temperature\nfloat64 variance",
    "sensor_msgs/Range": (
        "uint8 ULTRASOUND=0\nuint8 INFRARED=1\n"
        f"{_HEADER}uint8 radiation_type\nfloat32 field_of_view\nfloat32 min_range\n"
        "float32 max_range\nfloat32 range"
    ),
    "nav_msgs/Path": f"{_HEADER}geometry_msgs/PoseStamped[] poses",
    "nav_msgs/Odometry": (
        f"{_HEADER}string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist"
    ),
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start"
    ),
    "trajectory_msgs/JointTrajectory": (
        f"{_HEADER}string[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points"
    ),
    "visualization_msgs/Marker": (
        "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\n"
        "int32 LINE_LIST=5\nint32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\n"
        "int32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\n"
        "int32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\n"
        f"{_HEADER}string ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
        "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] colors\nstring text\nstring mesh_resource\n"
        "bool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
}


@cache
def script_type(name: str) -> MessageType:
    """Return a type of messages that scripts may use.

    Raises:
        UnknownNameError: there is none of that name
    """
    if name not in TEXTS:
        if name in message_names():
            return message_type(name)
        raise UnknownNameError("message type", name, script_names())
    text, (package, own) = TEXTS[name], name.split("/")
    return MessageType(
        name=name,
        fields=read_fields(text, name),
        constants=read_constants(text),
        text_ros1=text,
        text_ros2=text,
        md5="*",
        ros2_name=f"{package}/msg/{own}",
        dds_name="",
    )


def script_names() -> tuple[str, ...]:
    """Return the names of all types that scripts may use."""
    return (*message_names(), *TEXTS)
