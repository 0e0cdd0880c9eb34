"""Errors of real robots: of encoders, cables, setup joints and registrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from trocar.descriptions.table import Table, read_table
from trocar.errors import UnknownNameError

PRESETS = Path(__file__).parent / "data" / "errors.toml"
PERFECT = "perfect"
#: Keys of a joint's errors and the dimensions of their units.
DIMENSIONS = {
    "step": ("position", "angle", "length"),
    "offset": ("position", "angle", "length"),
    "noise": ("position", "angle", "length"),
    "backlash": ("position", "angle", "length"),
    "hysteresis": ("position", "angle", "length"),
    "travel": ("position", "angle", "length"),
    "compliance": ("angular compliance", "linear compliance"),
}
#: Source: our own choice; the delay of a congested wireless network. [s]
LONGEST_LATENCY_S = 1.0


@dataclass(frozen=True)
class JointErrors:
    """Errors of one joint [rad or m]: its reading differs from where it is.

    Attributes:
        step: of the encoder; readings are multiples of it
        offset: standard deviation of a constant error of the reading, drawn at each reset
        noise: standard deviation of a potentiometer's reading, drawn every 20 ms
        backlash: by which the motor turns on a reversal before the joint follows
        hysteresis: further part of the motor's motion that is lost after a reversal, gradually
        travel: of the motor, over which the hysteresis is lost
        compliance: of the cables between the encoder and the joint [rad/(N m) or m/N]
    """

    step: float = 0.0
    offset: float = 0.0
    noise: float = 0.0
    backlash: float = 0.0
    hysteresis: float = 0.0
    travel: float = 0.0
    compliance: float = 0.0


@dataclass(frozen=True)
class JointRow:
    """Errors of some joints.

    Attributes:
        arms: names or types of arms; none: of every arm
        joints: names; none: every joint
        errors: of each
    """

    arms: tuple[str, ...]
    joints: tuple[str, ...]
    errors: JointErrors


@dataclass(frozen=True)
class RobotErrors:
    """Errors of all arms of a rig.

    Attributes:
        name: of the preset that they are based on, "rig" without one
        joints: the last row that names a joint applies
        registration: standard deviation along and about each axis of the camera's frame of the
            pose of a PSM's base in it, drawn at each reset [m], [rad]
        latency: age of readings [s]
    """

    name: str
    joints: tuple[JointRow, ...] = ()
    registration: tuple[float, float] = (0.0, 0.0)
    latency: float = 0.0

    def of(self, arm: str, type_: str, joint: str) -> JointErrors:
        """Return the errors of a joint of an arm of a type."""
        for row in reversed(self.joints):
            if (not row.arms or {arm, type_} & set(row.arms)) and (
                not row.joints or joint in row.joints
            ):
                return row.errors
        return JointErrors()


def robot_errors(name: str) -> RobotErrors | None:
    """Return a preset: "lab", "wide", or None for "perfect".

    Raises:
        UnknownNameError: no such preset; the known ones are listed
    """
    table = read_table(PRESETS).without("schema", "source")
    if name not in (PERFECT, *table.entries()):
        raise UnknownNameError("errors", name, (PERFECT, *table.entries()))
    return None if name == PERFECT else _read_errors(table.table(name), RobotErrors(name))


def read_robot_errors(
    rig: Table, joints: Mapping[str, tuple[str, tuple[str, ...]]]
) -> RobotErrors | None:
    """Return the errors of a rig's file, None for none: `errors = "NAME"`, or a table on a preset.

    Args:
        rig: its file
        joints: {arm: its type and joints}

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    if "errors" not in rig:
        return None
    if isinstance(rig.raw("errors"), str):
        return _preset(rig, "errors")
    table = rig.table("errors")
    base = _preset(table, "preset") if "preset" in table else None
    found = _read_errors(table, base or RobotErrors("rig"))
    arms = {*joints, *(type_ for type_, _ in joints.values())}
    for row in found.joints:
        if rogue := [arm for arm in row.arms if arm not in (*arms, "PSM", "ECM", "MTM", "SUJ")]:
            raise table.fail("joint", f"got arm {rogue[0]!r}; allowed: {', '.join(sorted(arms))}")
        reach = [own for arm, (type_, own) in joints.items() if {arm, type_} & set(row.arms)]
        known = {joint for own in reach or [j for _, j in joints.values()] for joint in own}
        if reach and (lost := [joint for joint in row.joints if joint not in known]):
            raise table.fail("joint", f"got {lost[0]!r}; allowed: {', '.join(sorted(known))}")
    return found


def _preset(table: Table, key: str) -> RobotErrors | None:
    try:
        return robot_errors(table.text(key))
    except UnknownNameError as problem:
        raise table.fail(key, str(problem)) from problem


def _read_errors(table: Table, base: RobotErrors) -> RobotErrors:
    rows = table.each("joint", _read_row)
    along, about = base.registration
    found = replace(
        base,
        joints=(*base.joints, *rows),
        registration=(
            table.not_negative("registration", "length", default=along),
            table.not_negative("registration", "angle", default=about),
        ),
        latency=table.quantity("latency", "time", default=base.latency),
    )
    table.done()
    if not 0.0 <= found.latency <= LONGEST_LATENCY_S:
        raise table.fail(
            "latency", f"got {found.latency:g} s; allowed: 0 to {LONGEST_LATENCY_S:g} s"
        )
    return found


def _read_row(row: Table) -> JointRow:
    values = {name: row.not_negative(name, *units) for name, units in DIMENSIONS.items()}
    if values["hysteresis"] and not values["travel"]:
        raise row.fail("travel", "is missing; allowed: more than 0, as there is hysteresis")
    return JointRow(row.texts("arms"), row.texts("joints"), JointErrors(**values))
