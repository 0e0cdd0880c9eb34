"""Robots and objects from other tools' files, as arms and props that a rig can place."""

from trocar.formats.importers.importing import Imported, Options, import_file
from trocar.formats.importers.meshes import FORMATS

__all__ = ["FORMATS", "Imported", "Options", "import_file"]
