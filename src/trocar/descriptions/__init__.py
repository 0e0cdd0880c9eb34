"""Descriptions of arms, tools and rigs: frozen records read from TOML."""

from trocar.descriptions.catalogue import load_arm, load_rig, load_tool, names
from trocar.descriptions.mounting import fitting_tools, rig_with_tool
from trocar.descriptions.records import ArmDescription, RigDescription

__all__ = [
    "ArmDescription",
    "RigDescription",
    "fitting_tools",
    "load_arm",
    "load_rig",
    "load_tool",
    "names",
    "rig_with_tool",
]
