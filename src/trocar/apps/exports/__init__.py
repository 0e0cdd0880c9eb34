"""Folders that other simulators load: a model, its meshes, and a README that says what they are."""

from trocar.apps.exports.export import Export, export
from trocar.apps.exports.formats import FORMATS
from trocar.apps.exports.subject import find_rig
from trocar.apps.exports.task import Options

__all__ = ["FORMATS", "Export", "Options", "export", "find_rig"]
