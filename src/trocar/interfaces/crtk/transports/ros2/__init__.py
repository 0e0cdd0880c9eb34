"""ROS 2 without ROS 2: Cyclone DDS (extra `ros2`) under ROS's names, with our CDR bytes.

Topics meet by name and type name, as in ROS 2; services follow the convention of
rmw_cyclonedds_cpp; nodes and type hashes are those that `ros2 node list` and `ros2 topic info -v`
read.
"""

from trocar.interfaces.crtk.transports.ros2.dds import Network, network
from trocar.interfaces.crtk.transports.ros2.transport import Ros2Listener, Ros2Transport

__all__ = ["Network", "Ros2Listener", "Ros2Transport", "network"]
