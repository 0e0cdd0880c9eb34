"""The README of an MJCF export: versions, use, other scenes, how it was made, sources."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from trocar.apps.exports.task import Task
from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.modeling.build import preset
from trocar.modeling.hinges import hinge_of
from trocar.modeling.mjcf import MJX, PID, POSITION, file_name, prefix

#: What the files were tried with. Source: docs/exports.md, "Versions of MuJoCo".
TRIED = "3.13.0, 3.17.0 and 4.0.0"
TRIED_MJX = "3.8.0, 3.13.0, 3.17.0 and 4.0.0"
#: How a body's inertia came about, in words.
INERTIA = {"source": "as the source has it", "shape": "of its shape", "solid": "of its solid"}


def sections(task: Task, *, picture: bool) -> dict[str, str]:
    """Return the README's sections in their order, {heading: text}.

    The folder of the task has the model already: its option block is quoted.
    """
    name = file_name(task.rig)
    shown = {"Picture": f"![{task.model.title}]({name}.png)"} if picture else {}
    return {
        **shown,
        "Requirements": _requirements(name),
        "Files": _files(task, name),
        "Use": _use(task),
        "Servos": _servos(task, name),
        "In another scene": _attach(task, name),
        "How it was made": _derivation(name),
        **_sources(task.rig),
    }


def _requirements(name: str) -> str:
    return (
        f"MuJoCo {POSITION.minimum} or later for `{name}.xml` and `{name}{PID.suffix}.xml` (the"
        f" integrator `discrete` is new in it), {MJX.minimum} or later for"
        f" `{name}{MJX.suffix}.xml`. The built-in arms and rigs were tried with {TRIED},"
        f" `{MJX.suffix}` with {TRIED_MJX}. Nothing else is needed, trocar neither."
    )


def _files(task: Task, name: str) -> str:
    rows = [
        (f"{name}.xml", "the robot; `ctrl` is joint positions"),
        (f"{name}{PID.suffix}.xml", "the robot with the servos of trocar's simulation"),
        (f"{name}{MJX.suffix}.xml", "the robot with what MJX (JAX) supports; not tried with MJX"),
        ("scene.xml, scene_mjx.xml", "the robot with light and a floor"),
    ]
    if task.meshes:
        rows.append(("assets/", "meshes, in metres"))
    listed = _table(("file", "what"), rows)
    return (
        f"{listed}\n\nWhat is seen is in group 2, what touches in group 3, frames are sites in"
        " group 4."
    )


def _use(task: Task) -> str:
    servos = [joint for place in task.rig.arms for joint in place.arm.joints]
    first = f"{prefix(task.rig, task.rig.arms[0].name)}{servos[0].name}"
    return f"""```python
import mujoco

model = mujoco.MjModel.from_xml_path("scene.xml")
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
data.actuator("{first}").ctrl = 0.1
mujoco.mj_step(model, data, nstep=1000)
print(data.sensor("{first}_position").data)
```

`python -m mujoco.viewer --mjcf=scene.xml` shows it. The {len(servos)} servos are called as the
public joints of the da Vinci Research Kit; each has the sensors `_position`, `_velocity` and
`_effort`. Hinges are called so too, but those that a servo moves by a gear: a jaw opens by twice
what `finger_left` turns. All other hinges are passive: loops and couplings move them."""


def _servos(task: Task, name: str) -> str:
    said = [
        f"`{name}.xml`: MuJoCo's `position` (written as `general`: P is `gainprm`, -P and -D are in"
        " `biasprm`) with the gains of the robot's own controllers. Bodies weigh nothing"
        " (`gravcomp`), because those controllers carry the weight by themselves; so a position is"
        " reached without sag. D damps the measured velocity: a joint that moves at v lags by"
        " D v / P.",
        f"`{name}{PID.suffix}.xml`: MuJoCo's `pid`, three numbers a joint in `ctrl`: position,"
        " velocity, effort that is fed forward. Bodies have their weight, and feeding it forward is"
        " up to you; the keyframe does it. With the same `ctrl` it moves as trocar's simulation"
        " does, to 1e-9 over 10 s. In its first milliseconds the loops take up the weight, by"
        " 0.1 um.",
        "`forcerange` is what the motors can do, `ctrlrange` the joints' limits. A jaw below 0 is"
        " grip: the fingers meet at 0, and P times the rest is the force.",
    ]
    kinds = {place.arm.type for place in task.rig.arms}
    if "SUJ" in kinds:
        said.append(
            f"Setup joints have no motors. In `{name}.xml` servos stand for the hands that move"
            f" them; in `{name}{PID.suffix}.xml` their brakes hold them (a damping of 1e12), and"
            " their servos are switched off by group."
        )
    if any(place.arm.has_gripper for place in task.rig.arms):
        said.append(
            "A gripper has a spring and no motor: its `ctrl` is the effort of a person's fingers."
        )
    return "\n".join(f"- {text}" for text in said)


def _attach(task: Task, name: str) -> str:
    text = (task.folder / f"{name}.xml").read_text(encoding="utf-8")
    start, end = text.index("<option"), text.index("</option>")
    block = textwrap.dedent(f"  {text[start:end]}</option>")
    twice = (
        "Two robots from such files do not touch each other. For that give one of them"
        ' `contype="4" conaffinity="3"` in its class `collision`.'
        if len(task.rig.arms) == 1 and not task.rig.props
        else "Which arms touch which is in the classes `..._collision`."
    )
    return f"""The option block is the parent's: MuJoCo keeps that and warns that it drops this one.
