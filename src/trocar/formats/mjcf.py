"""MJCF: standalone robots in the style of MuJoCo Menagerie, and files as MuJoCo compiles them.

A body with several joints is read as as many links, one behind the other.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import textwrap
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar import __version__
from trocar.descriptions.inertial import holding_efforts
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import ArmDescription, RigArm, RigDescription, Shape, ShapeKind
from trocar.errors import TrocarError
from trocar.formats.folder import (
    TEMPLATES,
    ExportTask,
    filled,
    markdown_table,
    readme,
    write_meshes,
)
from trocar.formats.format import Format
from trocar.formats.links import (
    WORLD,
    ImportFileError,
    Link,
    LinkLoop,
    SourceJoint,
    SourceModel,
    as_tree,
    material_of,
    mesh_shape,
    solid,
)
from trocar.formats.meshes import DEFAULT_MATERIAL, ReadOptions, obj
from trocar.formats.xml_tree import (
    NOISE,
    XmlNode,
    child,
    document,
    element,
    number,
    numbers,
    read_xml,
)
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.inputs import is_file
from trocar.kinematics.forward import coordinates, pose, poses
from trocar.kinematics.mechanism import Motion
from trocar.modeling import naming
from trocar.modeling.build import SERVO_INPUTS, SITE_RADIUS_M, Draft, effort_limit, preset
from trocar.modeling.geoms import COLLISION_GROUP, VISUAL_GROUP, set_contact
from trocar.modeling.hinges import hinge_of
from trocar.modeling.mujoco_log import log_mujoco_warnings
from trocar.modeling.options import STIFF_IMPEDANCE, STIFF_STEPS, STOP_STEPS, ModelOptions

Array = NDArray[np.float64]

#: Folder of the meshes, beside the file.
MESH_FOLDER = "assets"
#: Group of sites. Source: MuJoCo Menagerie.
FRAME_GROUP = 4
#: Corners of a convex piece in MJX. Source: MuJoCo's page on MJX, 64 or less.
MOST_HULL_CORNERS = 64
#: Damping of a braked joint [N m s]. Source: simulation/servos.py, HOLDING_DAMPING.
BRAKED_DAMPING = 1e18
#: Significant digits of a float64 that reads back exactly.
EXACT_DIGITS = 17
#: Significant digits of a number in single precision.
SINGLE_DIGITS = 7
#: Time constant of loops in MJX, in physics steps. Source: the minimum of MuJoCo's flag refsafe,
#: which applies with every integrator but `discrete`.
SAFE_STEPS = 2.0
#: Attributes of hinge and servo in the default class of their joint.
JOINT_FIELDS = ("type", "range", "armature", "damping", "frictionloss", "stiffness", "springref")
SERVO_FIELDS = (
    "gear", "gaintype", "gainprm", "biastype", "biasprm", "dyntype", "dynprm", "ctrlspec",
    "ctrlrange", "forcerange",
)  # fmt: skip
#: Element that is removed: MuJoCo counts keys itself, and warns when a robot is attached.
KEY_COUNT = '  <size nkey="1"/>\n\n'
#: Numbers in attributes.
NUMBER = re.compile(r'(?<=[ "])-?\d[\d.]*(?:e[-+]\d+)?(?=[ "])')
#: Elements whose numbers MuJoCo keeps in single precision.
MATERIAL = re.compile(r"<material .*?/>")
#: Number of joint vectors for a lone arm's lowest point, and the floor's distance below that [m].
SAMPLES, CLEARANCE_M = 256, 0.15
#: Ratio of the view's extent to that of the frames. Source: by eye.
MARGIN = 1.3
#: {origin of a body's inertia: text in the README}
INERTIA = {"source": "as the source has it", "shape": "of its shape", "solid": "of its solid"}
#: Colour of a geom without one. Source: MuJoCo's XML reference, geom/rgba.
UNCOLOURED = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
#: Lowest group that MuJoCo's viewers hide by default.
HIDDEN_GROUP = 3
HINGE_KINDS: dict[int, Motion] = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}


#: Limits of the data that MuJoCo generates, {element: (attributes, largest product)}; counts of
#: nested `replicate` multiply. MuJoCo itself has no limits. Source: our own choice: a height field
#: of 1000 x 1000, textures of 4096 x 4096, and more bodies than a robot has.
MOST_MADE = {
    "hfield": (("nrow", "ncol"), 1_000_000),
    "replicate": (("count",), 1_000),
    "composite": (("count",), 10_000),
    "flexcomp": (("count",), 10_000),
    "texture": (("width", "height"), 1 << 24),
}
#: Largest value of an attribute of `size` but `memory`, which belongs to the simulation.
MOST_OF_SIZE = 10_000


@dataclass(frozen=True)
class Variant:
    """One of a robot's files: same bodies, different servos or integrator.

    Attributes:
        suffix: end of the file's name
        servo: "position": `ctrl` is the joints' positions, and bodies are weightless; "pid": `ctrl`
            is position, velocity and feed-forward effort of each joint, bodies have their weight
            and setup joints their brakes
        mjx: restricted to the features of MJX
        minimum: oldest MuJoCo in the tests
    """

    suffix: str
    servo: Literal["position", "pid"]
    mjx: bool
    minimum: str


#: Source of the oldest versions: the changelog of MuJoCo (`discrete`: 3.13.0, `pid`: 3.12.0), and
#: 60 s of random control with each (docs/exports.md).
POSITION = Variant("", "position", mjx=False, minimum="3.13.0")
PID = Variant("_pid", "pid", mjx=False, minimum="3.13.0")
MJX = Variant("_mjx", "position", mjx=True, minimum="3.8.0")
VARIANTS = (POSITION, PID, MJX)


def file_name(rig: RigDescription) -> str:
    """Return the name of the file and of its outermost class: letters, digits, underscores."""
    return "".join(c if c.isalnum() or c in "_-" else "_" for c in rig.name)


def prefix(rig: RigDescription, arm: str) -> str:
    """Return the prefix of an arm's names in a file: "" in a rig of one arm."""
    return "" if len(rig.arms) == 1 else f"{arm}_"


