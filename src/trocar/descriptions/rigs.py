"""Rigs from TOML: which arms stand where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras import read_camera
from trocar.descriptions.frames import read_pose
from trocar.descriptions.props import read_bands, read_props, read_script
from trocar.descriptions.records import (
    DISPLAY,
    REFERENCE_ARM,
    ArmDescription,
    BaseFrame,
    DynamicsKind,
    GraspKind,
    RigArm,
    RigDescription,
)
from trocar.descriptions.robot_errors import read_robot_errors
from trocar.descriptions.sensors import read_sensors
from trocar.descriptions.table import Table, read_table
from trocar.descriptions.teleops import read_teleop
from trocar.geometry.se3 import inverse
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]

GRASPS: tuple[str, ...] = get_args(GraspKind)
DYNAMICS: tuple[str, ...] = get_args(DynamicsKind)
#: Reads an arm by name (or path beside the rig) with a tool's name.
ArmLoader = Callable[[str, str | None], ArmDescription]


def read_rig(path: Path, load_arm: ArmLoader) -> RigDescription:
    """Read a rig.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table = read_table(path)
    table.check_schema()
    name, title = table.text("name"), table.text("title", "")
    source = table.text("source")
    display = _read_display(table)
    arms: list[RigArm] = []
    for row in table.tables("arm"):
        arms.append(_read_arm(row, (arms, display), load_arm))
        row.done()
    if not arms:
        raise table.fail("arm", "is missing; a rig needs at least one arm")
    props = read_props(table, [arm.name for arm in arms])
    bands = read_bands(table, props)
    poses = dict(table.each("pose", lambda row: _read_pose(row, arms)))
    found = [row.text("name") for row in table.tables("pose")]
    for again in {n for n in found if found.count(n) > 1}:
        raise table.fail("pose", f"got {again!r} a second time")
    if "start" not in poses:
        raise table.fail("pose", f'got {", ".join(poses) or "none"}; a rig needs the pose "start"')
    sensors = read_sensors(table, arms, props, bands)
    types = {arm.name: arm.arm.type for arm in arms}
    teleops = table.each("teleop", lambda row: read_teleop(row, types), again="name")
    cameras = table.each("camera", lambda row: read_camera(row, arms), again="name")
    share = _read_test_share(table)
    reference = table.text("reference_arm", REFERENCE_ARM)
    extension = read_script(table, "extend_spec")
    grasp = cast(GraspKind, table.text("grasp", GRASPS[0], allowed=GRASPS))
    dynamics = cast(DynamicsKind, table.text("dynamics", DYNAMICS[0], allowed=DYNAMICS))
    joints = {arm.name: (arm.arm.type, arm.arm.mechanism.joint_names) for arm in arms}
    errors = read_robot_errors(table, joints)
    table.done()
    if share < 1.0 and "test" not in poses:
        raise table.fail("pose", 'a test_sine.share below 1 needs the pose "test"')
    parts = (tuple(arms), props, poses, share, display, sensors, teleops, cameras)
    more = (reference, bands, extension, grasp, errors, dynamics)
    rig = RigDescription(name, title, source, str(path), *parts, *more)
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
    row.known("on", on, (*places, *carriers), "no earlier arm")
    carrier = next((a for a in before if a.name == on), None)
    frame = row.text("frame", "mount" if carrier else "")
    if carrier is not None:
        row.known("frame", frame, carrier.arm.mechanism.frame_index)
    place = row.text("place", arm.root)
    row.known("place", place, arm.mechanism.frame_index)
    rest = np.clip(np.zeros(len(arm.joints)), arm.mechanism.lower, arm.mechanism.upper)
    root_place = pose(arm.mechanism, rest, place, arm.root)
    at = read_pose(row) @ inverse(root_place)
    if on == DISPLAY and display is not None:
        at = display @ at
    base_frame = _read_base_frame(row)
    return RigArm(name, arm, "" if carrier is None else on, frame, at, base_frame)


def _read_base_frame(row: Table) -> BaseFrame | None:
    """Return the frame of the arm's poses, None where the rig has no `base_frame`."""
    if "base_frame" not in row:
        return None
    table = row.table("base_frame")
    found = BaseFrame(table.name(), read_pose(table))
    table.done()
    return found


def _read_test_share(table: Table) -> float:
    row = table.optional_table("test_sine")
    share = row.number("share", 1.0)
    if not 0.0 < share <= 1.0:
        raise row.fail("share", f"got {share:g}; allowed: above 0 to 1")
    row.done()
    return share


def _read_pose(row: Table, arms: list[RigArm]) -> tuple[str, dict[str, Array]]:
    name, table = row.text("name"), row.table("q_rad_m")
    found: dict[str, Array] = {}
    for arm in arms:
        if arm.name in table:
            mechanism = arm.arm.mechanism
            found[arm.name] = table.within(arm.name, mechanism.lower, mechanism.upper)
        elif name == "start":
            raise table.fail(arm.name, 'is missing; "start" places every arm')
    table.done()
    return name, found
