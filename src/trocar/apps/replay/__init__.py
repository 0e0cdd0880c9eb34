"""Repeat a recording of a simulation, or drive an arm along one of a real arm, and compare."""

from trocar.apps.replay.repeat import RepeatReport, repeat
from trocar.apps.replay.report import ReplayReport
from trocar.apps.replay.run import ReplaySettings, replay

__all__ = ["RepeatReport", "ReplayReport", "ReplaySettings", "repeat", "replay"]
