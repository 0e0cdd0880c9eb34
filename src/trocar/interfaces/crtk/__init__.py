"""CRTK, the dVRK's interface: a core without ROS, and the transports that it serves."""

from trocar.interfaces.crtk.core import Component, Core, Transport
from trocar.interfaces.crtk.topic import Service, Topic

__all__ = ["Component", "Core", "Service", "Topic", "Transport"]
