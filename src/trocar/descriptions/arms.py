"""Arms and tools from TOML: frames, joints, bodies, and what mounts on what."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import check_plan, read_calibration
from trocar.descriptions.frames import (
    PIN_ROTOR_KG,
    pin_body,
    pin_frame,
    pin_name,
    pinned,
    read_closure,
    read_frame,
    read_joint,
    rest_poses,
)
from trocar.descriptions.keys import key
from trocar.descriptions.records import (
    ArmDescription,
    Body,
    Control,
    Counterweight,
    Friction,
    Gains,
    GravityLink,
    JointDescription,
    Missing,
    Observer,
)
from trocar.descriptions.shapes import read_body
from trocar.descriptions.table import Table
from trocar.errors import DescriptionError, InputError, TrocarError
from trocar.kinematics.coupling import Coupling
from trocar.kinematics.mechanism import (
    Closure,
    Frame,
    Joint,
    Mechanism,
    Motion,
    check_mechanism,
)

Array = NDArray[np.float64]


def read_friction(table: Table) -> dict[str, dict[str, Friction]]:
    """Return {model: {frame or joint: friction}}."""
    models = table.optional_table("friction")
    return {name: models.named(name, _read_hinge_friction) for name in models.entries()}


def _read_hinge_friction(row: Table) -> Friction:
    return row.record(Friction)


def read_rotor(table: Table) -> dict[str, float]:
    """Return {frame: reflected inertia or mass}."""

    def read(row: Table) -> float:
        keys = row.record(RotorKeys)
        if keys.inertia is not None and keys.mass is not None:
            raise row.fail("mass", "contradicts inertia; give one of them")
        if keys.inertia is not None:
            return keys.inertia
        return row.quantity("mass", "mass") if keys.mass is None else keys.mass

    return table.named("rotor", read)


def read_belts(table: Table) -> dict[str, float]:
    """Return {frame: stiffness of the belt that ties it to the joint that it follows}."""
    return table.named("belts", lambda row: row.record(BeltKeys).stiffness)


#: Discs of an instrument.
DISCS = 4


def read_control(table: Table) -> dict[str, Control]:
    """Return {name: gains and what goes with them}."""

    def read(row: Table) -> Control:
        pid = row.table("pid")
        gains: dict[str, Gains] = {}
        for joint in pid.entries():
            gains[joint] = Gains(*pid.numbers(joint, 3))
            if min(gains[joint].p, gains[joint].i, gains[joint].d) < 0.0:
                raise pid.fail(joint, f"got {pid.raw(joint)}; allowed: 0 or more")
        table = row.optional_table("observer")
        observers = {joint: Observer(*table.numbers(joint, 2)) for joint in table.entries()}
        for joint, observer in observers.items():
            if min(observer.mass, observer.cutoff) < 0.0:
                raise table.fail(joint, f"got {table.raw(joint)}; allowed: 0 or more")
        given = row.raw("disc_observer", [])
        count = len(cast(list[Any], given)) if isinstance(given, list) else DISCS
        rows: list[list[float]] = row.matrix("disc_observer", count, 2).tolist() if count else []
        discs = tuple(Observer(mass, cutoff) for mass, cutoff in rows)
        if min((min(disc.mass, disc.cutoff) for disc in discs), default=0.0) < 0.0:
            raise row.fail("disc_observer", f"got {given}; allowed: 0 or more")
        found = row.record(
            Control,
            name=row.path.partition(".")[2],
            pid=gains,
            observer=observers,
            disc_observer=discs,
        )
        for joint, most in found.pid_output_max.items():
            if most <= 0.0:
                raise row.fail("pid_output_max", f"got {most:g} for {joint}; allowed: above 0")
        return found

    return table.named("control", read)


def _read_gravity_link(row: Table) -> GravityLink:
    motion = row.text("motion", "fixed", allowed=get_args(Motion))
    link = row.record(GravityLink, turns=motion != "prismatic")
    if (motion == "fixed") != (not link.q):
        raise row.fail("q", "a moving link needs q = { joint = ratio }, a fixed one has none")
    return link


def read_coupling(table: Table) -> Coupling | None:
    """Return a tool's coupling of actuators and joints, None without one."""
    if "coupling" not in table:
        return None
    row = table.table("coupling")
    joints = row.record(CouplingKeys).joints
    matrix = row.matrix("actuator_to_joint", len(joints), len(joints))
    row.done()
    try:
        return Coupling(matrix, joints)
    except InputError as problem:
        raise row.fail("actuator_to_joint", str(problem)) from problem


