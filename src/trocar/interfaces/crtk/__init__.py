"""CRTK, the dVRK's interface: an engine-free core that every transport speaks for."""

from trocar.interfaces.crtk.component import Component
from trocar.interfaces.crtk.core import Core
from trocar.interfaces.crtk.topics import Service, Topic
from trocar.interfaces.crtk.transport import Transport

__all__ = ["Component", "Core", "Service", "Topic", "Transport"]
