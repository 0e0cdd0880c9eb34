"""What a dVRK configuration says: frozen records in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Generation = Literal["Classic", "Si"]
Convention = Literal["modified", "standard"]
Gains = tuple[float, float, float]


@dataclass(frozen=True)
class Row:
    """A row of Denavit-Hartenberg parameters.

    Attributes:
        name: of the joint, "" where the file has none
        kind: revolute or prismatic
        moves: whether a joint moves it
        a, alpha, d, theta: its constant parts, the joint's offset included [m, rad]
        lower, upper, effort: limits, None where the file has none
    """

    name: str
    kind: Literal["revolute", "prismatic"]
    moves: bool
    a: float
    alpha: float
    d: float
    theta: float
    lower: float | None
    upper: float | None
    effort: float | None


@dataclass(frozen=True)
class Chain:
    """Rows from the base outward, and their convention."""

    convention: Convention
    rows: tuple[Row, ...]


@dataclass(frozen=True, eq=False)
class SetupArm:
    """Where one arm of a patient cart is held.

    Attributes:
        name: of the arm that it carries: "PSM1"
        file: where it stands
        generation: of the setup joints
        chain: from the column to the last joint, None where it is fixed or the dVRK's own
        column: T_cart_column (4, 4)
        tool_origin: T_tip_base, the carried arm's base on the last row (4, 4)
        q: where the joints stand, None where the file does not say [m, rad]
        fixed: T_cart_base of an arm on a mount of its own (4, 4), None where joints hold it
        potentiometers: {key: numbers} of their calibration
    """

    name: str
    file: str
    generation: Generation
    chain: Chain | None
    column: Array
    tool_origin: Array
    q: Array | None
    fixed: Array | None
    potentiometers: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Base:
    """Where an arm's base stands.

    Attributes:
        on: "setup": `name` of the setup arm that holds it; "frame": in the frame called `name`;
            "nothing": the file does not say
        name: see above
        pose: T_frame_base (4, 4) of "frame"
    """

    on: Literal["setup", "frame", "nothing"]
    name: str = ""
    pose: Array | None = None


@dataclass(frozen=True, eq=False)
class Instrument:
    """What a tool's file says.

    Attributes:
        file: where it stands
        rows: of roll, wrist pitch and wrist yaw, and the limits of the jaw as a fourth
        coupling: q = A q_actuator, (4, 4)
    """

    file: str
    rows: tuple[Row, ...]
    coupling: Array


@dataclass(frozen=True, eq=False)
class LabArm:
    """A PSM, an ECM or an MTM.

    Attributes:
        name, type, generation: who it is
        place: its entry in the system's file, for messages
        file: the arm's own file, "" where it is the dVRK's and was not found
        chain: its kinematics, None where they are the dVRK's own and were not found
        tool: "" where the file leaves it open
        instrument: what the tool's own file says, None where it is not here
        endoscope: of an ECM
        gains: {joint: (P, I, D)}, None where no file has them
        base: where it stands
    """

    name: str
    type: Literal["PSM", "ECM", "MTM"]
    generation: Generation
    place: str
    file: str
    chain: Chain | None
    tool: str
    endoscope: str
    gains: Mapping[str, Gains] | None
    base: Base
    instrument: Instrument | None = None


@dataclass(frozen=True)
class LabTeleop:
    """A teleoperation as the file has it; `given` are the entries of a rig's [[teleop]]."""

    place: str
    masters: tuple[str, ...]
    slave: str
    kind: Literal["psm", "ecm"]
    given: Mapping[str, float | bool]


@dataclass(frozen=True, eq=False)
class Lab:
    """A whole system.

    Attributes:
        file: the system's file
        arms, setup, teleops: what it has
        reference_arm: arm on setup joints whose tip frame the poses of the others are in
        said: what the reader should know
        idle, unknown: "FILE: KEY" that have no counterpart, and that nobody knows
    """

    file: str
    arms: tuple[LabArm, ...]
    setup: tuple[SetupArm, ...]
    reference_arm: str
    teleops: tuple[LabTeleop, ...]
    said: tuple[str, ...]
    idle: tuple[str, ...]
    unknown: tuple[str, ...]
