"""Drive a simulated arm along a recording of a real one, and compare."""

from trocar.apps.replay.report import ReplayReport
from trocar.apps.replay.run import ReplaySettings, replay

__all__ = ["ReplayReport", "ReplaySettings", "replay"]
