"""Robots and objects from other tools' files, as arms and props that a rig can place."""

from trocar.formats.importers.importing import Imported, ImportOptions, import_file
from trocar.formats.importers.meshes import FORMATS

__all__ = ["FORMATS", "ImportOptions", "Imported", "import_file"]
