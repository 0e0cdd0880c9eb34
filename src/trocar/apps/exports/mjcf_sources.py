"""Where every mass, gain and axis of an export is from: tables for its README."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.modeling.hinges import hinge_of
from trocar.modeling.menagerie.sheet import preset

#: How a body's inertia came about, in words.
INERTIA = {"source": "as the source has it", "shape": "of its shape", "solid": "of its solid"}


def sources(rig: RigDescription) -> dict[str, str]:
    """Return sections {heading: text}, one set for each description and instrument of a rig."""
    found: dict[str, str] = {}
    for place in rig.arms:
        arm = place.arm
        title = arm.name + (f" with {arm.tool}" if arm.tool else "")
        if f"Masses: {title}" in found:
            continue
        control = preset(place)
        found[f"Masses: {title}"] = _masses(arm)
        gains = f"Source of the gains: {_gains(arm, control.name)}."
        found[f"Servos: {title}"] = f"{_motors(arm, control.name)}\n\n{gains}{_efforts(arm)}"
        found[f"Friction and rotors: {title}"] = f"{_friction(arm)}\n\n{_blocks(arm)}"
        found[f"Axes and loops: {title}"] = _axes(arm)
    return found


def _masses(arm: ArmDescription) -> str:
    rows = [
        (b.frame, f"{b.mass:.6g}", INERTIA[b.inertia_from], _line(b.source) or "-")
        for b in arm.bodies
    ]
    return table(("frame", "mass [kg]", "inertia", "source"), rows)


def _motors(arm: ArmDescription, control: str) -> str:
    rows: list[Sequence[str]] = []
    for joint in arm.joints:
        gains = arm.control[control].pid[joint.name]
        turns = joint.kind == "revolute"
        rows.append(
            (
                joint.name,
                "-" if joint.spring else f"{gains.p:g}",
                "-" if joint.spring else f"{gains.d:g}",
                f"{joint.effort_max:g} {'N m' if turns else 'N'}",
                f"{joint.lower:.6g} to {joint.upper:.6g} {'rad' if turns else 'm'}",
            )
        )
    return table(("joint", "P", "D", "largest effort", "range"), rows)


def _gains(arm: ArmDescription, control: str) -> str:
    found = [s for block, s in arm.block_sources.items() if block.endswith(f"control {control}")]
    return "; ".join(dict.fromkeys(_line(source).rstrip(".") for source in found))


def _efforts(arm: ArmDescription) -> str:
    own = [f"{joint.name}: {_line(joint.source)}" for joint in arm.joints if joint.source]
    whole = f" Limits and largest efforts: {_line(arm.source)}"
    tool = arm.block_sources.get(arm.tool, "") if arm.tool else ""
    parts = [whole.rstrip("."), *([_line(tool)] if tool else []), *own]
    return ". ".join(part.rstrip(".") for part in parts) + "."


def _friction(arm: ArmDescription) -> str:
    rows: list[Sequence[str]] = []
    for frame in arm.mechanism.frames:
        if frame.motion == "fixed":
            continue
        feels = hinge_of(arm, frame.name, "identified")
        rows.append(
            (frame.name, f"{feels.frictionloss:g}", f"{feels.damping:g}", f"{feels.armature:g}")
        )
    return table(("frame", "dry [N m, N]", "viscous [N m s, N s/m]", "rotor [kg m2, kg]"), rows)


def _blocks(arm: ArmDescription) -> str:
    wanted = ("friction identified", "rotor")
    rows = [
        f"- {block}: {_line(source)}"
        for block, source in arm.block_sources.items()
        if block.endswith(wanted)
    ]
    return "\n".join(rows)


def _axes(arm: ArmDescription) -> str:
    rows = [(f"`{name}`", _line(source)) for name, source in arm.row_sources.items() if source]
    rows += [
        (f"`{block}`", _line(source))
        for block, source in arm.block_sources.items()
        if block.startswith("loop ")
    ]
    return f"{_line(arm.source)}\n\n{table(('frame', 'source'), rows)}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _line(text: str) -> str:
    """Return a source on one line that a table can have."""
    return " ".join(text.split()).replace("|", "/")