def read_counterweight(table: Table) -> Counterweight | None:
    """Return the counterweight of a joint, None without one."""
    if "counterweight" not in table:
        return None
    row = table.table("counterweight")
    found = row.record(Counterweight)
    row.done()
    return found


#: Types of arms; OTHER: one that the dVRK lacks, without rules of its own.
ArmType = Literal["PSM", "ECM", "SUJ", "MTM", "OTHER"]
Structure = Literal["", "rcm_arm", "rcm_scope", "gimbal_arm"]


@dataclass(frozen=True)
class ArmKeys:
    """Keys of an arm's file beside its blocks.

    Attributes:
        name, title: of the arm
        type: of the arm
        generation: `Classic` or `Si`
        source: of numbers without one
        root: the first frame
        tip: tip frame
        relative_to: reference frame of poses
        inverse_kinematics: structure with a closed form; default: none
        tool_frame: parent frame of tools; default: no tools
        default_tool: mounted tool; default: none
    """

    name: str = field(metadata=key())
    type: ArmType = field(metadata=key())
    source: str = field(metadata=key())
    root: str = field(metadata=key())
    tip: str = field(metadata=key())
    relative_to: str = field(metadata=key())
    title: str = field(default="", metadata=key())
    generation: str = field(default="", metadata=key())
    inverse_kinematics: Structure = field(default="", metadata=key())
    tool_frame: str = field(default="", metadata=key())
    default_tool: str = field(default="", metadata=key())


@dataclass(frozen=True)
class ToolKeys:
    """Keys of a tool's file beside its blocks.

    Attributes:
        name, title, source: of the tool
        tip: new tip frame of the arm
        fits: generations of arms, `["Classic", "S", "Si"]`; default: any
    """

    name: str = field(metadata=key())
    source: str = field(metadata=key())
    tip: str = field(metadata=key())
    title: str = field(default="", metadata=key())
    fits: tuple[str, ...] = field(default=(), metadata=key())


@dataclass(frozen=True)
class RotorKeys:
    """Keys of the reflected inertia of a motor.

    Attributes:
        inertia: of a frame that turns [kg m^2]
        mass: of a frame that slides [kg]
    """

    inertia: float | None = field(default=None, metadata=key("inertia", least=0.0))
    mass: float | None = field(default=None, metadata=key("mass", least=0.0))


@dataclass(frozen=True)
class BeltKeys:
    """Keys of the belt that ties a frame to the joint that it follows.

    Attributes:
        stiffness: torque at the frame's hinge that stretches the belt by a radian of it;
            the belts of a world stretch with `belts="stretch"` alone [N m/rad]
    """

    stiffness: float = field(metadata=key("angular stiffness", above=0.0))


@dataclass(frozen=True)
class CouplingKeys:
    """Keys of the coupling of a tool's actuators and joints.

    Attributes:
        joints: names, in the order of the rows
        actuator_to_joint: rows of A in q = A q_actuator
    """

    joints: tuple[str, ...] = field(metadata=key(default=()))
    actuator_to_joint: object = field(default=None, metadata=key(form="any", default=...))


