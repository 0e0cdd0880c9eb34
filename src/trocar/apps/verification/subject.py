"""The arm that is verified, and the command line that does it again."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Literal

import numpy as np

from trocar.descriptions.lone_arm import lone_arm_rig
from trocar.descriptions.records import ArmDescription
from trocar.simulation import World

Model = Literal["dvrk", "paper"]


@dataclass(frozen=True, eq=False)
class Subject:
    """An arm under test.

    Attributes:
        name: as the user gave it: a built-in arm or a TOML file
        arm: its description, calibration included
        words: options that choose it on the command line
    """

    name: str
    arm: ArmDescription
    words: tuple[str, ...] = ()

    @property
    def calibrated(self) -> bool:
        """Whether it is no nominal arm: the paper's figures are then another robot's."""
        return self.arm.overlay is not None

    @property
    def simulated(self) -> bool:
        """Whether its file has what a simulation needs, masses and gains."""
        return bool(self.arm.control) and bool(self.arm.bodies)

    @property
    def place(self) -> str:
        """Name of the arm in its world."""
        return lone_arm_rig(self.arm).arms[0].name

    def world(self, model: Model = "dvrk", tip_load_n: float = 0.0) -> World:
        """Return a world of this arm alone.

        Args:
            model: "dvrk": the dVRK's gains and the identified friction; "paper": Table 8's gains
                and the paper's damping; gravity is compensated in both
            tip_load_n: force that turns about the tip [N]
        """
        return World(
            lone_arm_rig(self.arm),
            control=model,
            friction="paper" if model == "paper" else "identified",
            gravity_compensation=True,
            tip_load_n=tip_load_n,
        )

    def command(self, part: str) -> str:
        """Return the command line that runs one part on this arm again."""
        return shlex.join(["trocar", "verify", "--only", part, *self.words])

    def rest(self) -> np.ndarray:
        """Return the joint positions nearest to zero that the limits allow, (n,)."""
        mechanism = self.arm.mechanism
        return np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
