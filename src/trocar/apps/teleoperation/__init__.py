"""Teleoperation: hands at masters move instruments and the endoscope."""

from trocar.apps.teleoperation.engine import Teleoperation

__all__ = ["Teleoperation"]