@dataclass(frozen=True)
class ArmPoseKeys:
    """Keys of a named pose of an arm.

    Attributes:
        name: of the pose
        q: joints of this file; a tool's are appended to the arm's [rad or m]
    """

    name: str = field(metadata=key())
    q: Array = field(metadata=key("position"))


@dataclass(frozen=True, eq=False)
class Parts:
    """The contents that arm files and tool files have in common."""

    joints: tuple[JointDescription, ...]
    frames: tuple[Frame, ...]
    closures: tuple[Closure, ...]
    bodies: tuple[Body, ...]
    friction: Mapping[str, Mapping[str, Friction]]
    rotor: Mapping[str, float]
    belts: Mapping[str, float]
    control: Mapping[str, Control]
    poses: Mapping[str, Array]
    sources: Mapping[str, str]
    block_sources: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class ToolDescription:
    """An instrument that mounts on an arm; its frames hang on the arm's tool frame.

    Attributes:
        name, title, source, file: its identification
        fits: generations of arms that it mounts on; empty when on any
        tip: the frame whose pose is the tip's
        parts: its joints, frames, bodies and what belongs to them
        coupling: its actuators, None when unknown
    """

    name: str
    title: str
    source: str
    file: str
    fits: tuple[str, ...]
    tip: str
    parts: Parts
    coupling: Coupling | None


