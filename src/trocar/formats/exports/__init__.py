"""Folders that other simulators load: a model, its meshes, and a README."""

from trocar.formats.exports.export import FORMATS, Export, export, find_rig
from trocar.formats.exports.task import ExportOptions, ExportTask, Format

__all__ = ["FORMATS", "Export", "ExportOptions", "ExportTask", "Format", "export", "find_rig"]
