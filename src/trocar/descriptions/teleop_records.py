"""What a rig says of a teleoperation: a frozen record in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

TeleopKind = Literal["psm", "ecm"]

#: Share of the master's translation that the dVRK's tool makes. Source: mtsIntuitiveResearchKit.h.
SCALE = 0.2


@dataclass(frozen=True)
class TeleopDescription:
    """One master that moves an instrument, or two that move the endoscope.

    What is left out of a file is as in the dVRK. Source: mtsIntuitiveResearchKit.h
    (TeleOperationPSM), schema dvrk-teleop-PSM.

    Attributes:
        name: "MTMR_PSM1", "MTML_MTMR_ECM", ...
        kind: "psm": one master moves a tool; "ecm": two move the endoscope
        masters: one, or the left and the right one; they need not be arms of the rig
        slave: the arm of the rig that is moved
        scale: share of the masters' translation that is made
        rotation_locked, translation_locked: what does not follow when it begins
        align: whether the master turns as the tool is turned, before it moves it
        orientation_tolerance: largest difference of orientation at which it begins [rad]
        gripper_threshold, roll_threshold: how far a hand must move gripper or roll until it begins;
            0: it begins at once [rad]
        jaw_rate, jaw_rate_after_clutch: fastest that the jaw follows the gripper [rad/s]
        ignore_jaw: whether gripper and jaw have nothing to do with each other
        gripper_zero, gripper_max: angles of the gripper at which the jaw is just shut, and open at
            60 deg [rad]
        source: where the numbers are from
    """

    name: str
    kind: TeleopKind
    masters: tuple[str, ...]
    slave: str
    scale: float = SCALE
    rotation_locked: bool = False
    translation_locked: bool = False
    align: bool = True
    orientation_tolerance: float = math.radians(5.0)
    gripper_threshold: float = math.radians(40.0)
    roll_threshold: float = math.radians(4.0)
    jaw_rate: float = math.radians(720.0)
    jaw_rate_after_clutch: float = math.radians(36.0)
    ignore_jaw: bool = False
    gripper_zero: float = 0.0
    gripper_max: float = math.radians(60.0)
    source: str = ""
