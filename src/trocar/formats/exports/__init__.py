"""Folders that other simulators load: a model, its meshes, and a README."""

from trocar.formats.exports.export import FORMATS, Export, export, find_rig
from trocar.formats.exports.task import Format, Options, Task

__all__ = ["FORMATS", "Export", "Format", "Options", "Task", "export", "find_rig"]
