"""Robots and objects from other tools' files, as arms and props that a rig can place."""

from trocar.apps.importers.importing import Imported, Options, import_file

__all__ = ["Imported", "Options", "import_file"]