def mjcf_document(
    rig: RigDescription, variant: Variant = POSITION
) -> tuple[bytes, Mapping[str, Mesh]]:
    """Return a rig as a file of its own.

    A lone arm's names are the description's; in a rig with several they begin with the arm's:
    "PSM1_yaw". Bodies and sites are the frames of the description, hinges and servos are called as
    the public joints.

    Args:
        rig: its description
        variant: servos and integrator

    Returns:
        the file, and the meshes of assets/NAME.obj, {name: mesh}

    Raises:
        InputError: an arm has no masses or no gains
    """
    options = ModelOptions(servo=variant.servo, standalone=True)
    draft = Draft(rig, options)
    spec = draft.spec
    spec.modelname, spec.meshdir = file_name(rig), MESH_FOLDER
    _set_options(spec, variant)
    if variant.servo == "position":
        _compensate_gravity(spec, rig)
    else:
        _brake(spec, rig)
    _set_servos(spec, rig, variant)
    qpos, ctrl = _home(rig, variant, spec.compile())
    spec.add_key(name="home", qpos=qpos, ctrl=ctrl)
    _classify(draft, rig, options, variant)
    _rename(spec, rig)
    spec.assets = {f"{MESH_FOLDER}/{n}.obj": obj(mesh) for n, mesh in draft.meshes.items()}
    for mesh in spec.meshes:
        mesh.file = f"{mesh.name}.obj"
        mesh.uservert, mesh.userface, mesh.usernormal, mesh.userfacenormal = [], [], [], []
    spec.compile()
    with _exact_numbers():
        text = spec.to_xml().replace(KEY_COUNT, "")
    text = MATERIAL.sub(lambda found: NUMBER.sub(_single, found.group()), text)
    return NUMBER.sub(_shortest, text).encode(), draft.meshes


def _set_options(spec: mujoco.MjSpec, variant: Variant) -> None:
    option, usual = spec.option, mujoco.MjSpec().option
    # Sleeping is a choice of the scene.
    option.enableflags, option.sleep_tolerance = usual.enableflags, usual.sleep_tolerance
    option.tolerance = usual.tolerance
    if not variant.mjx:
        return
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_PYRAMIDAL, usual.impratio
    option.disableflags = usual.disableflags
    for equality in spec.equalities:
        equality.solref = [SAFE_STEPS * option.timestep, 1.0]
    for geom in spec.geoms:
        if geom.group == COLLISION_GROUP and geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
            radius, half, _ = geom.size
            geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
            geom.size = [radius, max(half - radius, 1e-4), 0.0]
    for mesh in spec.meshes:
        mesh.maxhullvert = MOST_HULL_CORNERS


def _weightless(place: RigArm, variant: Variant) -> bool:
    """Return whether the bodies of an arm are weightless.

    They are where the arm's controller compensates gravity and the file's servos are position
    servos. Setup joints are counterbalanced.
    """
    balanced = place.arm.type == "SUJ" or preset(place.arm).gravity_compensation
    return balanced and variant.servo == "position"


def _compensate_gravity(spec: mujoco.MjSpec, rig: RigDescription) -> None:
    """Compensate the weight of bodies where position servos cannot."""
    arms = {place.name for place in rig.arms if _weightless(place, POSITION)}
    for body in spec.bodies:
        if body.mass and naming.owner(body.name) in arms:
            body.gravcomp = 1.0


