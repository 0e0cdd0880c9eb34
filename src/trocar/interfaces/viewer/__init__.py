"""The web viewer: the rig in three dimensions, sliders, plots and health, served by viser."""

from trocar.interfaces.viewer.driving import Driving, Pedal
from trocar.interfaces.viewer.page import serve

__all__ = ["Driving", "Pedal", "serve"]
