"""Robots and objects from other tools' files, as arms and props that a rig can place."""

from trocar.apps.importers.importing import Imported, Options, import_file
from trocar.apps.importers.meshes import FORMATS

__all__ = ["FORMATS", "Imported", "Options", "import_file"]
