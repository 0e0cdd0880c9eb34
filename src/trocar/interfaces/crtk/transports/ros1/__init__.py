"""ROS 1: the core's topics and services by rospy, where it can be imported."""

from trocar.interfaces.crtk.transports.ros1.master import MasterError
from trocar.interfaces.crtk.transports.ros1.transport import (
    MissingRospyError,
    Ros1Listener,
    Ros1Transport,
)

__all__ = ["MasterError", "MissingRospyError", "Ros1Listener", "Ros1Transport"]
