"""ROS 2: the core's topics and services by rclpy, where it can be imported; on any RMW."""

from trocar.interfaces.crtk.transports.rclpy_node.library import MissingRclpyError
from trocar.interfaces.crtk.transports.rclpy_node.transport import RclpyTransport

__all__ = ["MissingRclpyError", "RclpyTransport"]
