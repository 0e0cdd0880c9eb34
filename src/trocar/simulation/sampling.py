"""Samples of every arm at once: one product for all joints takes as long as one for an arm's."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.simulation.arm import Arm
from trocar.simulation.drives import Drives
from trocar.simulation.records import ArmSample
from trocar.simulation.servos import ServoInputs

Array = NDArray[np.float64]


class Sampling:
    """Reads every arm out of the physics, as `Arm.readings` does for one.

    Args:
        data: the physics
        servos: what the motors are told
        drives: {arm: its motors}
    """

    def __init__(
        self, data: mujoco.MjData, servos: ServoInputs, drives: Mapping[str, Drives]
    ) -> None:
        self._data, self._servos = data, servos
        self._live = {name: d for name, d in drives.items() if not d.welded}
        bindings = [d.binding for d in self._live.values()]
        self._joints: dict[str, slice] = {}
        self._drive = np.zeros((sum(len(b.actuators) for b in bindings), len(data.qpos)))
        self._rates = np.zeros((len(self._drive), len(data.qvel)))
        first = 0
        for name, b in zip(self._live, bindings, strict=True):
            part = self._joints[name] = slice(first, first + len(b.actuators))
            self._drive[part, b.qpos] = b.drive
            self._rates[part, b.dof] = b.drive
            first = part.stop
        none = [np.zeros(0, np.intp)]
        self._actuators = np.concatenate([b.actuators for b in bindings] or none)
        self._act = np.concatenate([b.act for b in bindings] or none)
        self._revision = -1
        self._law = np.zeros((0, 4))

    def take(self, arms: Mapping[str, Arm]) -> dict[str, ArmSample]:
        """Return {arm: copies of what its readings are computed from}."""
        data, servos = self._data, self._servos
        q, qd = self._drive @ data.qpos, self._rates @ data.qvel
        effort = self._efforts(q, qd)
        load = servos.holding[self._actuators]
        found: dict[str, ArmSample] = {}
        for name, arm in arms.items():
            part = self._joints.get(name)
            found[name] = arm.sample(
                None if part is None else (q[part], qd[part], effort[part], load[part])
            )
        return found

    def _efforts(self, q: Array, qd: Array) -> Array:
        """As `Drives.servo_efforts`, (n_joints,)."""
        servos = self._servos
        if servos.revision != self._revision:
            self._revision = servos.revision
            laws = [d.law() for d in self._live.values()]
            self._law = np.concatenate(laws) if laws else np.zeros((0, 4))
        p, i, d, limit = self._law.T
        told = servos.table[self._actuators]
        servo = p * (told[:, 0] - q) + i * self._data.act[self._act] + d * (told[:, 1] - qd)
        return np.minimum(np.maximum(servo + told[:, 2], -limit), limit)
