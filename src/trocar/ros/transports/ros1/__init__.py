"""ROS 1: the core's topics and services by rospy, where it can be imported."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trocar.ros.transports.ros1.client import Ros1Client
from trocar.ros.transports.ros1.master import MasterError
from trocar.ros.transports.ros1.transport import MissingRospyError, Ros1Transport

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from trocar.live.access import PageAccess

__all__ = [
    "OPTIONS",
    "ORDER",
    "MasterError",
    "MissingRospyError",
    "Ros1Client",
    "Ros1Transport",
    "open_transport",
]

ORDER = 20
OPTIONS = """
--ros1  join ROS 1 with rospy, master at ROS_MASTER_URI
"""


def open_transport(options: Mapping[str, Any], pages: PageAccess) -> Ros1Transport | None:  # noqa: ARG001
    """Return the transport for --ros1."""
    return Ros1Transport() if options["ros1"] else None