def read_tool(table: Table) -> ToolDescription:
    """Read a tool.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table.check_schema()
    keys = table.record(ToolKeys)
    parts = _read_parts(table, keys.name)
    coupling = read_coupling(table)
    table.done()
    return ToolDescription(
        keys.name, keys.title, keys.source, table.file, keys.fits, keys.tip, parts, coupling
    )


def read_arm(table: Table, tool: ToolDescription | None) -> ArmDescription:
    """Read an arm and mount a tool on it.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
        InputError: the tool is for arms of another generation
    """
    table.check_schema()
    keys, path = table.record(ArmKeys), table.file
    name, tip = keys.name, keys.tip
    missing = table.each("missing", lambda row: row.record(Missing))
    parts = _read_parts(table, name)
    balance = read_counterweight(table)
    plan = read_calibration(table)
    links = table.each("gravity_link", _read_gravity_link, again="name")
    table.raw("erratum")  # of the arm's source; descriptions.paper reads them
    table.done()
    if not parts.frames or parts.frames[0].name != keys.root:
        raise table.fail("root", f"got {keys.root!r}; allowed: the first frame")
    if tool is not None and not keys.tool_frame:
        raise table.fail("tool_frame", f"is missing, so no tool ({tool.name}) can be mounted")
    if tool is not None:
        check_fit(name, keys.generation, tool)
        parts, tip = _mount(parts, tool), tool.tip
    try:
        mechanism = check_mechanism(
            Mechanism(
                name,
                tuple(_public(j) for j in parts.joints),
                parts.frames,
                parts.closures,
                keys.relative_to,
                tip,
            )
        )
    except DescriptionError:
        raise
    except TrocarError as problem:
        raise DescriptionError(path, "frame", str(problem)) from problem
    arm = ArmDescription(
        name=name,
        type=keys.type,
        generation=keys.generation,
        title=keys.title,
        source=keys.source,
        file=path,
        mechanism=mechanism,
        joints=parts.joints,
        bodies=_balanced(parts, mechanism, balance, path),
        friction=parts.friction,
        rotor=parts.rotor,
        belts=parts.belts,
        control=parts.control,
        poses=parts.poses,
        tool="" if tool is None else tool.name,
        tool_frame=keys.tool_frame,
        coupling=None if tool is None else tool.coupling,
        inverse_kinematics=keys.inverse_kinematics,
        missing=missing,
        row_sources=parts.sources,
        block_sources=parts.block_sources,
        calibration=plan,
        gravity_links=links,
    )
    if plan is not None and (problem := check_plan(plan, mechanism)):
        raise table.fail("calibration.axes", problem)
    check_arm(arm)
    return arm


def check_fit(arm: str, generation: str, tool: ToolDescription) -> None:
    """Reject a tool that is made for arms of another generation.

    Raises:
        InputError: naming both
    """
    if tool.fits and generation and generation not in tool.fits:
        raise InputError(
            f"{tool.name}: does not fit {arm}, which is of generation {generation};"
            f" it fits {', '.join(tool.fits)}"
        )


def _read_parts(table: Table, part: str) -> Parts:
    joints = table.each("joint", read_joint)
    sources = {row.text("name"): row.text("source", "") for row in table.tables("frame")}
    frames = table.each("frame", read_frame)
    hinges = table.each("closure", read_closure)
    known = {frame.name: frame for frame in frames}
    at = rest_poses(known)  # a closure on other frames is rejected with the whole mechanism
    pins = [c for c, slides in hinges if slides and c.frame_a in at and c.frame_b in at]
    bodies = table.each("body", lambda row: read_body(row, part))
    return Parts(
        joints,
        (*frames, *(pin_frame(closure, known) for closure in pins)),
        tuple(pinned(closure) if closure in pins else closure for closure, _ in hinges),
        (*bodies, *(pin_body(closure.name, part) for closure in pins)),
        read_friction(table),
        {**read_rotor(table), **{pin_name(closure.name): PIN_ROTOR_KG for closure in pins}},
        read_belts(table),
        read_control(table),
        dict(
            table.each("pose", lambda r: (r.text("name"), r.vector("q", len(joints), "position")))
        ),
        sources,
        _block_sources(table),
    )


def _block_sources(table: Table) -> dict[str, str]:
    """Return the source of each block that is no row, {block: source}."""
    blocks = [(name, table.optional_table(name)) for name in ("rotor", "belts", "coupling")]
    for kind in ("friction", "control"):
        several = table.optional_table(kind)
        blocks += [(f"{kind} {name}", several.table(name)) for name in several.entries()]
    blocks += [(f"loop {row.text('name')}", row) for row in table.tables("closure")]
    blocks += [(f"pose {row.text('name')}", row) for row in table.tables("pose")]
    found = {name: block.text("source", "") for name, block in blocks}
    return {name: source for name, source in found.items() if source}


def _public(joint: JointDescription) -> Joint:
    return Joint(joint.name, joint.kind, joint.lower, joint.upper, joint.drive)


def _mount(arm: Parts, tool: ToolDescription) -> Parts:
    """Append a tool's parts to an arm's; poses and control sets join by name."""
    extra = tool.parts
    control = {
        name: replace(
            preset,
            pid={**preset.pid, **extra.control[name].pid},
            observer={**preset.observer, **extra.control[name].observer},
            disc_observer=extra.control[name].disc_observer or preset.disc_observer,
            pid_output_max={**preset.pid_output_max, **extra.control[name].pid_output_max},
        )
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
        {**arm.belts, **extra.belts},
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
    parts: Parts, mechanism: Mechanism, balance: Counterweight | None, file: str
) -> tuple[Body, ...]:
    """Return the bodies with the counterweight's mass set by what rides on its joint."""
    for body in parts.bodies:
        check_name(file, "body.frame", body.frame, [f.name for f in parts.frames])
    if balance is None:
        return parts.bodies
    check_name(file, "counterweight.body", balance.body, [b.frame for b in parts.bodies])
    check_name(file, "counterweight.joint", balance.joint, mechanism.joint_names)
    drive = next(j.drive[0][0] for j in parts.joints if j.name == balance.joint)
    index = mechanism.frame_index[drive]
    riding = sum(b.mass for b in parts.bodies if index in mechanism.chain(b.frame))
    mass = riding / balance.ratio
    return tuple(
        replace(b, mass=mass, inertia=b.inertia * mass / b.mass) if b.frame == balance.body else b
        for b in parts.bodies
    )


#: Ratios in a file are decimal numbers of about sixteen digits.
INVERSE_TOLERANCE = 1e-9


