"""Standalone MJCF in the style of MuJoCo Menagerie, written from the description."""

from trocar.modeling.menagerie.document import mjcf_document, option_block
from trocar.modeling.menagerie.scene import scene_document
from trocar.modeling.menagerie.sheet import file_name
from trocar.modeling.menagerie.variants import MJX, PID, POSITION, VARIANTS, Variant

__all__ = [
    "MJX",
    "PID",
    "POSITION",
    "VARIANTS",
    "Variant",
    "file_name",
    "mjcf_document",
    "option_block",
    "scene_document",
]
