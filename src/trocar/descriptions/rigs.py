"""Rigs from TOML: arms and their bases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras import read_camera
from trocar.descriptions.frames import read_pose
from trocar.descriptions.keys import key
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
from trocar.descriptions.table import Table
from trocar.descriptions.teleops import read_teleop
from trocar.geometry.se3 import inverse, transform, translation
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigKeys:
    """Keys of a rig's file beside its blocks.

    Attributes:
        name, title, source: of the rig
        extend_spec: a Python file beside this one, whose `extend_spec(spec)` adds to the MjSpec; no
            actuators or keyframes
        errors: a preset's name, or a table
        dynamics: of arms without an overlay of dynamics; `cad`: masses and friction as described
        grasp: how jaws hold free props
        reference_arm: with setup joints: the arm whose tip is the reference frame of others
    """

    name: str = field(metadata=key())
    source: str = field(metadata=key())
    title: str = field(default="", metadata=key())
    extend_spec: str = field(default="", metadata=key())
    errors: object = field(default=None, metadata=key(form="any", see="robot-errors.md"))
    dynamics: DynamicsKind = field(
        default="identified", metadata=key(see="dynamics.md#in-the-simulation")
    )
    grasp: GraspKind = field(default="friction+stick", metadata=key(see="simulation.md#grasping"))
    reference_arm: str = field(default=REFERENCE_ARM, metadata=key())


@dataclass(frozen=True)
class RigArmKeys:
    """Keys of an arm of a rig, beside its placement.

    Attributes:
        name: `PSM1`, `ECM`, ...
        description: a built-in arm, or a path
        tool: a tool or a path; `none`; default: the arm's
        on: carrier: the world, an earlier arm, or `HRSV`, the stereo display
        frame: of the carrier; default: `mount`
        place: frame to place there: `rcm`, ...; default: the arm's root
    """

    name: str = field(metadata=key())
    description: str = field(metadata=key())
    tool: str = field(default="", metadata=key())
    on: str = field(default="world", metadata=key())
    frame: str | None = field(default=None, metadata=key())
    place: str | None = field(default=None, metadata=key())


@dataclass(frozen=True)
class TestSineKeys:
    """Keys of the test trajectory.

    Attributes:
        share: of the amplitude; below 1 the arms swing about the pose `test`
    """

    share: float = field(default=1.0, metadata=key(above=0.0, most=1.0))


@dataclass(frozen=True)
class RigPoseKeys:
    """Keys of a named pose of a rig.

    Attributes:
        name: of the pose
        q_rad_m: `{ PSM1 = [...], ... }`, the jaw last
    """

    name: str = field(metadata=key())
    q_rad_m: object = field(metadata=key(form="any"))


#: Reads an arm by name (or path beside the rig) with a tool's name.
ArmLoader = Callable[[str, str | None], ArmDescription]


def read_rig(table: Table, load_arm: ArmLoader) -> RigDescription:
    """Read a rig from its file's root table.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table.check_schema()
    keys = table.record(RigKeys)
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
    extension = read_script(table, "extend_spec")
    joints = {arm.name: (arm.arm.type, arm.arm.mechanism.joint_names) for arm in arms}
    errors = read_robot_errors(table, joints)
    table.done()
    if share < 1.0 and "test" not in poses:
        raise table.fail("pose", 'a test_sine.share below 1 needs the pose "test"')
    rig = RigDescription(
        name=keys.name,
        title=keys.title,
        source=keys.source,
        file=table.file,
        arms=tuple(arms),
        props=props,
        poses=poses,
        test_share=share,
        display=display,
        sensors=sensors,
        teleops=teleops,
        cameras=cameras,
        reference_arm=keys.reference_arm,
        bands=bands,
        extension=extension,
        grasp=keys.grasp,
        errors=errors,
        dynamics=keys.dynamics,
    )
    if "reference_arm" in table and keys.reference_arm not in rig.setup_joints:
        known = ", ".join(rig.setup_joints) or "none, for the rig has no setup joints"
        raise table.fail("reference_arm", f"got {keys.reference_arm!r}; allowed: {known}")
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
    keys = row.record(RigArmKeys)
    name, on = keys.name, keys.on
    if name in [arm.name for arm in before]:
        raise row.fail("name", f"got {name!r} a second time")
    if name == DISPLAY:
        raise row.fail("name", f"got {name!r}, which is the stereo display")
    arm = load_arm(keys.description, keys.tool or None)
    carriers = [a.name for a in before]
    places = ["world"] if display is None else ["world", DISPLAY]
    row.known("on", on, (*places, *carriers), "no earlier arm")
    carrier = next((a for a in before if a.name == on), None)
    frame = keys.frame
    if frame is None:
        frame = "mount" if carrier else ""
    if carrier is not None:
        row.known("frame", frame, carrier.arm.mechanism.frame_index)
    place = arm.root if keys.place is None else keys.place
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
    found = table.record(BaseFrame, pose=read_pose(table))
    table.done()
    return found


def _read_test_share(table: Table) -> float:
    row = table.optional_table("test_sine")
    share = row.record(TestSineKeys).share
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


#: Position of a lone arm's remote centre, z up [m]. Source: our own choice.
REMOTE_CENTRE = (0.0, 0.0, 0.3)
#: Names of the first arm of a type; others keep their own.
FIRST_NAMES = {"PSM": "PSM1", "ECM": "ECM"}


def lone_arm_rig(arm: ArmDescription, turn: Array | None = None) -> RigDescription:
    """Return a rig of one arm alone in the air, at its pose "home" where it has one.

    The remote centre stands at (0, 0, 0.3) m; of an arm that has none, the root at the origin.

    Args:
        arm: the arm with its tool
        turn: rotation of the arm about the remote centre or origin from upright, (3, 3)
    """
    mechanism = arm.mechanism
    rest = np.clip(np.zeros(len(arm.joints)), mechanism.lower, mechanism.upper)
    place = np.eye(4)
    if "rcm" in mechanism.frame_index:
        rcm = pose(mechanism, rest, "rcm", arm.root)
        place = translation(np.array(REMOTE_CENTRE)) @ inverse(rcm)
    if turn is not None and not np.array_equal(turn, np.eye(3)):
        stands = np.array(REMOTE_CENTRE) if "rcm" in mechanism.frame_index else np.zeros(3)
        place = transform(turn, stands) @ translation(-stands) @ place
    name = FIRST_NAMES.get(arm.type, arm.name.upper())
    placed = RigArm(name, arm, "", "", place)
    start = {"start": {name: arm.poses.get("home", rest)}}
    return RigDescription(f"lone {arm.name}", arm.title, arm.source, "", (placed,), (), start)
