"""ROS 2 without ROS 2: Cyclone DDS (extra `ros2`) under ROS's names, with our CDR bytes.

Topics meet by name and type name, as in ROS 2; services follow the convention of
rmw_cyclonedds_cpp; nodes and type hashes are those that `ros2 node list` and `ros2 topic info -v`
read.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from trocar.ros.transports import rclpy_node
from trocar.ros.transports.ros2.client import Ros2Client
from trocar.ros.transports.ros2.dds import Network, network
from trocar.ros.transports.ros2.transport import Ros2Transport

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from trocar.live.access import PageAccess

__all__ = [
    "OPTIONS",
    "ORDER",
    "Network",
    "Ros2Client",
    "Ros2Transport",
    "network",
    "open_transport",
]

_log = logging.getLogger("trocar")

ORDER = 30
OPTIONS = """
--ros2 auto|rclpy|dds ?
    join ROS 2 (no token): rclpy, or dds without a ROS installation (extra ros2); auto (default):
    rclpy if it can be imported, else dds
"""


def open_transport(
    options: Mapping[str, Any],
    pages: PageAccess,  # noqa: ARG001
) -> rclpy_node.RclpyTransport | Ros2Transport | None:
    """Return ROS 2 by rclpy, or by Cyclone DDS without ROS; "auto": by rclpy if there is one.

    Raises:
        MissingRclpyError: rclpy was requested and cannot be imported
        MissingExtraError: the extra `ros2` is not installed
    """
    kind = options["ros2"]
    if kind is None:
        return None
    if kind != "dds":
        try:
            return rclpy_node.RclpyTransport()
        except rclpy_node.MissingRclpyError as error:
            if kind == "rclpy":
                raise
            if error.there:
                reason = f"{error.python} cannot import it ({error.reason})"
                _log.warning("ROS 2: there is an rclpy, but %s; using DDS without ROS", reason)
    return Ros2Transport()
