"""What a robot and its cameras see: still pictures of rigs, and the stereo endoscope."""

from trocar.rendering.endoscope import Endoscope, Series, Stream
from trocar.rendering.frames import StereoFrame
from trocar.rendering.look import Look
from trocar.rendering.renderer import Channels, Renderer
from trocar.rendering.stills import portrait, write_pictures

__all__ = [
    "Channels",
    "Endoscope",
    "Look",
    "Renderer",
    "Series",
    "StereoFrame",
    "Stream",
    "portrait",
    "write_pictures",
]