def _brake(spec: mujoco.MjSpec, rig: RigDescription) -> None:
    """Hold setup joints as their brakes do, and switch their servos off."""
    for group, place in enumerate(rig.arms, start=1):
        if place.arm.type != "SUJ":
            continue
        spec.option.disableactuator |= 1 << group
        for joint in place.arm.joints:
            hinge = spec.joint(naming.scoped(place.name, joint.drive[0][0]))
            hinge.damping, hinge.frictionloss = [BRAKED_DAMPING, 0.0, 0.0], 0.0


def _set_servos(spec: mujoco.MjSpec, rig: RigDescription, variant: Variant) -> None:
    """Give servos gains, and ranges to their inputs; add a sensor for each reading of a joint."""
    kinds = mujoco.mjtSensor
    readings = {
        "position": kinds.mjSENS_ACTUATORPOS,
        "velocity": kinds.mjSENS_ACTUATORVEL,
        "effort": kinds.mjSENS_ACTUATORFRC,
    }
    for place in rig.arms:
        control = preset(place.arm)
        for joint in place.arm.joints:
            name = naming.scoped(place.name, joint.name)
            servo, gains = spec.actuator(name), control.pid[joint.name]
            servo.ctrlrange = [joint.lower, joint.upper]
            if variant.servo == "pid":
                # A gripper has no motor: its effort is that of a person's fingers.
                scale = 0.0 if joint.spring is not None else 1.0
                p, i, d = scale * gains.p, scale * gains.i, scale * gains.d
                servo.set_to_pid(kp=p, kv=d, ki=i, ctrlspec=SERVO_INPUTS)
                if not np.isfinite(effort_limit(joint, control)):
                    servo.forcerange = [0.0, 0.0]
            else:
                servo.group = 0
                servo.ctrlspec = 0  # written, `input="pos"` is rejected by MuJoCo before 4.0
                if joint.spring is not None:
                    servo.ctrlrange = servo.forcerange
            for what, kind in readings.items():
                spec.add_sensor(
                    name=f"{name}_{what}",
                    type=kind,
                    objtype=mujoco.mjtObj.mjOBJ_ACTUATOR,
                    objname=name,
                )


def _rename(spec: mujoco.MjSpec, rig: RigDescription) -> None:
    """Rename all elements: "PSM1_yaw", or "yaw" in a rig of one arm."""
    hinges = {
        naming.scoped(place.name, joint.drive[0][0]): naming.scoped(place.name, joint.name)
        for place in rig.arms
        for joint in place.arm.joints
        if joint.drive[0][1] == 1.0
    }
    lone = f"{rig.arms[0].name}/" if len(rig.arms) == 1 else ""

    def plain(name: str) -> str:
        head, guard, closure = name.removeprefix(lone).rpartition("guard/")
        return f"{head}{closure}_guard".replace("/", "_") if guard else closure.replace("/", "_")

    def hinge(name: str) -> str:
        return plain(hinges.get(name, name))

    for servo in spec.actuators:
        servo.target = hinge(servo.target)
    for sensor in spec.sensors:
        sensor.objname = plain(sensor.objname)
    for equality in spec.equalities:
        called = plain if equality.type == mujoco.mjtEq.mjEQ_CONNECT else hinge
        equality.name1, equality.name2 = called(equality.name1), called(equality.name2)
    for joint in spec.joints:
        joint.name = hinge(joint.name)
    for part in (
        *spec.bodies[1:], *spec.sites, *spec.actuators, *spec.sensors, *spec.equalities
    ):  # fmt: skip
        part.name = plain(part.name)
    for geom in spec.geoms:
        geom.name = plain(geom.name)
    for pair in spec.pairs:
        pair.geomname1, pair.geomname2 = plain(pair.geomname1), plain(pair.geomname2)


def _classify(draft: Draft, rig: RigDescription, options: ModelOptions, variant: Variant) -> None:
    """Move shared attributes into default classes."""
    spec = draft.spec
    root = spec.add_default(file_name(rig), spec.default)
    root.joint.solref_limit = [STOP_STEPS * options.timestep, 1.0]
    root.joint.solimp_limit = STIFF_IMPEDANCE
    steps = SAFE_STEPS if variant.mjx else STIFF_STEPS
    root.equality.solref = [steps * options.timestep, 1.0]
    root.equality.solimp = STIFF_IMPEDANCE
    # Thin or open shapes have no volume; masses come from `inertial` alone.
    root.mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    if variant.mjx:
        root.mesh.maxhullvert = MOST_HULL_CORNERS
    for part in (*spec.joints, *spec.equalities, *spec.meshes):
        part.classname = root
    frame = spec.add_default("frame", root)
    frame.site.group, frame.site.size = FRAME_GROUP, [SITE_RADIUS_M] * 3
    for site in spec.sites:
        site.group, site.classname = FRAME_GROUP, frame
    _classify_geoms(draft, rig, options, root)
    for place in rig.arms:
        for joint in place.arm.joints:
            kind = joint.name if len(rig.arms) == 1 else f"{place.arm.name}_{joint.name}"
            hinge = spec.joint(naming.scoped(place.name, joint.drive[0][0]))
            servo = spec.actuator(naming.scoped(place.name, joint.name))
            made = spec.find_default(kind)
            if made is None:  # of the first arm of a kind
                made = spec.add_default(kind, root)
                for field in JOINT_FIELDS:
                    setattr(made.joint, field, getattr(hinge, field))
                for field in SERVO_FIELDS:
                    setattr(made.actuator, field, getattr(servo, field))
            hinge.classname = servo.classname = made


