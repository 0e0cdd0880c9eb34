"""Simulated arms along a real robot's motion: mirrored, replayed (docs/follow.md) or repeated."""

from trocar.recording.bags import Bag, open_bag
from trocar.robot.follow.follow_log import ReplayReport, ReplaySettings, replay
from trocar.robot.follow.mirror import BagSource, LiveSource, Mirror, MirrorReport
from trocar.robot.follow.playables import PlayedLog, RepeatedRecording
from trocar.robot.follow.reproduce import RepeatReport, repeat

__all__ = [
    "Bag",
    "BagSource",
    "LiveSource",
    "Mirror",
    "MirrorReport",
    "PlayedLog",
    "RepeatReport",
    "RepeatedRecording",
    "ReplayReport",
    "ReplaySettings",
    "open_bag",
    "repeat",
    "replay",
]
