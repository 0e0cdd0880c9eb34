"""Rigs from TOML: which arms stand where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.arms import SCHEMA
from trocar.descriptions.cameras import read_cameras
from trocar.descriptions.checks import check_name
from trocar.descriptions.frames import read_pose
from trocar.descriptions.props import check_object_name, read_prop
from trocar.descriptions.records import (
    DISPLAY,
    REFERENCE_ARM,
    ArmDescription,
    BaseFrame,
    RigArm,
    RigDescription,
)
from trocar.descriptions.sensors import read_sensors
from trocar.descriptions.table import Table, read_table
from trocar.descriptions.teleop import read_teleops
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]

#: Reads an arm by name (or path beside the rig) with a tool's name.
ArmLoader = Callable[[str, str | None], ArmDescription]


def read_rig(path: Path, load_arm: ArmLoader) -> RigDescription:
    """Read a rig.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table = read_table(path)
    if table.raw("schema") != SCHEMA:
        raise table.fail("schema", f"got {table.raw('schema')!r}; allowed: {SCHEMA}")
    name, title = table.text("name"), table.text("title", "")
    source = table.text("source")
    display = _read_display(table)
    arms: list[RigArm] = []
    for row in table.tables("arm"):
        arms.append(_read_arm(row, (arms, display), load_arm))
    if not arms:
        raise table.fail("arm", "is missing; a rig needs at least one arm")
    props = tuple(read_prop(row) for row in table.tables("prop"))
    poses = dict(_read_pose(row, arms) for row in table.tables("pose"))
    for key, found in (("prop", [p.name for p in props]), ("pose", _names(table, "pose"))):
        for again in {n for n in found if found.count(n) > 1}:
            raise table.fail(key, f"got {again!r} a second time")
    for prop in (prop for prop in props if prop.movable is not None):
        check_object_name(table, prop.name, [arm.name for arm in arms])
    if "start" not in poses:
        raise table.fail("pose", f'got {", ".join(poses) or "none"}; a rig needs the pose "start"')
    sensors = read_sensors(table.tables("sensor"), arms)
    teleops = read_teleops(table.tables("teleop"), arms)
    cameras = read_cameras(table.tables("camera"), arms)
    share = _read_test_share(table)
    reference = table.text("reference_arm", REFERENCE_ARM)
    table.done()
    if share < 1.0 and "test" not in poses:
        raise table.fail("pose", 'a test_sine.share below 1 needs the pose "test"')
    parts = (tuple(arms), props, poses, share, display, sensors, teleops, cameras)
    rig = RigDescription(name, title, source, str(path), *parts, reference)
    if "reference_arm" in table and reference not in rig.setup_joints:
        known = ", ".join(rig.setup_joints) or "none, for the rig has no setup joints"
        raise table.fail("reference_arm", f"got {reference!r}; allowed: {known}")
    return rig


def _read_display(table: Table) -> Array | None:
    """Return the stereo display's pose in the world, (4, 4), None without one."""
    if "display" not in table:
        return None
    row = table.table("display")
    found = read_pose(row)
    row.text("source", "")
    row.done()
    return found


def _read_arm(
    row: Table, standing: tuple[list[RigArm], Array | None], load_arm: ArmLoader
) -> RigArm:
    """Read an arm of a rig that has these arms already, and perhaps a stereo display."""
    before, display = standing
    name = row.text("name")
    if name in [arm.name for arm in before]:
        raise row.fail("name", f"got {name!r} a second time")
    if name == DISPLAY:
        raise row.fail("name", f"got {name!r}, which is the stereo display")
    tool = row.text("tool", "") or None
    arm = load_arm(row.text("description"), tool)
    on = row.text("on", "world")
    carriers = [a.name for a in before]
    places = ["world"] if display is None else ["world", DISPLAY]
    if on not in (*places, *carriers):
        known = ", ".join((*places, *carriers))
        raise row.fail("on", f"got {on!r}; allowed: {known} (earlier arms)")
    carrier = next((a for a in before if a.name == on), None)
    frame = row.text("frame", "mount" if carrier else "")
    if carrier is not None:
        check_name(row.file, f"{row.path}.frame", frame, carrier.arm.mechanism.frame_index)
    place = row.text("place", arm.root)
    check_name(row.file, f"{row.path}.place", place, arm.mechanism.frame_index)
    rest = np.clip(np.zeros(len(arm.joints)), arm.mechanism.lower, arm.mechanism.upper)
    root_place = pose(arm.mechanism, rest, place, arm.root)
    at = read_pose(row) @ inverse(root_place)
    if on == DISPLAY and display is not None:
        at = display @ at
    base_frame = _read_base_frame(row)
    row.text("source", "")
    row.done()
    return RigArm(name, arm, "" if carrier is None else on, frame, at, base_frame)


def _read_base_frame(row: Table) -> BaseFrame | None:
    """Return the frame that the arm's poses are told in, None where the rig says it."""
    if "base_frame" not in row:
        return None
    table = row.table("base_frame")
    name = table.text("name")
    if not name:
        raise table.fail("name", "got an empty text; allowed: a name")
    found = BaseFrame(name, read_pose(table))
    table.done()
    return found


def _names(table: Table, key: str) -> list[str]:
    return [row.text("name") for row in table.tables(key)]


def _read_test_share(table: Table) -> float:
    row = table.optional_table("test_sine")
    row.text("source", "")
    share = row.number("share", 1.0)
    if not 0.0 < share <= 1.0:
        raise row.fail("share", f"got {share:g}; allowed: above 0 to 1")
    row.done()
    return share


def _read_pose(row: Table, arms: list[RigArm]) -> tuple[str, dict[str, Array]]:
    name = row.text("name")
    row.text("source", "")
    table = row.table("q_rad_m")
    found: dict[str, Array] = {}
    for arm in arms:
        if arm.name in table:
            mechanism = arm.arm.mechanism
            q = table.numbers(arm.name, len(mechanism.joints))
            if (q < mechanism.lower).any() or (q > mechanism.upper).any():
                raise table.fail(
                    arm.name,
                    f"got {q.tolist()}; allowed: {mechanism.lower.tolist()} to"
                    f" {mechanism.upper.tolist()}",
                )
            found[arm.name] = q
        elif name == "start":
            raise table.fail(arm.name, 'is missing; "start" places every arm')
    table.done()
    row.done()
    return name, found
