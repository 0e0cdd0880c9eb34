"""Simulated arms along a real robot's motion: mirrored, replayed (docs/follow.md) or repeated."""

from trocar.apps.bags import Bag, open_bag
from trocar.apps.follow.mirror import BagSource, LiveSource, Mirror, MirrorReport
from trocar.apps.follow.repeat import RepeatReport, repeat
from trocar.apps.follow.replay import ReplayReport, ReplaySettings, replay

__all__ = [
    "Bag",
    "BagSource",
    "LiveSource",
    "Mirror",
    "MirrorReport",
    "RepeatReport",
    "ReplayReport",
    "ReplaySettings",
    "open_bag",
    "repeat",
    "replay",
]
