"""Pictures and videos of the views of a rig's cameras."""

from trocar.apps.filming.film import film, kind_of, take_picture
from trocar.apps.filming.layers import EYES, SHOWN

__all__ = ["EYES", "SHOWN", "film", "kind_of", "take_picture"]
