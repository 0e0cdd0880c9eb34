"""Tracking errors: an arm whose joint does not follow its set-point is switched off."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.arm import Arm
from trocar.simulation.drives import Drives
from trocar.simulation.servos import ServoInputs

Array = NDArray[np.float64]


class Supervision:
    """Compares every servo's set-point with what is measured."""

    def __init__(
        self,
        qpos: Array,
        servos: ServoInputs,
        drives: Mapping[str, Drives],
        arms: Mapping[str, Arm],
    ) -> None:
        self._qpos, self._servos, self._arms = qpos, servos, arms
        self._drives = {name: d for name, d in drives.items() if not d.welded}
        count = len(servos.table)
        self._measure = np.zeros((count, len(qpos)))
        for d in self._drives.values():
            self._measure[np.ix_(d.binding.actuators, d.binding.qpos)] = d.binding.drive
        self._error, self._share = np.zeros(count), np.zeros(count)
        self._told = servos.table[:, 0]
        self._grippers = [arm.gripper for arm in arms.values() if arm.gripper is not None]

    def check(self) -> None:
        """Put arms with a joint beyond its tolerance into FAULT; see which grippers are shut."""
        for gripper in self._grippers:
            gripper.watch()
        error = self._error
        self._measure.dot(self._qpos, error)
        np.subtract(error, self._told, error)
        np.divide(error, self._servos.tolerance, self._share)
        if self._share.dot(self._share) < 1.0:  # then none is beyond, and it is the usual case
            return
        np.abs(error, error)
        if (error > self._servos.tolerance).any():
            self._trip()

    def _trip(self) -> None:
        beyond = self._error > self._servos.tolerance
        for name, d in self._drives.items():
            ids = d.binding.actuators
            joints = [
                f"{joint.name} ({self._error[i]:.3g} {unit}, allowed {joint.tracking_tolerance:g})"
                for i, joint in zip(ids, d.arm.joints, strict=True)
                if beyond[i]
                for unit in ("m" if joint.kind == "prismatic" else "rad",)
            ]
            if joints:
                self._arms[name].fault(f"tracking error of {', '.join(joints)}")