def _classify_geoms(
    draft: Draft, rig: RigDescription, options: ModelOptions, root: mujoco.MjsDefault
) -> None:
    visual, collision = (draft.spec.add_default(name, root) for name in ("visual", "collision"))
    visual.geom.type, visual.geom.group = mujoco.mjtGeom.mjGEOM_MESH, VISUAL_GROUP
    visual.geom.contype = visual.geom.conaffinity = 0
    collision.geom.type, collision.geom.group = mujoco.mjtGeom.mjGEOM_CAPSULE, COLLISION_GROUP
    visual.geom.mass = collision.geom.mass = 0.0
    set_contact(collision.geom, options)
    lone = rig.arms[0].name if len(rig.arms) == 1 else ""
    if lone:
        mask = draft.masks[lone]
        collision.geom.contype, collision.geom.conaffinity = mask.contype, mask.conaffinity
    owners = {(m.contype, m.conaffinity): owner for owner, m in draft.masks.items()}
    classes = {lone: collision} if lone else {}
    for geom in draft.spec.geoms:
        if geom.group == VISUAL_GROUP:
            geom.classname = visual
            continue
        owner = owners.get((int(geom.contype), int(geom.conaffinity)))
        if owner is None:  # the rig's own file added it
            continue
        if owner not in classes:
            made = draft.spec.add_default(f"{owner or 'prop'}_collision", collision)
            made.geom.contype, made.geom.conaffinity = geom.contype, geom.conaffinity
            classes[owner] = made
        geom.classname = classes[owner]


def _home(rig: RigDescription, variant: Variant, model: mujoco.MjModel) -> tuple[Array, Array]:
    """Return `qpos` with loops closed, and `ctrl` that holds it, at the rig's pose "start".

    Args:
        rig: its description
        variant: that of the file
        model: the compiled file with the names of the description
    """
    start = rig.poses["start"]
    qpos = model.qpos0.copy()  # has objects where they are placed
    for place in rig.arms:
        mechanism = place.arm.mechanism
        at = coordinates(mechanism, start[place.name])
        for frame, index in mechanism.frame_index.items():
            if mechanism.frames[index].motion != "fixed":
                hinge = model.joint(naming.scoped(place.name, frame))
                qpos[hinge.qposadr[0]] = at[index]
    ctrl = [value for place in rig.arms for value in _inputs(rig, place, variant)]
    return qpos, np.array(ctrl)


def _inputs(rig: RigDescription, place: RigArm, variant: Variant) -> list[float]:
    """Return the inputs of an arm's servos that hold the pose "start"."""
    q, arm = rig.poses["start"][place.name], place.arm
    control = preset(arm)
    load = np.zeros(len(q))
    if not _weightless(place, variant) and arm.type != "SUJ":
        mechanism = arm.mechanism
        reference = pose(mechanism, q, mechanism.reference, arm.root)
        down = (_root(rig, place) @ reference)[:3, :3].T @ np.array([0.0, 0.0, -1.0])
        load = holding_efforts(arm, q, down)
    found: list[float] = []
    for joint, at, effort in zip(arm.joints, q, load, strict=True):
        if joint.spring is not None:
            effort = effort + joint.spring.stiffness * (at - joint.spring.rest)
        gain = control.pid[joint.name].p
        fed = control.gravity_compensation or joint.spring is not None
        if variant.servo == "pid":
            found += [at, 0.0, effort] if fed else [at + effort / gain, 0.0, 0.0]
        else:
            found.append(effort if joint.spring is not None else at + effort / gain)
    return found


def _root(rig: RigDescription, place: RigArm) -> Array:
    """Return the pose of an arm's root in the world at the pose "start", (4, 4)."""
    if not place.on:
        return place.pose
    carrier = rig.arm(place.on)
    q = rig.poses["start"][carrier.name]
    mount = pose(carrier.arm.mechanism, q, place.frame, carrier.arm.root)
    return _root(rig, carrier) @ mount @ place.pose


