"""The browser page: the cart in three dimensions, sliders, plots and health, served by viser."""

from trocar.interfaces.viewer.driving import Driving
from trocar.interfaces.viewer.page import serve

__all__ = ["Driving", "serve"]
