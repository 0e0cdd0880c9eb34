"""What a robot and its cameras see: still pictures of rigs, and the stereo endoscope."""

from trocar.rendering.endoscope import Endoscope
from trocar.rendering.frames import StereoFrame
from trocar.rendering.look import Look
from trocar.rendering.pictures import write_pictures
from trocar.rendering.portrait import portrait
from trocar.rendering.renderer import Channels, Renderer
from trocar.rendering.series import Series
from trocar.rendering.stream import Stream

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