@contextmanager
def _exact_numbers() -> Generator[None, None, None]:
    """Set MuJoCo to write all digits of a number instead of six.

    Raises:
        TrocarError: this build of MuJoCo has no such setting
    """
    folder = Path(mujoco.__file__).parent
    files = [f for f in folder.iterdir() if f.name.startswith(("libmujoco.", "mujoco.dll"))]
    try:
        library = ctypes.CDLL(str(files[0]))
        get = library._mjPRIVATE__get_xml_precision
        put = library._mjPRIVATE__set_xml_precision
    except (IndexError, OSError, AttributeError) as problem:
        raise TrocarError(
            f"MuJoCo {mujoco.__version__} cannot write {EXACT_DIGITS} digits: {problem}"
        ) from problem
    before = get()
    put(EXACT_DIGITS)
    try:
        yield
    finally:
        put(before)


def _shortest(found: re.Match[str]) -> str:
    """Write the shortest number that reads back the same; rounding noise becomes 0."""
    text = found.group()
    value = float(text)
    if abs(value) < NOISE:
        return "0"
    return text if len(text) <= 15 else repr(value).removesuffix(".0")


def _single(found: re.Match[str]) -> str:
    """Write the shortest number that reads back the same in single precision."""
    return number(float(found.group()), SINGLE_DIGITS)


def scene_document(rig: RigDescription, variant: Variant = POSITION) -> bytes:
    """Return a scene with a rig's file, light, sky and, for a rig without props, a floor.

    Raises:
        MissingExtraError: lxml is not installed
    """
    name = f"{file_name(rig)}{variant.suffix}"
    root = element("mujoco", {"model": f"{name} scene"})
    child(root, "include", {"file": f"{name}.xml"})
    child(root, "statistic", {"center": numbers(_middle(rig)), "extent": number(_extent(rig))})
    visual = child(root, "visual")
    light = {"diffuse": "0.3 0.3 0.3", "ambient": "0.35 0.35 0.35", "specular": "0 0 0"}
    child(visual, "headlight", light)
    child(visual, "quality", {"shadowsize": "8192"})
    child(visual, "rgba", {"haze": "0.85 0.88 0.91 1"})
    child(visual, "global", {"azimuth": "-130", "elevation": "-18"})
    assets = child(root, "asset")
    sky = {"type": "skybox", "builtin": "gradient", "rgb1": "0.95 0.96 0.97", "rgb2": "0.6 0.7 0.8"}
    child(assets, "texture", {**sky, "width": "512", "height": "3072"})
    world = child(root, "worldbody")
    lamp = {"pos": "1 1.5 4", "dir": "-0.2 -0.3 -0.8", "diffuse": "0.5 0.5 0.5"}
    child(world, "light", {**lamp, "directional": "true"})
    if not rig.props:
        squares = {"type": "2d", "name": "groundplane", "builtin": "checker", "mark": "edge"}
        colours = {"rgb1": "0.78 0.80 0.82", "rgb2": "0.72 0.74 0.77", "markrgb": "0.9 0.9 0.9"}
        child(assets, "texture", {**squares, **colours, "width": "300", "height": "300"})
        looks = {"texture": "groundplane", "texuniform": "true", "texrepeat": "5 5"}
        child(assets, "material", {"name": "groundplane", **looks, "reflectance": "0.1"})
        lies = {"type": "plane", "size": "0 0 0.05", "pos": numbers([0.0, 0.0, _floor(rig)])}
        child(world, "geom", {"name": "floor", **lies, "material": "groundplane"})
    return document(root)


def _floor(rig: RigDescription) -> float:
    """Return the height of a floor out of reach of the arms, at most 0 [m]."""
    rng = np.random.default_rng(0)
    lowest = 0.0
    for place in rig.arms:
        mechanism = place.arm.mechanism
        q = rng.uniform(mechanism.lower, mechanism.upper, (SAMPLES, len(mechanism.joints)))
        for at in poses(mechanism, q, place.arm.root).values():
            heights = (place.pose @ at)[..., 2, 3]
            lowest = min(lowest, float(heights.min()) - CLEARANCE_M)
    return round(lowest, 2)


def _middle(rig: RigDescription) -> Array:
    points = _points(rig)
    middle: Array = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return middle.round(2)


def _extent(rig: RigDescription) -> float:
    return round(MARGIN * float(np.ptp(_points(rig), axis=0).max()), 2)


def _points(rig: RigDescription) -> Array:
    """Return the origins of frames in the world at the pose "start", (n, 3) [m]."""
    found: list[Array] = []
    stands: dict[str, dict[str, Array]] = {}
    for place in rig.arms:
        mount = stands[place.on][place.frame] if place.on else np.eye(4)
        at = poses(place.arm.mechanism, rig.poses["start"][place.name], place.arm.root)
        stands[place.name] = {name: mount @ place.pose @ pose for name, pose in at.items()}
        found += [pose[:3, 3] for pose in stands[place.name].values()]
    return np.array(found)


