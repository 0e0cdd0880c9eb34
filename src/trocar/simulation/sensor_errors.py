"""The errors of a world's encoders, cables and registration, drawn anew at each reset."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import mujoco

from trocar.descriptions.records import RigDescription
from trocar.descriptions.robot_errors import RobotErrors
from trocar.modeling.joints import JointTable
from trocar.simulation.parts import Attached, Part
from trocar.simulation.reading_errors import ReadingErrors


class SensorErrors(Part):
    """The errors of one world; `ReadingErrors` computes them for one compiled model.

    Args:
        errors: of all joints

    Attributes:
        readings: of the rig as it is compiled, which its servos and frames stand on
    """

    readings: ReadingErrors

    def __init__(self, errors: RobotErrors) -> None:
        self._errors = errors
        self._before: ReadingErrors | None = None

    def compiled(
        self,
        rig: RigDescription,
        joints: JointTable,
        model: mujoco.MjModel,
        data: mujoco.MjData | SimpleNamespace,
    ) -> ReadingErrors:
        """Return the errors of a model that was compiled; `attach` carries the last one's over."""
        self._before = getattr(self, "readings", None)
        self.readings = ReadingErrors(rig, joints, model, data, self._errors)
        return self.readings

    def attach(self, physics: Attached) -> None:
        """Take the physics; joints keep their errors but those of an exchanged tool's arm."""
        self._physics, self.every = physics, self.readings.every
        self._fresh = bool(physics.exchanged)
        if self._before is not None and physics.exchanged:
            self.readings.go_on(self._before, physics.seed(), physics.exchanged)
            physics.frames.register(self.readings.registration)
        self._before = None

    def begin(self) -> None:
        """Draw the errors of the world's seed."""
        self.readings.draw(self._physics.seed())
        self._physics.frames.register(self.readings.registration)

    def placed(self, arm: str) -> None:
        """Start from the set-points as they are after a reset or a tool exchange."""
        if not arm or self._fresh:
            self._fresh = False
            self.readings.begin()

    def look(self) -> None:
        """Go on to what the motors exert now."""
        physics = self._physics
        self.readings.step(physics.servos.true()[2], physics.journal.period)

    def save(self) -> dict[str, Any]:
        """Return copies of everything that readings depend on beside the physics."""
        return self.readings.save()

    def load(self, state: Mapping[str, Any]) -> None:
        """Restore everything that `save` returned."""
        self.readings.load(state)
        self._physics.frames.register(self.readings.registration)