def check_arm(arm: ArmDescription) -> None:
    """Reject unknown names, missing gains, and contradictions.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    joints, frames = arm.mechanism.joint_names, tuple(arm.mechanism.frame_index)
    for name in joints:
        if joints.count(name) > 1:
            raise DescriptionError(arm.file, "joint", f"got {name!r} a second time")
    for joint in arm.joints[:-1]:
        if joint.spring is not None:
            raise DescriptionError(
                arm.file, f"joint {joint.name}.spring", "allowed: on the last joint only"
            )
    for model, entries in arm.friction.items():
        for name in entries:
            check_name(arm.file, f"friction.{model}", name, dict.fromkeys((*joints, *frames)))
    for name in arm.rotor:
        check_name(arm.file, "rotor", name, frames)
    driven = {frame for joint in arm.joints for frame, _ in joint.drive}
    driven |= {frame for closure in arm.mechanism.closures for frame in closure.passive}
    turning = [f for f in arm.mechanism.frames if f.motion == "revolute" and f.couplings]
    for name in arm.belts:
        check_name(arm.file, "belts", name, [f.name for f in turning if f.name not in driven])
    for preset in arm.control.values():
        for name in preset.pid:
            check_name(arm.file, f"control.{preset.name}.pid", name, joints)
        for name in preset.observer:
            check_name(arm.file, f"control.{preset.name}.observer", name, joints)
        for name in preset.pid_output_max:
            check_name(arm.file, f"control.{preset.name}.pid_output_max", name, joints)
        driven = () if arm.coupling is None else arm.coupling.joints
        if driven and preset.disc_observer:
            place, discs = f"control.{preset.name}.disc_observer", len(preset.disc_observer)
            if discs != len(driven):
                problem = f"got {discs}; allowed: {len(driven)}, one of each disc of its instrument"
                raise DescriptionError(arm.file, place, problem)
            if both := [name for name in driven if name in preset.observer]:
                problem = f"{both[0]} has an observer of its own; allowed: of joints or discs"
                raise DescriptionError(arm.file, place, problem)
        lacking = [name for name in joints if name not in preset.pid]
        if lacking:
            raise DescriptionError(
                arm.file, f"control.{preset.name}.pid", f"has no gains for {', '.join(lacking)}"
            )
    for link in arm.gravity_links:
        for name in link.q:
            check_name(arm.file, f"gravity_link {link.name}.q", name, joints)
    _check_poses(arm)
    _check_drives(arm)


def check_name(file: str, key: str, name: str, known: Iterable[str]) -> None:
    """Reject a name that is not known.

    Raises:
        DescriptionError: with the known names
    """
    known = tuple(known)
    if name not in known:
        raise DescriptionError(file, key, f"got {name!r}; allowed: {', '.join(known)}")


def _check_poses(arm: ArmDescription) -> None:
    lower, upper = arm.mechanism.lower, arm.mechanism.upper
    for name, q in arm.poses.items():
        if (q < lower).any() or (q > upper).any():
            raise DescriptionError(
                arm.file,
                f"pose {name}",
                f"got {q.tolist()}; allowed: {lower.tolist()} to {upper.tolist()}",
            )


def _check_drives(arm: ArmDescription) -> None:
    """Reject drives and couplings that are not each other's inverse."""
    mechanism = arm.mechanism
    for row, joint in enumerate(mechanism.joints):
        moved = sum(w * mechanism.ratios[mechanism.frame_index[f]] for f, w in joint.drive)
        if np.abs(moved - np.eye(len(mechanism.joints))[row]).max() > INVERSE_TOLERANCE:
            frame, weight = joint.drive[0]
            raise DescriptionError(
                arm.file,
                f"joint {joint.name}.drive",
                f"got {frame} = {weight:g}, but {frame} moves by"
                f" {dict(mechanism.frame(frame).couplings)}; allowed: the inverse",
            )
