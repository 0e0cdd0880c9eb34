"""Messages from numbers: nested dicts in ROS 2's field names."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.ros.clock import Stamp

Array = NDArray[np.float64]
Message = dict[str, Any]


def header(stamp: Stamp, frame_id: str = "") -> Message:
    """Return a std_msgs/Header."""
    return {"stamp": stamp, "frame_id": frame_id}


def joints(stamp: Stamp, names: Sequence[str], q: Array, v: Array, effort: Array) -> Message:
    """Return a sensor_msgs/JointState [rad or m, per s, N m or N]."""
    return {
        "header": {"stamp": stamp, "frame_id": ""},
        "name": names,
        "position": q,
        "velocity": v,
        "effort": effort,
    }


def pose(T: Array) -> Message:
    """Return a geometry_msgs/Pose of T (4, 4)."""
    return {"position": vector(T[:3, 3]), "orientation": quaternion(T)}


def quaternion(T: Array) -> Message:
    """Return a geometry_msgs/Quaternion of the rotation in T, w not negative.

    Source: S. W. Shepperd, Quaternion from Rotation Matrix, 1978: the largest component first.
    """
    (a, b, c), (d, e, f), (g, h, i) = T[:3, :3].tolist()
    trace = a + e + i
    if trace >= max(a, e, i):
        w = 0.5 * sqrt(max(0.0, 1.0 + trace))
        s = 0.25 / w
        x, y, z = s * (h - f), s * (c - g), s * (d - b)
    elif a >= e and a >= i:
        x = 0.5 * sqrt(max(0.0, 1.0 + a - e - i))
        s = 0.25 / x
        w, y, z = s * (h - f), s * (b + d), s * (c + g)
    elif e >= i:
        y = 0.5 * sqrt(max(0.0, 1.0 - a + e - i))
        s = 0.25 / y
        w, x, z = s * (c - g), s * (b + d), s * (f + h)
    else:
        z = 0.5 * sqrt(max(0.0, 1.0 - a - e + i))
        s = 0.25 / z
        w, x, y = s * (d - b), s * (c + g), s * (f + h)
    sign = -1.0 if w < 0.0 else 1.0
    return {"x": sign * x, "y": sign * y, "z": sign * z, "w": sign * w}


def pose_stamped(stamp: Stamp, frame_id: str, T: Array) -> Message:
    """Return a geometry_msgs/PoseStamped of T (4, 4)."""
    return {"header": {"stamp": stamp, "frame_id": frame_id}, "pose": pose(T)}


def transform_stamped(stamp: Stamp, parent: str, child: str, T: Array) -> Message:
    """Return a geometry_msgs/TransformStamped of T_parent_child (4, 4)."""
    return {
        "header": {"stamp": stamp, "frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": vector(T[:3, 3]), "rotation": quaternion(T)},
    }


def vector(v: Array) -> Message:
    """Return a geometry_msgs/Vector3 or Point of (3,)."""
    x, y, z = v.tolist()
    return {"x": x, "y": y, "z": z}


def twist_stamped(stamp: Stamp, frame_id: str, twist: Array) -> Message:
    """Return a geometry_msgs/TwistStamped of (linear; angular), (6,)."""
    return {
        "header": {"stamp": stamp, "frame_id": frame_id},
        "twist": {"linear": vector(twist[:3]), "angular": vector(twist[3:])},
    }


def wrench_stamped(stamp: Stamp, frame_id: str, wrench: Array) -> Message:
    """Return a geometry_msgs/WrenchStamped of (force; torque), (6,)."""
    return {
        "header": {"stamp": stamp, "frame_id": frame_id},
        "wrench": {"force": vector(wrench[:3]), "torque": vector(wrench[3:])},
    }


def matrix(values: Array) -> Message:
    """Return a std_msgs/Float64MultiArray of (rows, columns), row by row.

    Strides are those that the dVRK writes, which belong to columns one after the other. Source:
    cisst-ros 73aca61, mtsCISSTToROS.cpp:142.
    """
    rows, columns = values.shape
    return {
        "layout": {
            "dim": [
                {"label": "rows", "size": rows, "stride": 1},
                {"label": "cols", "size": columns, "stride": rows},
            ],
            "data_offset": 0,
        },
        "data": values.ravel(),
    }


def joy(*buttons: int) -> Message:
    """Return a sensor_msgs/Joy without its header."""
    return {"axes": [], "buttons": list(buttons)}
