"""An SDF folder: model, world, card, meshes and README."""

from __future__ import annotations

from trocar.apps.exports.meshes import write_meshes
from trocar.apps.exports.readme import readme
from trocar.apps.exports.task import Task, left_out
from trocar.modeling.links import LinkJoint, LinkModel
from trocar.modeling.sdf import card, check_version, model_name, sdf, world

MODEL = "model.sdf"


def write_sdf(task: Task) -> tuple[str, ...]:
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
        "README.md": readme(task, "sdf", _sections(task, version, name)).encode(),
    }
    for file, data in files.items():
        (task.folder / file).write_bytes(data)
    write_meshes(task.meshes, task.folder / "meshes")
    return (*left_out(task.rig), *_warnings(task.model, version))


def coupled(model: LinkModel) -> list[LinkJoint]:
    """Return the joints that follow another, and not by a loop."""
    return [joint for joint in model.joints if joint.follows and not joint.in_loop]


def _warnings(model: LinkModel, version: str) -> tuple[str, ...]:
    loose = [j for j in coupled(model) if version == "1.9" or _unsaid(j, version)]
    if not loose:
        return ()
    names = ", ".join(joint.name for joint in loose)
    return (
        f"SDF {version} has no words for what these follow, and Gazebo lets them go: {names}"
        " (README.md; --sdf-version 1.11 has)",
    )


def _unsaid(joint: LinkJoint, version: str) -> bool:
    return version == "1.7" and joint.kind == "prismatic"


def _sections(task: Task, version: str, world_file: str) -> dict[str, str]:
    model = task.model
    found = {
        "Files": f"""
- `{MODEL}`: the robot, SDF {version}, one model fixed to the world; `model.config`: its card
- `{world_file}`: the same robot with ground and sun; open this
- `meshes/`: what links look like and touch with, in metres, named relative to the files (a
  robot of boxes and cylinders has none)""",
        "Names": """
A link or frame has the name of the description's frame, a joint ends in `_joint`. Joints count
from where the public joints are at 0 and the loops are closed, which is the pose in the file.""",
    }
    if model.loops:
        found["Loops"] = _loops(model)
    if coupled(model):
        found["Couplings"] = _couplings(model, version)
    found["What plain SDF cannot say"] = """
- Inertia of the rotors: Drake reads it (`drake:rotor_inertia`, not in 1.7), Gazebo has none.
- Who touches whom: Drake reads it (`drake:collision_filter_group`, not in 1.7): an arm touches
  other arms and what stands, never itself nor its carrier. In Gazebo links of one model touch only
  what else is in the world; `<self_collide>true</self_collide>` changes that for all of them, the
  arm's own links included.
- The link `ground` holds what stands still; it has the format's default mass of 1 kg, which
  nothing feels, as it is fixed to the world."""
    found["What plain SDF cannot say"] += "".join(f"\n- {text}." for text in left_out(task.rig))
    return found


def _loops(model: LinkModel) -> str:
    names = ", ".join(f"`{loop.name}_joint`" for loop in model.loops)
    return f"""
{names}: joints that close a loop, last in the file; their child link has a second parent. Gazebo
Classic's engine ODE simulates them. The engines of the newer Gazebo build trees and leave these
joints out, with a message that the child has a parent already: the linkage then hangs open (the
URDF of `trocar export` follows by `mimic` there). Drake refuses the file: replace them by ball
constraints, as docs/exports.md of trocar shows. Where hinges are skew (a calibrated robot) such a
joint is a ball."""


def _couplings(model: LinkModel, version: str) -> str:
    rows = ["| joint | follows |", "|---|---|"]
    for joint in coupled(model):
        leads = " + ".join(f"{ratio:g} * {name}_joint" for name, ratio in joint.follows)
        rows.append(f"| {joint.name}_joint | {leads} |")
    how = {
        "1.7": "Turning pairs are geared (`gearbox`); a slide that follows is free.",
        "1.9": "Drake couples them (`drake:mimic`, discrete plants); in Gazebo they are free.",
        "1.11": "Gazebo from Harmonic on couples them (`mimic`), with its bullet-featherstone.",
    }[version]
    free = """
Where a joint is free, send it the position of the one it follows, times the ratio: it has the
effort for that. Left alone, a counterweight slides to its stop and a finger swings."""
    return "\n".join([*rows, "", how, free])
