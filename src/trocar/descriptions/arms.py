"""Arms and tools from TOML: frames, joints, bodies, and what mounts on what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import (
    ArmDescription,
    Body,
    Control,
    Counterweight,
    Coupling,
    Friction,
    Gains,
    JointDescription,
    Missing,
)
from trocar.descriptions.shapes import read_body
from trocar.descriptions.table import Table, read_table
from trocar.errors import DescriptionError, TrocarError
from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.rotations import check_rotation, matrix_from_rpy
from trocar.geometry.se3 import transform
from trocar.kinematics.mechanism import (
    Closure,
    Frame,
    Joint,
    Mechanism,
    Motion,
    check_mechanism,
)

Array = NDArray[np.float64]

SCHEMA = 1
ARM_TYPES = ("PSM", "ECM", "SUJ", "MTM")
STRUCTURES = ("", "rcm_arm", "rcm_scope", "gimbal_arm")


@dataclass(frozen=True, eq=False)
class Parts:
    """What arm files and tool files have in common."""

    joints: tuple[JointDescription, ...]
    frames: tuple[Frame, ...]
    closures: tuple[Closure, ...]
    bodies: tuple[Body, ...]
    friction: Mapping[str, Mapping[str, Friction]]
    rotor: Mapping[str, float]
    control: Mapping[str, Control]
    poses: Mapping[str, Array]
    sources: Mapping[str, str]
    block_sources: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class ToolDescription:
    """An instrument that mounts on an arm; its frames hang on the arm's tool frame."""

    name: str
    title: str
    source: str
    file: str
    tip: str
    parts: Parts
    coupling: Coupling | None


def read_tool(path: Path) -> ToolDescription:
    """Read a tool.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table = _open(path)
    name, title = table.text("name"), table.text("title", "")
    source, tip = table.text("source"), table.text("tip")
    parts = _read_parts(table, name)
    coupling = _read_coupling(table)
    table.done()
    return ToolDescription(name, title, source, str(path), tip, parts, coupling)


def read_arm(path: Path, tool: ToolDescription | None) -> ArmDescription:
    """Read an arm and mount a tool on it.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table = _open(path)
    name = table.text("name")
    kind = table.text("type", allowed=ARM_TYPES)
    generation, title = table.text("generation", ""), table.text("title", "")
    source = table.text("source")
    root, reference = table.text("root"), table.text("relative_to")
    tip = table.text("tip")
    structure = table.text("inverse_kinematics", "", allowed=STRUCTURES)
    tool_frame = table.text("tool_frame", "")
    table.text("default_tool", "")
    missing = tuple(Missing(row.text("what"), row.text("why")) for row in table.tables("missing"))
    parts = _read_parts(table, name)
    balance = _read_counterweight(table)
    table.raw("erratum")  # printed tables carry their errata; descriptions.paper reads them
    table.done()
    if not parts.frames or parts.frames[0].name != root:
        raise table.fail("root", f"got {root!r}; allowed: the first frame")
    if tool is not None and not tool_frame:
        raise table.fail("tool_frame", f"is missing, so no tool ({tool.name}) can be mounted")
    if tool is not None:
        parts, tip = _mount(parts, tool), tool.tip
    try:
        mechanism = check_mechanism(
            Mechanism(
                name,
                tuple(_public(j) for j in parts.joints),
                parts.frames,
                parts.closures,
                reference,
                tip,
            )
        )
    except DescriptionError:
        raise
    except TrocarError as problem:
        raise DescriptionError(str(path), "frame", str(problem)) from problem
    return ArmDescription(
        name=name,
        type=kind,
        generation=generation,
        title=title,
        source=source,
        file=str(path),
        mechanism=mechanism,
        joints=parts.joints,
        bodies=_balanced(parts, mechanism, balance),
        friction=parts.friction,
        rotor=parts.rotor,
        control=parts.control,
        poses=parts.poses,
        tool="" if tool is None else tool.name,
        coupling=None if tool is None else tool.coupling,
        inverse_kinematics=structure,
        missing=missing,
        row_sources=parts.sources,
        block_sources=parts.block_sources,
    )


def tool_wanted(path: Path) -> str:
    """Return the name of the tool that an arm mounts by itself, "" when none."""
    return read_table(path).text("default_tool", "")


def _open(path: Path) -> Table:
    table = read_table(path)
    if table.raw("schema") != SCHEMA:
        raise table.fail("schema", f"got {table.raw('schema')!r}; allowed: {SCHEMA}")
    return table


def _read_parts(table: Table, part: str) -> Parts:
    joints = tuple(_read_joint(row) for row in table.tables("joint"))
    rows = table.tables("frame")
    sources = {row.text("name"): row.text("source", "") for row in rows}
    frames = tuple(_read_frame(row) for row in rows)
    closures = tuple(_read_closure(row) for row in table.tables("closure"))
    bodies = tuple(read_body(row, part) for row in table.tables("body"))
    return Parts(
        joints,
        frames,
        closures,
        bodies,
        _read_friction(table),
        _read_rotor(table),
        _read_control(table),
        _read_poses(table, len(joints)),
        sources,
        _block_sources(table),
    )


