"""Errors of real robots: of encoders, cables, setup joints and registrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from trocar.descriptions.keys import key
from trocar.descriptions.table import Table, read_table
from trocar.errors import UnknownNameError

PRESETS = Path(__file__).parent / "data" / "errors.toml"
PERFECT = "perfect"
#: Dimensions of a joint's readings.
POSITION = ("position", "angle", "length")
#: Source: our own choice; the delay of a congested wireless network. [s]
LONGEST_LATENCY_S = 1.0


@dataclass(frozen=True)
class JointErrors:
    """Errors of one joint: its reading differs from its position.

    Attributes:
        step: resolution of the encoder: readings are multiples of it [rad or m]
        offset: standard deviation of a constant error, drawn at each reset; of setup joints,
            too [rad or m]
        noise: standard deviation of a potentiometer's reading, drawn every 20 ms [rad or m]
        backlash: width: after a reversal the motor turns by it before the joint follows [rad or m]
        hysteresis, travel: further motion lost after a reversal, gradually over `travel` of the
            motor: cables that slip on pulleys [rad or m]
        compliance: of the cables: the joint lags by it times the motor's effort, within 20 ms
            [rad/(N m) or m/N]
    """

    step: float = field(default=0.0, metadata=key(*POSITION, least=0.0))
    offset: float = field(default=0.0, metadata=key(*POSITION, least=0.0))
    noise: float = field(default=0.0, metadata=key(*POSITION, least=0.0))
    backlash: float = field(default=0.0, metadata=key(*POSITION, least=0.0))
    hysteresis: float = field(default=0.0, metadata=key(*POSITION, least=0.0))
    travel: float = field(default=0.0, metadata=key(*POSITION, least=0.0))
    compliance: float = field(
        default=0.0, metadata=key("angular compliance", "linear compliance", least=0.0)
    )


@dataclass(frozen=True)
class JointRow:
    """Errors of some joints.

    Attributes:
        arms, joints: names or types of arms, names of joints; all when omitted
        errors: of each
    """

    arms: tuple[str, ...] = field(metadata=key(default=()))
    joints: tuple[str, ...] = field(metadata=key(default=()))
    errors: JointErrors


@dataclass(frozen=True)
class RobotErrorKeys:
    """Keys of the table of a rig's errors.

    Attributes:
        preset: name of the errors that these are added to
        along, about: standard deviation of the reported pose of the camera's frame, along and about
            each of its axes; one draw for each PSM at each reset [m], [rad]
        latency: age of readings, in steps of 5 ms; set-points act at once [s]
    """

    preset: str = field(default="", metadata=key())
    along: float = field(default=0.0, metadata=key("length", name="registration", least=0.0))
    about: float = field(default=0.0, metadata=key("angle", name="registration", least=0.0))
    latency: float = field(
        default=0.0, metadata=key("time", least=0.0, most=LONGEST_LATENCY_S, shown="s")
    )


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
    usual = dict(zip(("along", "about"), base.registration, strict=True))
    found = table.record(RobotErrorKeys, defaults={**usual, "latency": base.latency})
    table.done()
    return replace(
        base,
        joints=(*base.joints, *rows),
        registration=(found.along, found.about),
        latency=found.latency,
    )


def _read_row(row: Table) -> JointRow:
    errors = row.record(JointErrors)
    if errors.hysteresis and not errors.travel:
        raise row.fail("travel", "is missing; allowed: more than 0, as there is hysteresis")
    return row.record(JointRow, errors=errors)
