"""A rig as standalone MJCF in the style of MuJoCo Menagerie, which plain MuJoCo loads."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import holding_efforts
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import RigArm, RigDescription
from trocar.errors import TrocarError
from trocar.formats.markup import NOISE, child, document, element, number, numbers
from trocar.formats.mesh_files import obj
from trocar.kinematics.forward import coordinates, pose, poses
from trocar.modeling import naming
from trocar.modeling.build import SERVO_INPUTS, SITE_RADIUS_M, Draft, effort_limit, preset
from trocar.modeling.geoms import COLLISION_GROUP, VISUAL_GROUP, set_contact
from trocar.modeling.options import STIFF_IMPEDANCE, STIFF_STEPS, STOP_STEPS, ModelOptions

Array = NDArray[np.float64]

#: Folder of the meshes, beside the file.
MESH_FOLDER = "assets"
#: Group of sites. Source: MuJoCo Menagerie.
FRAME_GROUP = 4
#: Corners of a convex piece in MJX. Source: MuJoCo's page on MJX, 64 or less.
MOST_HULL_CORNERS = 64
#: Damping of a joint that its brake holds. Source: simulation/servos.py, HOLDING_DAMPING.
BRAKED_DAMPING = 1e18
#: Significant digits with which a float64 is read back exactly.
EXACT_DIGITS = 17
#: Significant digits that a number of single precision has.
SINGLE_DIGITS = 7
#: Time constant of loops in MJX, in physics steps. Source: MuJoCo raises it to two steps by
#: itself under every integrator but `discrete` (flag refsafe); written so that a reader sees it.
SAFE_STEPS = 2.0
#: Attributes of a hinge and of its servo that are in the class of their joint.
JOINT_FIELDS = ("type", "range", "armature", "damping", "frictionloss", "stiffness", "springref")
SERVO_FIELDS = (
    "gear", "gaintype", "gainprm", "biastype", "biasprm", "dyntype", "dynprm", "ctrlspec",
    "ctrlrange", "forcerange",
)  # fmt: skip
#: Not written: MuJoCo counts keys by itself, and warns where a robot is attached to a scene.
KEY_COUNT = '  <size nkey="1"/>\n\n'
#: Numbers as they stand in attributes.
NUMBER = re.compile(r'(?<=[ "])-?\d[\d.]*(?:e[-+]\d+)?(?=[ "])')
#: Elements whose numbers MuJoCo keeps in single precision.
MATERIAL = re.compile(r"<material .*?/>")
#: Joint vectors that determine how low a lone arm reaches, and how far below the floor lies [m].
SAMPLES, CLEARANCE_M = 256, 0.15
#: Room that is left around the frames in the first look. Source: by eye.
MARGIN = 1.3


@dataclass(frozen=True)
class Variant:
    """One of the files that a robot becomes: same bodies, other servos or another integrator.

    Attributes:
        suffix: of its name
        servo: "position": `ctrl` is the joints' positions, and bodies weigh nothing; "pid": `ctrl`
            is position, velocity and fed-forward effort of each joint, bodies have their weight and
            setup joints their brakes
        mjx: whether it keeps to what MJX supports
        minimum: the oldest MuJoCo that it is tested with
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
    """Return what precedes every name of an arm in a file: nothing in a rig of one arm."""
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
        variant: which servos and which integrator

    Returns:
        the file, and {name: mesh} of what it reads from assets/NAME.obj

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
    option, usual = cast(Any, spec.option), cast(Any, mujoco.MjSpec().option)
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
    """Return whether the bodies of an arm are spared their weight.

    So they are where the arm's own controller carries it, and the file's servos take positions
    alone. Setup joints are counterbalanced.
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
        cast(Any, spec.option).disableactuator |= 1 << group
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
    """Call everything as the files do: "PSM1_yaw", or "yaw" in a rig of one arm."""
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
    """Put what many elements share into default classes; the file then has what differs."""
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
            if made is None:  # of the first arm of a kind; others have what differs
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
    """Return `qpos` and `ctrl` of the rig's pose "start": loops closed, and servos that hold it.

    Args:
        rig: its description
        variant: of the file
        model: the file's, with the names of the description
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
    """Return the inputs with which the servos of an arm hold it at rest."""
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
def _exact_numbers() -> Iterator[None]:
    """Let MuJoCo write all digits of a number: by itself it writes six.

    Raises:
        TrocarError: this build of MuJoCo has no setting for it
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
    """Write a number as short as reads back the same; rounding noise is 0."""
    text = found.group()
    value = float(text)
    if abs(value) < NOISE:
        return "0"
    return text if len(text) <= 15 else repr(value).removesuffix(".0")


def _single(found: re.Match[str]) -> str:
    """Write a number of single precision as short as reads back the same."""
    return number(float(found.group()), SINGLE_DIGITS)


def scene_document(rig: RigDescription, variant: Variant = POSITION) -> bytes:
    """Return a scene of a rig's file with light, sky and, where the rig has no props, a floor.

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
    """Return the height of a floor that no joint position reaches, at most 0 [m]."""
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
    return np.round(0.5 * (_points(rig).min(axis=0) + _points(rig).max(axis=0)), 2)


def _extent(rig: RigDescription) -> float:
    return round(MARGIN * float(np.ptp(_points(rig), axis=0).max()), 2)


def _points(rig: RigDescription) -> Array:
    """Return where frames are at the pose "start", (n, 3) [m]."""
    found: list[Array] = []
    stands: dict[str, dict[str, Array]] = {}
    for place in rig.arms:
        mount = stands[place.on][place.frame] if place.on else np.eye(4)
        at = poses(place.arm.mechanism, rig.poses["start"][place.name], place.arm.root)
        stands[place.name] = {name: mount @ place.pose @ pose for name, pose in at.items()}
        found += [pose[:3, 3] for pose in stands[place.name].values()]
    return np.array(found)
