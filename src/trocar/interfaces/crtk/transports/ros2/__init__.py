"""ROS 2 without ROS 2: Cyclone DDS (extra `ros2`) under ROS's names, with our CDR bytes.

What meets whom: topics by name and type name, as in ROS 2; services in the convention of
rmw_cyclonedds_cpp; nodes and type hashes as `ros2 node list` and `ros2 topic info -v` read them.
"""

from trocar.interfaces.crtk.transports.ros2.network import Network, network
from trocar.interfaces.crtk.transports.ros2.transport import Ros2Transport

__all__ = ["Network", "Ros2Transport", "network"]
