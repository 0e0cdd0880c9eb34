"""Teleoperations of a rig: pairs of a master and the arm that it moves, with settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, cast, get_args

from trocar.descriptions.keys import key
from trocar.descriptions.table import Table

TeleopKind = Literal["psm", "ecm"]
KINDS: tuple[str, ...] = get_args(TeleopKind)

#: Ratio of the tool's translation to the master's. Source: mtsIntuitiveResearchKit.h.
SCALE = 0.2


@dataclass(frozen=True)
class TeleopMasters:
    """Keys of the masters of a teleoperation.

    Attributes:
        master: an MTM of the rig, or a real one
        masters: the left and the right one
    """

    master: str = field(default="", metadata=key(of=("psm",), default=...))
    masters: tuple[str, ...] = field(default=(), metadata=key(of=("ecm",)))


@dataclass(frozen=True)
class TeleopDescription:
    """One master that moves an instrument, or two that move the endoscope.

    Defaults are the dVRK's. Source: mtsIntuitiveResearchKit.h (TeleOperationPSM), schema
    dvrk-teleop-PSM.

    Attributes:
        name: default: masters and slave, as `MTMR_PSM1`, `MTML_MTMR_ECM`
        kind: `psm`: one master moves a tool; `ecm`: two move the endoscope
        masters: one, or the left and the right one; they need not be arms of the rig
        slave: the arm of the rig that is moved
        scale: ratio of the slave's translation to the masters'
        rotation_locked, translation_locked: degrees of freedom that do not follow at first
        align: whether the master aligns with the tool before it moves it
        orientation_tolerance: largest difference of orientation at the start [rad]
        gripper_threshold, roll_threshold: motion of the hand's gripper or roll that starts the
            teleoperation; 0: it starts at once [rad]
        jaw_rate, jaw_rate_after_clutch: highest speed of the jaw as it follows the gripper [rad/s]
        ignore_jaw: whether the gripper leaves the jaw alone
        gripper_zero, gripper_max: gripper angles of the closed and of the wide open jaw [rad]
        source: of the numbers
    """

    name: str = field(metadata=key(default=""))
    kind: TeleopKind = field(metadata=key())
    masters: tuple[str, ...]
    slave: str = field(metadata=key())
    scale: float = field(default=SCALE, metadata=key(above=0.0, most=1.0))
    rotation_locked: bool = field(default=False, metadata=key())
    translation_locked: bool = field(default=False, metadata=key())
    align: bool = field(default=True, metadata=key())
    orientation_tolerance: float = field(
        default=math.radians(5.0), metadata=key("angle", least=0.0)
    )
    gripper_threshold: float = field(default=math.radians(40.0), metadata=key("angle", least=0.0))
    roll_threshold: float = field(default=math.radians(4.0), metadata=key("angle", least=0.0))
    jaw_rate: float = field(
        default=math.radians(720.0), metadata=key("angular velocity", above=0.0)
    )
    jaw_rate_after_clutch: float = field(
        default=math.radians(36.0), metadata=key("angular velocity", above=0.0)
    )
    ignore_jaw: bool = field(default=False, metadata=key())
    gripper_zero: float = field(default=0.0, metadata=key("angle", least=0.0))
    gripper_max: float = field(default=math.radians(60.0), metadata=key("angle", least=0.0))
    source: str = field(default="", metadata=key())


def read_teleop(row: Table, types: Mapping[str, str]) -> TeleopDescription:
    """Read a teleoperation of a rig.

    Args:
        row: its table
        types: {arm of the rig: its type}

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    kind = cast(TeleopKind, row.text("kind", allowed=KINDS))
    masters = _masters(row, kind, types)
    able = [name for name, type_ in types.items() if type_ == kind.upper()]
    slave = row.text("slave")
    row.known("slave", slave, able or [f"none, for this rig has no {kind.upper()}"])
    teleop = row.record(
        TeleopDescription,
        kind=kind,
        masters=masters,
        slave=slave,
        defaults={"name": "_".join((*masters, slave))},
    )
    if teleop.gripper_zero >= teleop.gripper_max:
        raise row.fail(
            "gripper_zero",
            f"got {teleop.gripper_zero:g} rad; allowed: below gripper_max, {teleop.gripper_max:g}",
        )
    return teleop


def _masters(row: Table, kind: TeleopKind, types: Mapping[str, str]) -> tuple[str, ...]:
    given = row.record(TeleopMasters, kind)
    key, masters = ("master", (given.master,)) if kind == "psm" else ("masters", given.masters)
    if kind == "ecm" and len(set(masters)) != 2:
        raise row.fail(key, f"got {list(masters)}; allowed: the left and the right master")
    for name in masters:
        if not name or types.get(name, "MTM") != "MTM":
            raise row.fail(key, f"got {name!r}; allowed: an MTM, or a name that no arm has")
    return masters