def write_mjcf(task: ExportTask) -> tuple[str, ...]:
    """Fill a folder like those of MuJoCo Menagerie, and return warnings."""
    name, folder = file_name(task.rig), task.folder
    for variant in VARIANTS:
        text, meshes = mjcf_document(task.rig, variant)
        (folder / f"{name}{variant.suffix}.xml").write_bytes(text)
        write_meshes({mesh: stem for stem, mesh in meshes.items()}, folder / MESH_FOLDER)
    for variant in (POSITION, MJX):
        scene = scene_document(task.rig, variant)
        (folder / f"scene{variant.suffix}.xml").write_bytes(scene)
    shutil.copyfile(TEMPLATES / "LICENSE", folder / "LICENSE")
    (folder / "CHANGELOG.md").write_text(_changelog(task), encoding="utf-8")
    picture = folder / f"{name}.png"
    undrawn = _draw(task, picture)
    (folder / "README.md").write_text(_readme(task, picture=picture.is_file()), encoding="utf-8")
    return (*undrawn, *_lost(task))


def _draw(task: ExportTask, path: Path) -> tuple[str, ...]:
    """Draw the rig, if the caller can; return a warning if that fails."""
    try:
        if task.draw is not None:
            task.draw(task.rig, path)
    except TrocarError as problem:
        return (f"without a picture: {problem}",)
    return ()


def _lost(task: ExportTask) -> tuple[str, ...]:
    """Return warnings of parts of the description that the files omit."""
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
    """Return the README, with the option block of the model in the folder."""
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
    """Return a source on one line, for a cell of a table."""
    return " ".join(text.split()).replace("|", "/")


def read_mjcf(path: Path, options: ReadOptions) -> SourceModel:
    """Read a model; colliding meshes are hulls, as MuJoCo has them.

    Args:
        path: the file
        options: unused, as MuJoCo finds and reads the meshes

    Raises:
        ImportFileError: rejected by MuJoCo, too large, or with a ball joint, weld, tendon or flex
        MissingExtraError: lxml is not installed
    """
    del options
    _check_made(path, read_xml(path), 1, frozenset({path.resolve()}))
    log_mujoco_warnings()
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as problem:
        raise ImportFileError(str(path), f"rejected by MuJoCo: {problem}") from problem
    return _MjcfReader(model, str(path)).read(path.stem)


def _check_made(path: Path, node: XmlNode, around: float, seen: frozenset[Path]) -> None:
    """Check the data that MuJoCo would generate from a file and the files that it includes.

    Raises:
        ImportFileError: more than `MOST_MADE` or `MOST_OF_SIZE` allows
    """
    if node.tag in ("include", "model") and (name := node.attribute("file", "")):
        file = (path.parent / name).resolve()
        if file not in seen and is_file(file):  # else MuJoCo reports the problem
            _check_made(file, read_xml(file), around, seen | {file})
        return
    if node.tag == "size":
        for name, text in node.attributes().items():
            if name != "memory" and _product(text) > MOST_OF_SIZE:
                raise node.fail(f"{name}: got {text[:40]}; allowed: up to {MOST_OF_SIZE}")
    if node.tag in MOST_MADE:
        names, most = MOST_MADE[node.tag]
        product = _product(" ".join(node.attribute(name, "") for name in names))
        if node.tag == "replicate":
            around = product = max(product, 1) * around
        if product > most:
            raise node.fail(f"{' x '.join(names)}: got {product:g}; allowed: up to {most}")
    for inside in node.children():
        _check_made(path, inside, around, seen)


def _product(text: str) -> float:
    """Return the product of the numbers of a text; other words are ignored."""
    product = 1.0
    for word in text.split():
        with suppress(ValueError):
            product *= abs(float(word))
    return product


