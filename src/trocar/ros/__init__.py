"""CRTK, the dVRK's interface: a core without ROS, and the transports that it serves."""

from trocar.ros.core import Component, Core, Transport
from trocar.ros.topic import Service, Topic

__all__ = ["Component", "Core", "Service", "Topic", "Transport"]
