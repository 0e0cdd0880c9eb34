"""The web viewer: the rig in three dimensions, sliders, plots and health, served by viser."""

from trocar.viewer.driving import Driving, Pedal
from trocar.viewer.gallery import Card, Choice, Gallery
from trocar.viewer.notebook import ShownWorld, show
from trocar.viewer.page import serve
from trocar.viewer.scoreboard import SceneControls, SceneScore

__all__ = [
    "Card",
    "Choice",
    "Driving",
    "Gallery",
    "Pedal",
    "SceneControls",
    "SceneScore",
    "ShownWorld",
    "serve",
    "show",
]
