"""An export as MuJoCo Menagerie wants a folder: models, scenes, picture, licence, README."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path

from trocar import __version__
from trocar.descriptions.records import ArmDescription
from trocar.errors import TrocarError
from trocar.formats.exports.task import ExportTask, filled, markdown_table, readme, write_meshes
from trocar.formats.mjcf import (
    MESH_FOLDER,
    MJX,
    POSITION,
    VARIANTS,
    file_name,
    mjcf_document,
    prefix,
    scene_document,
)
from trocar.modeling.build import preset
from trocar.modeling.hinges import hinge_of
from trocar.rendering.stills import write_pictures

#: How a body's inertia came about, in words.
INERTIA = {"source": "as the source has it", "shape": "of its shape", "solid": "of its solid"}
#: Of the picture [px]. Source: our own choice; Menagerie's READMEs show theirs 400 px wide.
PICTURE = (800, 600)


def write_mjcf(task: ExportTask) -> tuple[str, ...]:
    """Fill a folder with a rig's MJCF files and what goes with them; return warnings."""
    name, folder = file_name(task.rig), task.folder
    for variant in VARIANTS:
        text, meshes = mjcf_document(task.rig, variant)
        (folder / f"{name}{variant.suffix}.xml").write_bytes(text)
        write_meshes({mesh: stem for stem, mesh in meshes.items()}, folder / MESH_FOLDER)
    for variant in (POSITION, MJX):
        scene = scene_document(task.rig, variant)
        (folder / f"scene{variant.suffix}.xml").write_bytes(scene)
    shutil.copyfile(Path(__file__).with_name("LICENSE"), folder / "LICENSE")
    (folder / "CHANGELOG.md").write_text(_changelog(task), encoding="utf-8")
    blind = _draw(task, folder / f"{name}.png")
    (folder / "README.md").write_text(_readme(task, picture=not blind), encoding="utf-8")
    return (*blind, *_lost(task))


def _draw(task: ExportTask, path: Path) -> tuple[str, ...]:
    """Draw the rig; return why there is no picture, or nothing."""
    try:
        (drawn,) = write_pictures(task.rig, path.parent, ("three_quarter",), PICTURE)
    except TrocarError as problem:
        return (f"without a picture: {problem}",)
    drawn.rename(path)
    return ()


def _lost(task: ExportTask) -> tuple[str, ...]:
    """Return what the files do not have of the description."""
    warnings = [f"sensor {sensor.name} is not written" for sensor in task.rig.sensors]
    warnings += [
        f"the script of {prop.name} is not written" for prop in task.rig.objects if prop.script
    ]
    name = file_name(task.rig)
    for place in task.rig.arms:
        integral = [j for j, gains in preset(place.arm).pid.items() if gains.i]
        if integral:
            warnings.append(
                f"{place.name}: the integral gain of {', '.join(integral)} is in {name}_pid.xml"
                " only; position servos have none"
            )
    return tuple(warnings)


def _changelog(task: ExportTask) -> str:
    arms = [
        f"- {place.name}: `{place.arm.name}`"
        + (f" with {place.arm.tool}" if place.arm.tool else "")
        + (f", calibrated: {Path(place.arm.overlay.file).name}" if place.arm.overlay else "")
        for place in task.rig.arms
    ]
    return "\n".join(
        [
            f"# Changelog of {task.model.title}",
            "",
            f"## Written by trocar {__version__}",
            "",
            "- First version, from the description of the robot.",
            *arms,
            "",
        ]
    )


def _readme(task: ExportTask, *, picture: bool) -> str:
    """Return the README; the folder has the model already, whose option block is quoted."""
    name, arms = file_name(task.rig), task.rig.arms
    text = (task.folder / f"{name}.xml").read_text(encoding="utf-8")
    option = text[text.index("<option") : text.index("</option>")]
    setup_joints = (
        f"\n- Setup joints have no motors. In `{name}.xml` servos stand for the hands that move"
        f" them; in `{name}_pid.xml` their brakes hold them (a damping of 1e18), and their servos"
        " are switched off by group."
    )
    gripper = (
        "\n- A gripper has a spring and no motor: its `ctrl` is the effort of a person's fingers."
    )
    alone = (
        "Two robots from such files do not touch each other. For that give one of them"
        ' `contype="4" conaffinity="3"` in its class `collision`.'
    )
    together = "Which arms touch which is in the classes `..._collision`."
    body = filled(
        "mjcf.md",
        picture=f"## Picture\n\n![{task.model.title}]({name}.png)\n\n" if picture else "",
        name=name,
        assets="\n| assets/ | meshes, in metres |" if task.meshes else "",
        servo=f"{prefix(task.rig, arms[0].name)}{arms[0].arm.joints[0].name}",
        servos=sum(len(place.arm.joints) for place in arms),
        setup_joints=setup_joints if any(place.arm.type == "SUJ" for place in arms) else "",
        grippers=gripper if any(place.arm.has_gripper for place in arms) else "",
        option=textwrap.dedent(f"  {option}</option>"),
        touch=alone if len(arms) == 1 and not task.rig.props else together,
    )
    return readme(task, "mjcf", body + _sources(task))


def _sources(task: ExportTask) -> str:
    """Return sections with the sources of each description and instrument of a rig."""
    found: dict[str, str] = {}
    for place in task.rig.arms:
        arm = place.arm
        title = arm.name + (f" with {arm.tool}" if arm.tool else "")
        if f"Masses: {title}" in found:
            continue
        control = preset(arm)
        found[f"Masses: {title}"] = _masses(arm)
        gains = f"Source of the gains: {_gains(arm, control.name)}."
        found[f"Servos: {title}"] = f"{_motors(arm, control.name)}\n\n{gains}{_efforts(arm)}"
        found[f"Friction and rotors: {title}"] = f"{_friction(arm)}\n\n{_blocks(arm)}"
        found[f"Axes and loops: {title}"] = _axes(arm)
    return "".join(f"\n## {heading}\n\n{text}\n" for heading, text in found.items())


def _masses(arm: ArmDescription) -> str:
    rows = [
        (b.frame, f"{b.mass:.6g}", INERTIA[b.inertia_from], _line(b.source) or "-")
        for b in arm.bodies
    ]
    return markdown_table(("frame", "mass [kg]", "inertia", "source"), rows)


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
    return markdown_table(("joint", "P", "D", "largest effort", "range"), rows)


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
    return markdown_table(
        ("frame", "dry [N m, N]", "viscous [N m s, N s/m]", "rotor [kg m2, kg]"), rows
    )


def _blocks(arm: ArmDescription) -> str:
    blocks = ("friction identified", "rotor")
    rows = [
        f"- {block}: {_line(source)}"
        for block, source in arm.block_sources.items()
        if block.endswith(blocks)
    ]
    return "\n".join(rows)


def _axes(arm: ArmDescription) -> str:
    rows = [(f"`{name}`", _line(source)) for name, source in arm.row_sources.items() if source]
    rows += [
        (f"`{block}`", _line(source))
        for block, source in arm.block_sources.items()
        if block.startswith("loop ")
    ]
    return f"{_line(arm.source)}\n\n{markdown_table(('frame', 'source'), rows)}"


def _line(text: str) -> str:
    """Return a source on one line that a table can have."""
    return " ".join(text.split()).replace("|", "/")
