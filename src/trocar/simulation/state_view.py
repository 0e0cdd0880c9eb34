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


class StateView:
    """The stretch of an MjData that holds `FIELDS`, the time apart.

    Attributes:
        values: the stretch itself, (n,); writing into it changes the simulation

    Raises:
        RuntimeError: this MuJoCo keeps them elsewhere
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        start, self._parts = data.qpos.ctypes.data, dict[str, slice]()
        end = 0
        for name in FIELDS:
            field = getattr(data, name)
            first = (field.ctypes.data - start) // field.itemsize
            if field.size and first < end:
                raise RuntimeError(f"MuJoCo {mujoco.__version__} keeps {name} in another place")
            self._parts[name] = slice(first, first + field.size)
            end = max(end, first + field.size)
        room = model.nq + model.nv + model.na + model.nv + model.nu
        if end > 2 * room + 64:
            raise RuntimeError(f"MuJoCo {mujoco.__version__} keeps its state in pieces")
        self.values: Array = np.lib.stride_tricks.as_strided(data.qpos, (end,), (8,))

    def part(self, copies: Array, name: str) -> Array:
        """Return one field of copies of the stretch, (..., n) to (..., size of the field)."""
        return copies[..., self._parts[name]]
