"""Tracking errors of all arms: those that left their set-points are in FAULT."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.parts import Attached, Part, steps_in

Array = NDArray[np.float64]

#: Tracking errors are looked at this often. Source: our own choice. [s]
PERIOD_S = 0.02
#: Set-points that moved farther since the last look may have made a step, whose error is largest at
#: its beginning. Source: our own choice; in this time the fastest joint moves by 0.1 rad, far less
#: than its tolerance. [rad or m]
STEP = 0.015


class Tracking(Part):
    """Switches off arms whose joints, or whose instrument's discs, left their set-points.

    Source: SAW, mtsPID.cpp: errors are those of actuators, which an instrument couples.
    """

    def __init__(self) -> None:
        #: Positions and set-points at the last look, (J,) each; none after they were put somewhere.
        self._before: tuple[Array, ...] = ()

    def attach(self, physics: Attached) -> None:
        """Take the physics that the arms are in."""
        self._physics, self._servos = physics, physics.servos
        self.before_every = steps_in(PERIOD_S, physics.timestep)

    def placed(self, arm: str) -> None:  # noqa: ARG002  as every part
        """Forget where joints and set-points were."""
        self._before = ()

    def save(self) -> tuple[Array, ...]:
        """Return positions and set-points at the last look; they are never written to."""
        return self._before

    def load(self, state: tuple[Array, ...]) -> None:
        """Restore what `save` returned."""
        self._before = state

    def before_step(self) -> None:
        """Look at tracking errors, of a step of set-points from where joints were before it."""
        servos, before = self._servos, self._before
        q, beyond = servos.beyond()
        setpoint = servos.setpoint[:, 0].copy()
        self._before = q, setpoint
        if beyond is None and before:
            moved = setpoint - before[1]
            far = moved.dot(moved) > 0.99 * STEP**2  # quick, and true where any is far
            if far and abs(moved).max() > STEP:
                _, beyond = servos.beyond(before[0])
        if beyond is None:
            return
        for arm in self._physics.arms.values():
            motors, described = arm.runtime.motors, arm.description
            if motors.welded:
                continue
            coupled = described.own_joints - 3 if described.coupling else 0
            joints = [
                f"{joint.name}{' disc' if coupled and k > 2 else ''} ({found:.3g} {unit},"
                f" allowed {joint.tracking_tolerance:g})"
                for k, joint in enumerate(described.joints)
                if (found := beyond[motors.index.rows.start + k])
                for unit in ("m" if joint.kind == "prismatic" else "rad",)
            ]
            if joints:
                arm.runtime.states.fault(f"tracking error of {', '.join(joints)}")