class _MjcfReader:
    def __init__(self, model: Any, file: str) -> None:
        self._m, self._file = model, file
        self._links: list[Link] = []
        self._joints: list[SourceJoint] = []
        self._warnings: list[str] = []
        kinds = mujoco.mjtTrn
        hinged = model.actuator_trntype == int(kinds.mjTRN_JOINT)
        self._driven = {int(k) for k in model.actuator_trnid[hinged, 0]} if model.nu else None

    def read(self, name: str) -> SourceModel:
        m = self._m
        for count, what in ((m.ntendon, "tendons"), (m.nflex, "flexes"), (m.nskin, "skins")):
            if count:
                raise ImportFileError(self._file, f"has {count} {what}, which are not supported")
        for body in range(m.nbody):
            self._body(body)
        links, joints = as_tree(self._file, self._links, self._joints)
        loops, joints = self._equalities(joints)
        found = str(m.names[: m.names.index(b"\0")].decode()) or name
        return SourceModel(found, self._file, links, joints, loops, tuple(self._warnings))

    def _name(self, kind: Any, index: int, default: str) -> str:
        return mujoco.mj_id2name(self._m, int(kind), index) or default

    def _link_name(self, body: int) -> str:
        return WORLD if body == 0 else self._name(mujoco.mjtObj.mjOBJ_BODY, body, f"body_{body}")

    def _body(self, body: int) -> None:
        m, name = self._m, self._link_name(body)
        turn = matrix_from_quaternion(m.body_iquat[body])
        link = Link(
            name,
            mass=float(m.body_mass[body]),
            com=np.array(m.body_ipos[body]),
            inertia=turn @ np.diag(m.body_inertia[body]) @ turn.T,
            shapes=tuple(self._shapes(body)),
        )
        if body:
            self._hang(body, name)
        self._links.append(link)

    def _hang(self, body: int, name: str) -> None:
        m = self._m
        parent = self._link_name(int(m.body_parentid[body]))
        pose = transform(matrix_from_quaternion(m.body_quat[body]), np.array(m.body_pos[body]))
        first, count = int(m.body_jntadr[body]), int(m.body_jntnum[body])
        if count == 0:
            self._joints.append(SourceJoint(f"{name}_fixed", "fixed", parent, name, pose))
        for k in range(first, first + count):
            joint = self._name(mujoco.mjtObj.mjOBJ_JOINT, k, f"{name}_joint_{k - first}")
            last = k == first + count - 1
            child = name if last else f"{name}_{joint}"
            if not last:
                self._links.append(Link(child))
            if int(m.jnt_type[k]) == int(mujoco.mjtJoint.mjJNT_FREE):
                self._warnings.append(f"{self._file}: {joint}: free joint imported as fixed")
                self._joints.append(SourceJoint(joint, "fixed", parent, child, pose))
            else:
                self._joints.append(self._joint(k, joint, (parent, child), pose))
            parent, pose = child, np.eye(4)

    def _joint(self, k: int, name: str, ends: tuple[str, str], pose: Array) -> SourceJoint:
        m = self._m
        kind = HINGE_KINDS.get(int(m.jnt_type[k]))
        if kind is None:
            raise ImportFileError(
                self._file, f"joint {name!r} is a ball joint; allowed: hinge, slide"
            )
        axis, point = np.array(m.jnt_axis[k]), np.array(m.jnt_pos[k])
        lower, upper = m.jnt_range[k] if m.jnt_limited[k] else (-np.inf, np.inf)
        dof = int(m.jnt_dofadr[k])
        found = SourceJoint(
            name,
            kind,
            *ends,
            pose,
            axis,
            point,
            float(lower),
            float(upper),
            effort=self._effort(k),
            damping=float(np.ravel(m.dof_damping[dof])[0]),
            friction=float(m.dof_frictionloss[dof]),
            driven=self._driven is None or k in self._driven,
        )
        at_zero = pose @ found.motion(-float(m.qpos0[m.jnt_qposadr[k]]))
        return replace(found, pose=at_zero)

    def _effort(self, k: int) -> float:
        m = self._m
        for a in range(m.nu):
            if int(m.actuator_trnid[a, 0]) == k and m.actuator_forcelimited[a]:
                return float(np.abs(m.actuator_forcerange[a]).max() * abs(m.actuator_gear[a, 0]))
        return np.inf

    def _shapes(self, body: int) -> list[Shape]:
        m = self._m
        first = int(m.body_geomadr[body])
        found: list[Shape] = []
        for g in range(first, first + int(m.body_geomnum[body])):
            pose = transform(matrix_from_quaternion(m.geom_quat[g]), np.array(m.geom_pos[g]))
            shape = self._shape(g, pose)
            if shape is None:
                continue
            touches = bool(m.geom_contype[g] or m.geom_conaffinity[g])
            hidden = int(m.geom_group[g]) >= HIDDEN_GROUP
            found.append(replace(shape, visible=not hidden, collide=touches))
        return found

    def _shape(self, g: int, pose: Array) -> Shape | None:
        m, kinds = self._m, mujoco.mjtGeom
        size, kind = np.array(m.geom_size[g]), int(m.geom_type[g])
        material = self._material(g)
        if kind == int(kinds.mjGEOM_MESH):
            return mesh_shape(pose, self._mesh(int(m.geom_dataid[g])), material)
        sizes: dict[int, tuple[ShapeKind, Array | tuple[float, float]]] = {
            int(kinds.mjGEOM_BOX): ("box", 2.0 * size),
            int(kinds.mjGEOM_SPHERE): ("sphere", size[:1]),
            int(kinds.mjGEOM_CYLINDER): ("cylinder", (size[0], 2.0 * size[1])),
            int(kinds.mjGEOM_CAPSULE): ("capsule", (size[0], 2.0 * size[1])),
        }
        if kind in sizes:
            name, edges = sizes[kind]
            return solid(name, pose, [float(edge) for edge in edges], material)
        name = self._name(mujoco.mjtObj.mjOBJ_GEOM, g, f"geom {g}")
        self._warnings.append(
            f"{self._file}: {name}: planes, ellipsoids and height fields are ignored"
        )
        return None

    def _material(self, g: int) -> str:
        """Return the material of a geom's colour, or of its texture's mean."""
        m, kind = self._m, int(self._m.geom_matid[g])
        rgba = np.array(m.geom_rgba[g])
        if kind < 0:
            return DEFAULT_MATERIAL if np.array_equal(rgba, UNCOLOURED) else material_of(rgba)
        if np.array_equal(rgba, UNCOLOURED):
            rgba = np.array(m.mat_rgba[kind])
        texture = max(int(k) for k in m.mat_texid[kind])
        if texture < 0 or int(m.tex_nchannel[texture]) < 3:
            return material_of(rgba)
        first, channels = int(m.tex_adr[texture]), int(m.tex_nchannel[texture])
        count = int(m.tex_width[texture]) * int(m.tex_height[texture]) * channels
        texels = np.array(m.tex_data[first : first + count]).reshape(-1, channels)[:, :3]
        name = self._name(mujoco.mjtObj.mjOBJ_MATERIAL, kind, f"material {kind}")
        self._note(f"{self._file}: {name}: texture replaced by its mean colour")
        return material_of(rgba[:3] * texels.mean(axis=0) / 255.0)

    def _note(self, text: str) -> None:
        if text not in self._warnings:
            self._warnings.append(text)

    def _mesh(self, k: int) -> Mesh:
        m = self._m
        at, count = int(m.mesh_vertadr[k]), int(m.mesh_vertnum[k])
        face, faces = int(m.mesh_faceadr[k]), int(m.mesh_facenum[k])
        return Mesh(
            np.array(m.mesh_vert[at : at + count], dtype=np.float64),
            np.array(m.mesh_face[face : face + faces], dtype=np.int64),
        )

    def _equalities(
        self, joints: tuple[SourceJoint, ...]
    ) -> tuple[tuple[LinkLoop, ...], tuple[SourceJoint, ...]]:
        m, kinds = self._m, mujoco.mjtEq
        loops: dict[tuple[str, ...], LinkLoop] = {}
        by_name = {joint.name: joint for joint in joints}
        for e in range(m.neq):
            name = self._name(mujoco.mjtObj.mjOBJ_EQUALITY, e, f"equality_{e}")
            kind = int(m.eq_type[e])
            if kind == int(kinds.mjEQ_CONNECT):
                loop = self._connect(e, name)
                key = (loop.link_a, loop.link_b, *(f"{v:.9f}" for v in loop.point_a))
                loops.setdefault(key, loop)  # the same hinge may be held by several
            elif kind == int(kinds.mjEQ_JOINT):
                self._couple(e, name, by_name)
            else:
                raise ImportFileError(
                    self._file, f"equality {name!r} is not supported; allowed: connect, joint"
                )
        return tuple(loops.values()), tuple(by_name.values())

    def _connect(self, e: int, name: str) -> LinkLoop:
        m = self._m
        one, two = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
        if int(m.eq_objtype[e]) == int(mujoco.mjtObj.mjOBJ_SITE):
            bodies = [int(m.site_bodyid[s]) for s in (one, two)]
            points = [np.array(m.site_pos[s]) for s in (one, two)]
        else:
            bodies = [one, max(two, 0)]
            points = [np.array(m.eq_data[e, :3]), np.array(m.eq_data[e, 3:6])]
        names = [self._link_name(body) for body in bodies]
        return LinkLoop(name, names[0], points[0], names[1], points[1])

    def _couple(self, e: int, name: str, by_name: dict[str, SourceJoint]) -> None:
        """Read a joint equality as a coupling; inside a loop it only guards the branch."""
        m = self._m
        follower, leader = (
            self._name(mujoco.mjtObj.mjOBJ_JOINT, int(k), "") if k >= 0 else ""
            for k in (m.eq_obj1id[e], m.eq_obj2id[e])
        )
        offset, ratio, *more = (float(v) for v in m.eq_data[e, :5])
        if any(more) or not leader:
            raise ImportFileError(
                self._file, f"equality {name!r} is not linear in two joints; allowed: linear"
            )
        joint = by_name[follower]
        if joint.follows is None:
            by_name[follower] = replace(joint, follows=(leader, ratio, offset))


FORMAT = Format(
    title="MJCF: MuJoCo, as MuJoCo Menagerie has robots",
    order=30,
    suffixes=(".xml", ".mjcf"),
    root="mujoco",
    write=write_mjcf,
    read=read_mjcf,
)
