"""Images: the stereo endoscope and the other cameras of a world, and still pictures of rigs."""

from trocar.rendering.endoscope import Endoscope, Stream
from trocar.rendering.frames import StereoFrame
from trocar.rendering.latest_only import LatestOnly
from trocar.rendering.look import Look
from trocar.rendering.renderer import Channels, Renderer
from trocar.rendering.series import Series
from trocar.rendering.stills import portrait, write_pictures

__all__ = [
    "Channels",
    "Endoscope",
    "LatestOnly",
    "Look",
    "Renderer",
    "Series",
    "StereoFrame",
    "Stream",
    "portrait",
    "write_pictures",
]
