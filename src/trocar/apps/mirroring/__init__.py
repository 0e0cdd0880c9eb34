"""A real robot's motion, live or recorded, on the simulated arms (docs/mirror.md)."""

from trocar.apps.mirroring.bag import Bag, open_bag
from trocar.apps.mirroring.mirror import BagSource, LiveSource, Mirror, MirrorReport

__all__ = ["Bag", "BagSource", "LiveSource", "Mirror", "MirrorReport", "open_bag"]
