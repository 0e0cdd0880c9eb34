"""What the page needs to know of an arm beside its motion: limits, units, gains, brakes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trocar.descriptions import fitting_tools

if TYPE_CHECKING:
    from trocar.simulation import World

JAW = "jaw"


@dataclass(frozen=True)
class Unit:
    """How people read a quantity: what is shown is what is kept times `scale`."""

    text: str
    scale: float
    effort_text: str
    gain_text: str


ANGLE = Unit("deg", 180 / np.pi, "N m", "N m/rad")
LENGTH = Unit("mm", 1000.0, "N", "N/m")


UNLIMITED = 100.0
"""Largest effort offered when efforts are not limited [N m or N]. Source: our own choice."""


@dataclass(frozen=True)
class JointSheet:
    """One joint: limits [rad or m], largest effort [N m or N], gains (p, i, d) in SI units.

    A gripper has no motor; its slider is a person's fingers.
    """

    name: str
    unit: Unit
    lower: float
    upper: float
    effort_max: float
    gains: tuple[float, float, float]
    is_gripper: bool = False

    @property
    def is_jaw(self) -> bool:
        """Whether this is the jaw, which has commands of its own."""
        return self.name == JAW


@dataclass(frozen=True)
class ArmSheet:
    """One arm: its joints with the jaw last, the names of its poses, whether it has brakes.

    `tool` is the mounted one, "" when there is none; `tools` are those that fit, none for an arm
    that takes no tool.
    """

    name: str
    type: str
    joints: tuple[JointSheet, ...]
    poses: tuple[str, ...]
    has_brakes: bool
    gravity_compensation: bool
    tool: str
    tools: tuple[str, ...]


def read_sheet(world: World, name: str) -> ArmSheet:
    """Read an arm's sheet; to be called where the world may be called."""
    arm = world.arm(name)
    kinds = [joint.kind for joint in arm.description.mechanism.joints]
    joints = tuple(
        JointSheet(
            name=joint,
            unit=LENGTH if kinds[k] == "prismatic" else ANGLE,
            lower=float(arm.lower[k]),
            upper=float(arm.upper[k]),
            effort_max=_effort_max(float(arm.effort_limit[k])),
            gains=arm.gains(joint),
            is_gripper=arm.gripper is not None and joint == arm.joint_names[-1],
        )
        for k, joint in enumerate(arm.joint_names)
    )
    return ArmSheet(
        name=arm.name,
        type=arm.type,
        joints=joints,
        poses=tuple(arm.poses),
        has_brakes=bool(arm.brakes),
        gravity_compensation=arm.gravity_compensation,
        tool=arm.tool,
        tools=fitting_tools(arm.description),
    )


def _effort_max(limit: float) -> float:
    return min(limit, UNLIMITED)
