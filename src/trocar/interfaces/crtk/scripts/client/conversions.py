"""Poses, twists and wrenches as scripts have them, from messages and into them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.interfaces.crtk.scripts import frames
from trocar.interfaces.crtk.scripts.message_classes import message_class

kdl: Any
try:
    import PyKDL  # pyright: ignore[reportMissingImports]

    kdl = PyKDL
except ImportError:
    kdl = frames

Array = NDArray[np.float64]


def _frame(position: Any, rotation: Any) -> Any:
    turn = kdl.Rotation.Quaternion(rotation.x, rotation.y, rotation.z, rotation.w)
    return kdl.Frame(turn, kdl.Vector(position.x, position.y, position.z))


def _put(frame: Any, position: Any, rotation: Any) -> None:
    rotation.x, rotation.y, rotation.z, rotation.w = frame.M.GetQuaternion()
    position.x, position.y, position.z = frame.p[0], frame.p[1], frame.p[2]


def FrameFromPoseMsg(p: Any) -> Any:
    """Return a frame of a geometry_msgs/Pose."""
    return _frame(p.position, p.orientation)


def FrameToPoseMsg(f: Any, made: Any = None) -> Any:
    """Return a geometry_msgs/Pose of a frame."""
    made = message_class("geometry_msgs/Pose")() if made is None else made
    _put(f, made.position, made.orientation)
    return made


def FrameFromTransformMsg(t: Any) -> Any:
    """Return a frame of a geometry_msgs/Transform."""
    return _frame(t.translation, t.rotation)


def FrameToTransformMsg(f: Any) -> Any:
    """Return a geometry_msgs/Transform of a frame."""
    made: Any = message_class("geometry_msgs/Transform")()
    _put(f, made.translation, made.rotation)
    return made


def _six(a: Any, b: Any) -> Array:
    return np.array([a.x, a.y, a.z, b.x, b.y, b.z])


def _spread(values: Any, a: Any, b: Any) -> None:
    a.x, a.y, a.z, b.x, b.y, b.z = (float(value) for value in values)


def ArrayFromTwistMsg(t: Any) -> Array:
    """Return (linear; angular) of a geometry_msgs/Twist, (6,) [m/s, rad/s]."""
    return _six(t.linear, t.angular)


def ArrayToTwistMsg(a: Any, made: Any = None) -> Any:
    """Return a geometry_msgs/Twist of six numbers."""
    made = message_class("geometry_msgs/Twist")() if made is None else made
    _spread(a, made.linear, made.angular)
    return made


def ArrayFromWrenchMsg(w: Any) -> Array:
    """Return (force; torque) of a geometry_msgs/Wrench, (6,) [N, N m]."""
    return _six(w.force, w.torque)


def ArrayToWrenchMsg(a: Any, made: Any = None) -> Any:
    """Return a geometry_msgs/Wrench of six numbers."""
    made = message_class("geometry_msgs/Wrench")() if made is None else made
    _spread(a, made.force, made.torque)
    return made
