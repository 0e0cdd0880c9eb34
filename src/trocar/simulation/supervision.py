"""Gravity compensation of all arms, renewed every 20 ms."""

from __future__ import annotations

from trocar.simulation.drives import Drivetrains
from trocar.simulation.gravity_compensation import GravityCompensation
from trocar.simulation.parts import Attached, Part, steps_in
from trocar.simulation.tip_load import PERIOD_S as LOAD_PERIOD_S

#: Gravity compensation is renewed this often. Source: our own choice; at 0.6 rad/s a PSM's gravity
#: torque changes by less than 0.02 N m in this time, which its servos answer with 0.2 mrad. [s]
GRAVITY_PERIOD_S = 0.02


class Supervision(Part):
    """Feeds forward what holds the arms, and watches masters' grippers.

    Args:
        drivetrains: whose springs, cables and biases are held as well
    """

    def __init__(self, drivetrains: Drivetrains) -> None:
        self._drivetrains = drivetrains

    def attach(self, physics: Attached) -> None:
        """Take the physics that the arms are in."""
        self._physics, self._servos = physics, physics.servos
        table = physics.joints
        self._coefficients = (
            None if table.gravity is None else GravityCompensation(table.gravity, table.drive)
        )
        load = steps_in(LOAD_PERIOD_S, physics.timestep)
        self.before_every = load * max(1, round(GRAVITY_PERIOD_S / LOAD_PERIOD_S))
        self._grippers = [a.gripper for a in physics.arms.values() if a.gripper is not None]

    def before_step(self) -> None:
        """Renew the holding efforts, look at grippers."""
        self.balance()
        for gripper in self._grippers:
            gripper.watch()

    def balance(self, arm: str = "") -> None:
        """Feed forward what holds every motor's load, or only those of one arm, where they are."""
        holding = self._servos.holding
        kept = holding.copy() if arm else None
        self._physics.true_frames.holding_efforts(holding)
        self._add_springs()
        self._take_coefficients()
        if kept is not None:
            rows = self._physics.joints.arms[arm].rows
            kept[rows] = holding[rows]
            holding[:] = kept
        self._servos.write_efforts()

    def balance_at_rest(self) -> None:
        """Feed forward what holds every motor's load from the bias forces of arms at rest."""
        data = self._physics.data
        self._physics.true_frames.joint_efforts(data.qfrc_bias, self._servos.holding)
        self._add_springs()
        self._take_coefficients()
        self._servos.write_efforts()

    def _take_coefficients(self) -> None:
        """Have the efforts that controllers with coefficients compute, in place of the true."""
        if self._coefficients is not None:
            self._coefficients.write(self._servos.qpos(), self._servos.holding)

    def _add_springs(self) -> None:
        drives = self._drivetrains.drives
        if drives is not None:
            self._servos.holding += drives.holding(self._physics.data.qpos)
