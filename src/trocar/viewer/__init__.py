"""The web viewer: the rig in three dimensions, sliders, plots and health, served by viser."""

from trocar.viewer.driving import Driving, Pedal
from trocar.viewer.page import serve

__all__ = ["Driving", "Pedal", "serve"]