def _read_joint(row: Table) -> JointDescription:
    name = row.text("name")
    kind = row.text("kind", allowed=("revolute", "prismatic"))
    turns = kind == "revolute"
    measure = "angle" if turns else "length"
    lower, upper = row.quantity("lower", measure), row.quantity("upper", measure)
    if not lower < upper:
        raise row.fail("lower", f"got {lower:g}; allowed: less than the upper limit {upper:g}")
    drive = row.table("drive")
    if len(drive.entries()) != 1:
        raise row.fail("drive", f"got {drive.entries()}; allowed: one frame = weight")
    joint = JointDescription(
        name=name,
        kind="revolute" if turns else "prismatic",
        lower=lower,
        upper=upper,
        effort_max=_positive(row, "effort_max", "torque" if turns else "force", np.inf),
        velocity_max=_positive(
            row, "velocity_max", "angular velocity" if turns else "linear velocity", np.inf
        ),
        acceleration_max=_positive(
            row,
            "acceleration_max",
            "angular acceleration" if turns else "linear acceleration",
            np.inf,
        ),
        tracking_tolerance=_positive(row, "tracking_tolerance", measure, np.inf),
        drive=tuple((frame, drive.number(frame)) for frame in drive.entries()),
        stop_lower=row.quantity("stop_lower", measure, default=lower),
        stop_upper=row.quantity("stop_upper", measure, default=upper),
        source=row.text("source", ""),
    )
    if not lower <= joint.stop_lower < joint.stop_upper <= upper:
        raise row.fail("stop_lower", "mechanical stops must lie inside the limits")
    row.done()
    return joint


def _positive(row: Table, name: str, dimension: str, default: float) -> float:
    value = row.quantity(name, dimension, default=default)
    if value <= 0.0:
        raise row.fail(name, f"got {value:g}; allowed: above 0")
    return value


def _read_frame(row: Table) -> Frame:
    name = row.text("name")
    parent = row.text("parent", "") or None
    motion = cast(Motion, row.text("motion", "fixed", allowed=("fixed", "revolute", "prismatic")))
    row.text("source", "")
    before, after = _read_placement(row)
    if motion == "fixed":
        before, after = before @ after, np.eye(4)
    coupling = row.optional_table("q")
    couplings = tuple((joint, coupling.number(joint)) for joint in coupling.entries())
    if (motion == "fixed") != (not couplings):
        raise row.fail("q", "a moving frame needs q = { joint = ratio }, a fixed one has none")
    frame = Frame(
        name,
        parent,
        motion,
        before,
        after,
        couplings,
    )
    row.done()
    return frame


def _read_placement(row: Table) -> tuple[Array, Array]:
    """Return (before, after) of a frame: what comes ahead of its motion and what follows."""
    if "dh" in row:
        convention = row.text("dh", allowed=("modified", "standard"))
        a = row.quantity("a", "length", default=0.0)
        alpha = row.quantity("alpha", "angle", default=0.0)
        d = row.quantity("d", "length", default=0.0)
        theta = row.quantity("theta", "angle", default=0.0)
        if convention == "modified":
            return exact(modified_dh(a, alpha, d, theta)), np.eye(4)
        return exact(standard_dh(0.0, 0.0, d, theta)), exact(standard_dh(a, alpha, 0.0, 0.0))
    turn = np.eye(3)
    if "rotation" in row:
        turn = check_turn(row, row.matrix("rotation", 3, 3))
    elif row.has("rpy", "angle"):
        turn = exact(matrix_from_rpy(*row.vector("rpy", 3, "angle")))
    at = row.vector("xyz", 3, "length", default=np.zeros(3))
    return transform(turn, at), np.eye(4)


def check_turn(row: Table, turn: Array) -> Array:
    """Return a rotation matrix, or say which entry is none."""
    try:
        return check_rotation(turn)
    except TrocarError as problem:
        raise row.fail("rotation", str(problem)) from problem


def exact(matrix: Array) -> Array:
    """Return a matrix whose entries at right angles are exactly 0 and 1 (cos 90 deg is 6e-17)."""
    return np.where(np.abs(matrix) < 1e-15, 0.0, matrix)


def _read_closure(row: Table) -> Closure:
    name = row.text("name")
    passive, guard = row.texts("passive"), row.texts("guard")
    if len(passive) != 2:
        raise row.fail("passive", f"got {list(passive)}; allowed: the two frames it determines")
    if len(guard) not in (0, 2):
        raise row.fail("guard", f"got {list(guard)}; allowed: two frames, or none")
    row.text("source", "")
    closure = Closure(
        name,
        row.text("frame_a"),
        row.vector("point_a", 3, "length"),
        row.text("frame_b"),
        row.vector("point_b", 3, "length"),
        (passive[0], passive[1]),
        guard,
    )
    row.done()
    return closure


