"""Teleoperation from TOML: which master moves which arm of a rig, and how."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import cast, get_args

from trocar.descriptions.records import RigArm
from trocar.descriptions.table import Table
from trocar.descriptions.teleop_records import SCALE, TeleopDescription, TeleopKind

KINDS: tuple[str, ...] = get_args(TeleopKind)
#: Of a record's angles and rates: what it is called in a file, and its dimension.
ANGLES = {
    "orientation_tolerance": "angle",
    "gripper_threshold": "angle",
    "roll_threshold": "angle",
    "jaw_rate": "angular velocity",
    "jaw_rate_after_clutch": "angular velocity",
    "gripper_zero": "angle",
    "gripper_max": "angle",
}


def read_teleops(rows: Iterable[Table], arms: Sequence[RigArm]) -> tuple[TeleopDescription, ...]:
    """Return a rig's teleoperations.

    Raises:
        DescriptionError: an unknown kind, key or unit, a name used twice, an arm that cannot do
            what is asked of it
    """
    found: list[TeleopDescription] = []
    for row in rows:
        teleop = _read_teleop(row, arms)
        if teleop.name in [other.name for other in found]:
            raise row.fail("name", f"got {teleop.name!r} a second time")
        found.append(teleop)
    return tuple(found)


def _read_teleop(row: Table, arms: Sequence[RigArm]) -> TeleopDescription:
    kind = cast(TeleopKind, row.text("kind", allowed=KINDS))
    masters = _masters(row, kind, {arm.name: arm.arm.type for arm in arms})
    slave = row.text("slave")
    wanted = kind.upper()
    able = [arm.name for arm in arms if arm.arm.type == wanted]
    if slave not in able:
        known = ", ".join(able) or f"none, for this rig has no {wanted}"
        raise row.fail("slave", f"got {slave!r}; allowed: {known}")
    scale = row.number("scale", SCALE)
    if not 0.0 < scale <= 1.0:
        raise row.fail("scale", f"got {scale:g}; allowed: above 0 to 1")
    teleop = TeleopDescription(
        name=row.text("name", "_".join((*masters, slave))),
        kind=kind,
        masters=masters,
        slave=slave,
        scale=scale,
        rotation_locked=row.flag("rotation_locked", False),
        translation_locked=row.flag("translation_locked", False),
        align=row.flag("align", True),
        ignore_jaw=row.flag("ignore_jaw", False),
        source=row.text("source", ""),
        **_angles(row),
    )
    if teleop.gripper_zero >= teleop.gripper_max:
        raise row.fail(
            "gripper_zero",
            f"got {teleop.gripper_zero:g} rad; allowed: below gripper_max, {teleop.gripper_max:g}",
        )
    row.done()
    return teleop


def _masters(row: Table, kind: TeleopKind, types: dict[str, str]) -> tuple[str, ...]:
    """Return who moves the slave: one `master`, or two `masters`."""
    key = "master" if kind == "psm" else "masters"
    masters = (row.text(key),) if kind == "psm" else row.texts(key)
    if kind == "ecm" and len(set(masters)) != 2:
        raise row.fail(key, f"got {list(masters)}; allowed: the left and the right master")
    for name in masters:
        if not name or types.get(name, "MTM") != "MTM":
            raise row.fail(key, f"got {name!r}; allowed: an MTM, or a name that no arm has")
    return masters


def _angles(row: Table) -> dict[str, float]:
    """Return those that the file gives [rad, rad/s]."""
    found: dict[str, float] = {}
    for name, dimension in ANGLES.items():
        if not row.has(name, dimension):
            continue
        found[name] = row.quantity(name, dimension)
        if found[name] < 0.0 or (name.startswith("jaw") and not found[name]):
            least = "above 0" if name.startswith("jaw") else "0 or more"
            raise row.fail(name, f"got {found[name]:g}; allowed: {least}")
    return found
