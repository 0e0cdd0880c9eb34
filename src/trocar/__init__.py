"""trocar: the da Vinci Research Kit in Python.

`World`, `Batch`, `build`, `load_rig` and `load_arm` are loaded when they are first used, so that
importing trocar stays instant.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.descriptions import load_arm as load_arm
    from trocar.descriptions import load_rig as load_rig
    from trocar.modeling.build import build as build
    from trocar.simulation import Batch as Batch
    from trocar.simulation import World as World

__version__ = "0.1.0"
__all__ = ["Batch", "World", "__version__", "build", "load_arm", "load_rig"]

_HOMES = {
    "Batch": "trocar.simulation",
    "World": "trocar.simulation",
    "build": "trocar.modeling.build",
    "load_arm": "trocar.descriptions",
    "load_rig": "trocar.descriptions",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'trocar' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
