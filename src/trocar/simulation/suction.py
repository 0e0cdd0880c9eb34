"""A suction cup at an instrument's tip, which pulls free objects: the pattern of a new part."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.errors import UnknownNameError
from trocar.inputs import check_numbers
from trocar.simulation.journal import command
from trocar.simulation.parts import Attached, Part

Array = NDArray[np.float64]

#: Pressure below the room's of hospital suction. Source: placeholder; regulators of wall suction
#: end near 80 kPa. [Pa]
PRESSURE_PA = 60e3
#: Radius of the opening: an instrument for cannulas of 8 mm. Source: placeholder. [m]
RADIUS_M = 0.003
#: A gap of this width leaks everything. Source: placeholder. [m]
GAP_M = 0.001
#: Least gap of a cup. Source: our own choice. [m]
LEAST_GAP_M = 1e-6
#: The opening is looked for so far behind its rim: contacts press objects into it [m].
DEPTH_M = 1e-3


class SuctionState(NamedTuple):
    """Saved state of a cup.

    Attributes:
        running: whether the pump runs
        own: wrenches that others apply to each body that the cup may pull, (n, 6) [N, N m]
        written: the wrenches as the cup wrote them, (n, 6)
    """

    running: bool
    own: Array
    written: Array


class Suction(Part):
    """A cup at an arm's tip, open along the tip's z axis.

    What lies at a gap d ahead of the opening is pulled by p pi r^2 (1 - d / gap) against the axis,
    where the axis meets its surface. The reaction acts on the link that carries the tip.
    `World.add("suction", Suction("PSM1"))` adds it; `start` and `stop` switch the pump.

    Args:
        arm: whose tip it is at
        ahead_m: from the tip to the opening along the axis: beyond what the tool carries [m]
        pressure_pa: below the room's [Pa]
        radius_m: of the opening [m]
        gap_m: at which the cup no longer pulls [m]

    Attributes:
        force: most that it pulls with [N]
        held: name of the object that it pulls, "" for none, as of the last physics step

    Raises:
        InputError: a number that is not finite or is below 0, a gap below 1 um
    """

    def __init__(
        self,
        arm: str,
        ahead_m: float = 0.0,
        pressure_pa: float = PRESSURE_PA,
        radius_m: float = RADIUS_M,
        gap_m: float = GAP_M,
    ) -> None:
        given = check_numbers([ahead_m, pressure_pa, radius_m], (3,), "Suction", low=0.0)
        ahead, pressure, radius = given.tolist()
        gap = float(check_numbers(gap_m, (), "Suction: gap_m", low=LEAST_GAP_M))
        self.arm, self._ahead, self._gap = arm, ahead, gap
        self.force = pressure * math.pi * radius**2
        self.held, self._running = "", False
        #: Of each body that the cup may pull, the tip's last: the wrenches that others set, and
        #: what the cup wrote, (n, 6).
        self._own = self._written = np.zeros((0, 6))

    def attach(self, physics: Attached) -> None:
        """Find the tip's and the objects' shapes.

        Raises:
            UnknownNameError: the rig has no such arm
        """
        if physics.arms.get(self.arm) is None:
            raise UnknownNameError("arm", self.arm, physics.arms, f"rig {physics.rig.name}")
        self._model, self._data = physics.model, physics.data
        self._journal, self._source, self._prefix = physics.journal, self.name, ""
        arm = physics.rig.arm(self.arm)
        names = [prop.name for prop in physics.rig.objects if prop.joint is None]
        self._tip, self._site = physics.joints.arms[self.arm].carrier(arm, arm.arm.mechanism.tip)
        self._names = names
        self._bodies = [physics.model.body(name).id for name in names] + [self._tip]
        if len(self._own) != len(self._bodies):
            self._own = physics.data.xfrc_applied[self._bodies].copy()
        self._written = physics.data.xfrc_applied[self._bodies].copy()

    @command
    def start(self) -> None:
        """Start the pump."""
        self._running, self.before_every = True, 1

    @command
    def stop(self) -> None:
        """Stop the pump; what it held falls."""
        self.begin()

    def begin(self) -> None:
        """Begin anew, with the pump off."""
        self._running, self.before_every, self.held = False, 0, ""
        self._write(np.zeros_like(self._own))

    def before_step(self) -> None:
        """Pull what lies ahead of the opening."""
        model, data = self._model, self._data
        mujoco.mj_kinematics(model, data)
        turn = data.xmat[self._tip].reshape(3, 3)
        axis = turn @ self._site[:3, 2]
        opening = data.xpos[self._tip] + turn @ self._site[:3, 3] + self._ahead * axis
        start, shape = opening - DEPTH_M * axis, np.zeros(1, np.int32)
        found = mujoco.mj_ray(model, data, start, axis, None, True, self._tip, shape)
        body = int(model.geom_bodyid[shape[0]]) if found >= 0.0 else -1
        gap = found - DEPTH_M
        wrenches, self.held = np.zeros_like(self._own), ""
        if body in self._bodies and gap < self._gap:
            row = self._bodies.index(body)
            self.held = self._names[row]
            pull = -self.force * (1.0 - max(gap, 0.0) / self._gap) * axis
            for k, sign in ((row, 1.0), (-1, -1.0)):
                lever = opening + gap * axis - data.xipos[self._bodies[k]]
                wrenches[k] = *(sign * pull), *np.cross(lever, sign * pull)
        self._write(wrenches)

    def _write(self, wrenches: Array) -> None:
        """Add wrenches to those that others have set since the last step."""
        now = self._data.xfrc_applied[self._bodies]
        changed = (now != self._written).any(axis=1)
        self._own[changed] = now[changed]
        self._written = self._own + wrenches
        self._data.xfrc_applied[self._bodies] = self._written

    def save(self) -> SuctionState:
        """Return whether the pump runs, and what the cup has written."""
        return SuctionState(self._running, self._own.copy(), self._written.copy())

    def load(self, state: SuctionState) -> None:
        """Go on from what `save` returned."""
        self._running, self.before_every = state.running, int(state.running)
        self._own, self._written = state.own.copy(), state.written.copy()
