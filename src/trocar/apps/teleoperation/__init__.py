"""Teleoperation: hands at masters move instruments and the endoscope."""

from trocar.apps.teleoperation.engine import Teleoperation
from trocar.apps.teleoperation.remote_master import components, engine_and_components
from trocar.apps.teleoperation.topics import component

__all__ = ["Teleoperation", "component", "components", "engine_and_components"]
