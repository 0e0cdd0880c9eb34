"""Pictures and videos of what a camera of a rig sees."""

from trocar.apps.filming.film import film, kind_of, take_picture
from trocar.apps.filming.show import EYES, SHOWN

__all__ = ["EYES", "SHOWN", "film", "kind_of", "take_picture"]
