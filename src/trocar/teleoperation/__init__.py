"""Teleoperation: hands at masters move instruments and the endoscope."""

from trocar.teleoperation.engine import Teleoperation
from trocar.teleoperation.remote_master import components, engine_and_components
from trocar.teleoperation.topics import component

__all__ = ["Teleoperation", "component", "components", "engine_and_components"]
