"""trocar: the da Vinci Research Kit in Python.

Each name is loaded when it is first used, so that importing trocar stays instant.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.descriptions import load_arm as load_arm
    from trocar.descriptions import load_rig as load_rig
    from trocar.descriptions.catalogue import load_scene as load_scene
    from trocar.learning.task_env import make as make
    from trocar.modeling.build import build as build
    from trocar.recording import record as record
    from trocar.rendering import Endoscope as Endoscope
    from trocar.simulation import Batch as Batch
    from trocar.simulation import World as World
    from trocar.viewer import show as show

__version__ = "0.1.0"
__all__ = [
    "Batch",
    "Endoscope",
    "World",
    "__version__",
    "build",
    "load_arm",
    "load_rig",
    "load_scene",
    "make",
    "record",
    "show",
]

#: Module and name of each.
_HOMES = {
    "Batch": ("trocar.simulation", "Batch"),
    "Endoscope": ("trocar.rendering", "Endoscope"),
    "World": ("trocar.simulation", "World"),
    "build": ("trocar.modeling.build", "build"),
    "load_arm": ("trocar.descriptions", "load_arm"),
    "load_rig": ("trocar.descriptions", "load_rig"),
    "load_scene": ("trocar.descriptions.catalogue", "load_scene"),
    "make": ("trocar.learning.task_env", "make"),
    "record": ("trocar.recording", "record"),
    "show": ("trocar.viewer", "show"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'trocar' has no attribute {name!r}")
    module, own = _HOMES[name]
    return getattr(import_module(module), own)


def __dir__() -> list[str]:
    return sorted(__all__)


# Gymnasium that is imported later registers the environments then.
if "gymnasium" in sys.modules:
    import_module("trocar.learning.ids").register()
else:
    import_module("trocar_gymnasium")
