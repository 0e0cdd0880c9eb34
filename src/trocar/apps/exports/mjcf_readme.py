"""What the README of an MJCF export says: versions, use, other scenes, how it was made."""

from __future__ import annotations

from trocar.apps.exports.mjcf_sources import sources, table
from trocar.apps.exports.task import Task
from trocar.descriptions.records import RigArm
from trocar.modeling.markup import document
from trocar.modeling.menagerie import MJX, PID, POSITION, file_name, option_block
from trocar.modeling.menagerie.sheet import Sheet

#: What the files were tried with. Source: docs/exports.md, "Versions of MuJoCo".
TRIED = "3.13.0, 3.17.0 and 4.0.0"
TRIED_MJX = "3.8.0, 3.13.0, 3.17.0 and 4.0.0"


def sections(task: Task, *, picture: bool) -> dict[str, str]:
    """Return the README's sections in their order, {heading: text}."""
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
        **sources(task.rig),
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
    listed = table(("file", "what"), rows)
    return (
        f"{listed}\n\nWhat is seen is in group 2, what touches in group 3, frames are sites in"
        " group 4."
    )


def _use(task: Task) -> str:
    servos = [joint for place in task.rig.arms for joint in place.arm.joints]
    first = f"{_prefix(task, task.rig.arms[0])}{servos[0].name}"
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
        f"`{name}.xml`: `position` with the gains P and D of the robot's own controllers. Bodies"
        " weigh nothing (`gravcomp`), because those controllers carry the weight by themselves; so"
        " a position is reached without sag. `kv` damps the measured velocity: a joint that moves"
        " at v lags by D v / P.",
        f"`{name}{PID.suffix}.xml`: `pid`, three numbers a joint in `ctrl`: position, velocity,"
        " effort that is fed forward. Bodies have their weight, and feeding it forward is up to"
        " you; the keyframe does it. With the same `ctrl` it moves as trocar's simulation does, to"
        " 1e-9 over 10 s. In its first milliseconds the loops take up the weight, by 0.1 um.",
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
    sheet = Sheet.of(task.rig, POSITION, {})
    block = document(
        option_block(sheet, sum(j.hinge is not None for j in task.model.joints))
    ).decode()
    block = block.partition("\n")[2].strip()
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
        "What hinges and servos share is in default classes named after the public joints.",
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


def _prefix(task: Task, place: RigArm) -> str:
    return Sheet.of(task.rig, POSITION, {}).name(place.name, "")
