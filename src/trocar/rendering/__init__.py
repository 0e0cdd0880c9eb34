"""What a robot looks like: still pictures of arms and rigs."""

from trocar.rendering.pictures import write_pictures
from trocar.rendering.portrait import portrait

__all__ = ["portrait", "write_pictures"]
