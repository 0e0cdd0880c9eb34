"""The parts of a world beside its arms: grasps, tissue, threads, drivetrains, errors, scripts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from trocar.descriptions.records import RigDescription
from trocar.modeling.joints import JointTable
from trocar.simulation.arm import Arm
from trocar.simulation.frames import Frames
from trocar.simulation.journal import Journal
from trocar.simulation.servos import Servos


@dataclass(frozen=True, eq=False)
class Attached:
    """The compiled physics that the parts of a world act in.

    Attributes:
        rig: the description that was compiled
        joints: its joint table
        model: compiled for this world alone; parts may write into it
        data: the state; forces go into `qfrc_applied` and `xfrc_applied`
        servos: of all arms
        frames: as the robots report them
        true_frames: as they are; the same without errors
        arms: by name
        journal: receives events
        seed: the seed of the last reset
        rng: the generator of random numbers now
        exchanged: the arm whose tool exchange made this model, "" for none
    """

    rig: RigDescription
    joints: JointTable
    model: mujoco.MjModel
    data: mujoco.MjData
    servos: Servos
    frames: Frames
    true_frames: Frames
    arms: Mapping[str, Arm]
    journal: Journal
    seed: Callable[[], int]
    rng: Callable[[], np.random.Generator]
    exchanged: str = ""

    @property
    def timestep(self) -> float:
        """Physics time step [s]."""
        return float(self.model.opt.timestep)


class Part:
    """A part of a world; each method does nothing unless a part overrides it.

    The world calls all parts in the order in which they were added, in one thread. A part changes
    motion by forces, velocities and fields of the model, at steps that depend on nothing but the
    number of physics steps since the reset: then motion is the same however steps are grouped.

    Attributes:
        name: in its world; `World.add` sets it, and commands of the part are entries under it
        every: physics steps between two calls of `look`, 0 for none; read when parts attach and
            when a state is loaded
        before_every: physics steps between two calls of `before_step`, 0 for none; a change between
            0 and 1 counts from the next command or event on
    """

    name: str = ""
    every: int = 0
    before_every: int = 0

    def attach(self, physics: Attached) -> None:
        """Take the physics to act in, and keep what of the part's own state still applies."""

    def begin(self) -> None:
        """Begin anew: a reset, before the arms are placed."""

    def placed(self, arm: str) -> None:
        """Go on after an arm ("" for all) was put somewhere in no time: a reset, a new tool."""

    def before_step(self) -> None:
        """Act before the physics step that leaves each multiple of `before_every`."""

    def look(self) -> None:
        """Act after the physics step that reaches each multiple of `every`."""

    def save(self) -> Any:
        """Return copies of what motion depends on beside the physics, None for nothing."""
        return None

    def load(self, state: Any) -> None:
        """Go on from what `save` returned; the physics is loaded already."""


def steps_in(period_s: float, timestep: float) -> int:
    """Return the physics steps in a period, one at least."""
    return max(1, round(period_s / timestep))