Copy it:

```xml
{block}
```

`integrator` and `jacobian` are needed: with others the loops tear under stiff servos, and the
sparse solver of MuJoCo 4.0.0, which it takes from 60 degrees of freedom on, throws such chains
about. The time constants of loops, stops and contacts are for this `timestep`. `cone` and
`impratio` matter when something is gripped. Without `autoreset="disable"` MuJoCo starts again where
a simulation has diverged.

```python
import mujoco

parent = mujoco.MjSpec.from_file("your_scene.xml")
for side, y in (("left_", 0.5), ("right_", -0.5)):
    child = mujoco.MjSpec.from_file("{name}.xml")
    for key in ("timestep", "integrator", "solver", "jacobian", "cone", "impratio"):
        setattr(parent.option, key, getattr(child.option, key))
    parent.attach(child, prefix=side, frame=parent.worldbody.add_frame(pos=[0, y, 0]))
model = parent.compile()
```

{twice}"""


def _derivation(name: str) -> str:
    steps = [
        "The description is read: frames and loops, masses, friction, motors and gains, each with"
        " its source (below). Where a calibration was given, its frames replace the nominal ones.",
        "Each frame becomes a body where it moves or weighs something, else a site. A hinge turns"
        " about, or slides along, z of its frame, at 0 where the da Vinci Research Kit has it.",
        "Bodies that move together become one `inertial`. Inertias that no source gives, or that"
        " could belong to no body, are those of the link's shape at its mass.",
        "Loops are closed by one `connect` between two sites (four where a loop is no"
        " parallelogram); where it is one, a `joint` equality keeps it on its branch. Couplings"
        " such as a jaw's second finger are `joint` equalities.",
        "What hinges and servos share is in default classes named after the public joints. MuJoCo"
        " itself writes the file, with all digits.",
        "Shapes that are seen become geoms of class `visual`, those that touch of class"
        " `collision`; boxes touch as capsules where the description says so.",
        "`home` is the rig's pose `start`, with the loops' coordinates computed, and `ctrl` that"
        " holds it: max |qacc| < 1e-3 after one step.",
        f"`{name}{MJX.suffix}.xml` is the same with `implicitfast`, a pyramidal cone, softer loops"
        " (under random control they gape by tens of micrometres instead of one), cylinders that"
        " touch as capsules, and meshes of at most 64 corners.",
        "The settings of the solver were measured on these arms (docs/simulation.md of trocar).",
    ]
    return "\n".join(f"{k}. {text}" for k, text in enumerate(steps, start=1))


def _sources(rig: RigDescription) -> dict[str, str]:
    """Return sections {heading: text}, one set for each description and instrument of a rig."""
    found: dict[str, str] = {}
    for place in rig.arms:
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
    return found


def _masses(arm: ArmDescription) -> str:
    rows = [
        (b.frame, f"{b.mass:.6g}", INERTIA[b.inertia_from], _line(b.source) or "-")
        for b in arm.bodies
    ]
    return _table(("frame", "mass [kg]", "inertia", "source"), rows)


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
    return _table(("joint", "P", "D", "largest effort", "range"), rows)


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
    return _table(("frame", "dry [N m, N]", "viscous [N m s, N s/m]", "rotor [kg m2, kg]"), rows)


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
    return f"{_line(arm.source)}\n\n{_table(('frame', 'source'), rows)}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _line(text: str) -> str:
    """Return a source on one line that a table can have."""
    return " ".join(text.split()).replace("|", "/")