def _read_friction(table: Table) -> dict[str, dict[str, Friction]]:
    models = table.optional_table("friction")
    found: dict[str, dict[str, Friction]] = {}
    for name in models.entries():
        model = models.table(name)
        model.text("source", "")
        found[name] = {}
        for key in model.entries():
            row = model.table(key)
            found[name][key] = Friction(
                row.quantity("coulomb", "torque", "force", default=0.0),
                row.quantity("viscous", "angular damping", "linear damping", default=0.0),
            )
            if min(found[name][key].coulomb, found[name][key].viscous) < 0.0:
                raise row.fail("", "friction must not be negative")
            row.done()
    return found


def _read_rotor(table: Table) -> dict[str, float]:
    rotors = table.optional_table("rotor")
    rotors.text("source", "")
    found: dict[str, float] = {}
    for key in rotors.entries():
        row = rotors.table(key)
        found[key] = row.quantity("inertia" if "inertia_kgm2" in row else "mass", "inertia", "mass")
        row.done()
    return found


def _read_control(table: Table) -> dict[str, Control]:
    presets = table.optional_table("control")
    found: dict[str, Control] = {}
    for name in presets.entries():
        row = presets.table(name)
        pid = row.table("pid")
        gains = {joint: Gains(*pid.numbers(joint, 3)) for joint in pid.entries()}
        found[name] = Control(
            name,
            gains,
            row.flag("gravity_compensation", True),
            row.flag("effort_limits", True),
            row.text("source", ""),
        )
        row.done()
    return found


def _read_poses(table: Table, count: int) -> dict[str, Array]:
    found: dict[str, Array] = {}
    for row in table.tables("pose"):
        found[row.text("name")] = row.vector("q", count, "position")
        row.text("source", "")
        row.done()
    return found


def _block_sources(table: Table) -> dict[str, str]:
    """Return the source of each block that is no row, {block: source}."""
    blocks = [(key, table.optional_table(key)) for key in ("rotor", "coupling")]
    for key in ("friction", "control"):
        several = table.optional_table(key)
        blocks += [(f"{key} {name}", several.table(name)) for name in several.entries()]
    blocks += [(f"loop {row.text('name')}", row) for row in table.tables("closure")]
    blocks += [(f"pose {row.text('name')}", row) for row in table.tables("pose")]
    found = {name: block.text("source", "") for name, block in blocks}
    return {name: source for name, source in found.items() if source}


def _read_coupling(table: Table) -> Coupling | None:
    if "coupling" not in table:
        return None
    row = table.table("coupling")
    joints = row.texts("joints")
    matrix = row.matrix("actuator_to_joint", len(joints), len(joints))
    row.text("source", "")
    row.done()
    return Coupling(joints, matrix)


def _read_counterweight(table: Table) -> Counterweight | None:
    if "counterweight" not in table:
        return None
    row = table.table("counterweight")
    found = Counterweight(row.text("body"), row.text("joint"), row.number("ratio"))
    row.done()
    return found


def _public(joint: JointDescription) -> Joint:
    return Joint(joint.name, joint.kind, joint.lower, joint.upper, joint.drive)


def _mount(arm: Parts, tool: ToolDescription) -> Parts:
    """Append a tool's parts to an arm's; poses and control sets join by name."""
    extra = tool.parts
    control = {
        name: replace(preset, pid={**preset.pid, **extra.control[name].pid})
        if name in extra.control
        else preset
        for name, preset in arm.control.items()
    }
    friction = {
        name: {**arm.friction.get(name, {}), **extra.friction.get(name, {})}
        for name in {**arm.friction, **extra.friction}
    }
    still = np.zeros(len(extra.joints))
    poses = {
        name: np.concatenate([q, extra.poses.get(name, still)]) for name, q in arm.poses.items()
    }
    return Parts(
        arm.joints + extra.joints,
        arm.frames + extra.frames,
        arm.closures + extra.closures,
        arm.bodies + extra.bodies,
        friction,
        {**arm.rotor, **extra.rotor},
        control,
        poses,
        {**arm.sources, **extra.sources},
        {
            **arm.block_sources,
            tool.name: tool.source,
            **{f"{tool.name} {block}": source for block, source in extra.block_sources.items()},
        },
    )


def _balanced(
    parts: Parts, mechanism: Mechanism, balance: Counterweight | None
) -> tuple[Body, ...]:
    """Return the bodies with the counterweight's mass set by what rides on its joint."""
    for body in parts.bodies:
        mechanism.frame(body.frame)
    if balance is None:
        return parts.bodies
    drive = next(j.drive[0][0] for j in parts.joints if j.name == balance.joint)
    index = mechanism.frame_index[drive]
    riding = sum(b.mass for b in parts.bodies if index in mechanism.chain(b.frame))
    mass = riding / balance.ratio
    return tuple(
        replace(b, mass=mass, inertia=b.inertia * mass / b.mass) if b.frame == balance.body else b
        for b in parts.bodies
    )
