"""Which mechanism: arms, tools and rigs as frozen records read from TOML."""

from trocar.descriptions.catalogue import load_arm, load_rig, load_tool, names
from trocar.descriptions.records import ArmDescription, RigDescription

__all__ = ["ArmDescription", "RigDescription", "load_arm", "load_rig", "load_tool", "names"]
