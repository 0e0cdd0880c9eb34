"""Poses of messages, of tf and of matrices as frames of PyKDL, with the names of tf_conversions.

Source of names and behaviour: the public documentation of tf_conversions (ROS 1 Noetic).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.scripts.crtk_client import FrameFromPoseMsg, FrameToPoseMsg, kdl
from trocar.scripts.messages import message_class

__all__ = ["fromMatrix", "fromMsg", "fromTf", "toMatrix", "toMsg", "toTf"]


def fromMsg(p: Any) -> Any:
    """Return a frame of a geometry_msgs/Pose."""
    return FrameFromPoseMsg(p)


def toMsg(f: Any) -> Any:
    """Return a geometry_msgs/Pose of a frame."""
    return FrameToPoseMsg(f, message_class("geometry_msgs/Pose")())


def fromTf(tf: Any) -> Any:
    """Return a frame of a position and a quaternion xyzw."""
    position, quaternion = tf
    return kdl.Frame(kdl.Rotation.Quaternion(*quaternion), kdl.Vector(*position))


def toTf(f: Any) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Return the position and the quaternion xyzw of a frame."""
    return (f.p[0], f.p[1], f.p[2]), tuple(f.M.GetQuaternion())


def fromMatrix(m: Any) -> Any:
    """Return a frame of a matrix, (4, 4)."""
    T = np.asarray(m, dtype=np.float64)
    rotation = kdl.Rotation(*(float(value) for value in T[:3, :3].ravel()))
    return kdl.Frame(rotation, kdl.Vector(*(float(value) for value in T[:3, 3])))


def toMatrix(f: Any) -> NDArray[np.float64]:
    """Return the matrix of a frame, (4, 4)."""
    T = np.eye(4)
    T[:3] = [[f.M[i, 0], f.M[i, 1], f.M[i, 2], f.p[i]] for i in range(3)]
    return T
