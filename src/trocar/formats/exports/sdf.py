"""An SDF folder: model, world, card, meshes and README."""

from __future__ import annotations

from trocar.formats.exports.task import (
    ExportTask,
    filled,
    left_out,
    markdown_table,
    readme,
    write_meshes,
)
from trocar.formats.links import LinkJoint, LinkModel
from trocar.formats.sdf import card, check_version, model_name, sdf, world

MODEL = "model.sdf"


def write_sdf(task: ExportTask) -> tuple[str, ...]:
    """Fill a folder, and return what plain SDF cannot say of this rig.

    Raises:
        UnknownNameError: a version of SDF that cannot be written
    """
    version = check_version(task.options.sdf_version)
    name = f"{model_name(task.model)}.world.sdf"
    files = {
        MODEL: sdf(task.model, version, task.meshes),
        name: world(task.model, version, task.meshes),
        "model.config": card(task.model, version, MODEL),
        "README.md": _readme(task, version, name).encode(),
    }
    for file, data in files.items():
        (task.folder / file).write_bytes(data)
    write_meshes(task.meshes, task.folder / "meshes")
    return (*left_out(task.rig), *_warnings(task.model, version))


def coupled(model: LinkModel) -> list[LinkJoint]:
    """Return the joints that follow another, and not by a loop."""
    return [joint for joint in model.joints if joint.follows and not joint.in_loop]


def _warnings(model: LinkModel, version: str) -> tuple[str, ...]:
    loose = [
        joint.name
        for joint in coupled(model)
        if version == "1.9" or (version == "1.7" and joint.kind == "prismatic")
    ]
    return (
        (
            f"SDF {version} cannot couple these joints, which move freely in Gazebo:"
            f" {', '.join(loose)} (see README.md; --sdf-version 1.11 couples them)",
        )
        if loose
        else ()
    )


def _readme(task: ExportTask, version: str, world_file: str) -> str:
    model = task.model
    loops = ", ".join(f"`{loop.name}_joint`" for loop in model.loops)
    rows: list[tuple[str, str]] = []
    for joint in coupled(model):
        leads = " + ".join(f"{ratio:g} * {name}_joint" for name, ratio in joint.follows)
        rows.append((f"{joint.name}_joint", leads))
    how = {
        "1.7": "Turning pairs are geared (`gearbox`); a slide that follows is free.",
        "1.9": "Drake couples them (`drake:mimic`, discrete plants); in Gazebo they are free.",
        "1.11": "Gazebo from Harmonic on couples them (`mimic`), with its bullet-featherstone.",
    }[version]
    table = markdown_table(("joint", "follows"), rows)
    body = filled(
        "sdf.md",
        model=MODEL,
        version=version,
        world=world_file,
        loops=filled("sdf_loops.md", names=loops) if loops else "",
        couplings=filled("sdf_couplings.md", rows=table, how=how) if rows else "",
        left_out="".join(f"\n- {text}." for text in left_out(task.rig)),
    )
    return readme(task, "sdf", body)
