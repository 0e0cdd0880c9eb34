"""An export as MuJoCo Menagerie wants a folder: models, scenes, picture, licence, README."""

from __future__ import annotations

import shutil
from pathlib import Path

from trocar import __version__
from trocar.apps.exports.meshes import write_meshes
from trocar.apps.exports.mjcf_readme import sections
from trocar.apps.exports.readme import readme
from trocar.apps.exports.task import Task
from trocar.errors import TrocarError
from trocar.modeling.build import preset
from trocar.modeling.mjcf import (
    MESH_FOLDER,
    MJX,
    POSITION,
    VARIANTS,
    file_name,
    mjcf_document,
    scene_document,
)
from trocar.rendering.portrait import write_pictures

#: Of the picture [px]. Source: our own choice; Menagerie's READMEs show theirs 400 px wide.
PICTURE = (800, 600)


def write_mjcf(task: Task) -> tuple[str, ...]:
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
    page = readme(task, "mjcf", sections(task, picture=not blind))
    (folder / "README.md").write_text(page, encoding="utf-8")
    return (*blind, *_lost(task))


def _draw(task: Task, path: Path) -> tuple[str, ...]:
    """Draw the rig; return why there is no picture, or nothing."""
    try:
        (drawn,) = write_pictures(task.rig, path.parent, ("three_quarter",), PICTURE)
    except TrocarError as problem:
        return (f"without a picture: {problem}",)
    drawn.rename(path)
    return ()


def _lost(task: Task) -> tuple[str, ...]:
    """Return what the files do not have of the description."""
    said = [f"sensor {sensor.name} is not written" for sensor in task.rig.sensors]
    name = file_name(task.rig)
    for place in task.rig.arms:
        integral = [j for j, gains in preset(place.arm).pid.items() if gains.i]
        if integral:
            said.append(
                f"{place.name}: the integral gain of {', '.join(integral)} is in {name}_pid.xml"
                " alone; a position servo has none"
            )
    return tuple(said)


def _changelog(task: Task) -> str:
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
