"""Standalone MJCF in the style of MuJoCo Menagerie, written from the description."""

from trocar.modeling.menagerie.document import mjcf_document
from trocar.modeling.menagerie.scene import scene_document
from trocar.modeling.menagerie.variants import MJX, PID, POSITION, VARIANTS, Variant

__all__ = [
    "MJX",
    "PID",
    "POSITION",
    "VARIANTS",
    "Variant",
    "mjcf_document",
    "scene_document",
]
