"""One arm as MuJoCo bodies, hinges, loops and servos."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import merged
from trocar.descriptions.records import ArmDescription, Body, JointDescription, Shape
from trocar.errors import InputError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.kinematics.mechanism import Frame
from trocar.kinematics.tree import local_pose
from trocar.modeling import naming
from trocar.modeling.assets import add_material, add_mesh
from trocar.modeling.contacts import ContactMask
from trocar.modeling.hinges import followers, hinge_of
from trocar.modeling.options import (
    CONTACT_FRICTION,
    CONTACT_IMPEDANCE,
    CONTACT_PERIODS,
    LAYERS,
    STIFF_IMPEDANCE,
    STIFF_PERIODS,
    STOP_PERIODS,
    ModelOptions,
)

Array = NDArray[np.float64]

GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}
#: Inputs of a servo: position, velocity, feed-forward effort.
SERVO_INPUTS = 7
SITE_RADIUS_M = 0.002


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where a frame is in the model: on a body, at a fixed pose T_body_frame (4, 4)."""

    body: mujoco.MjsBody
    pose: Array


@dataclass(frozen=True, eq=False)
class Place:
    """An arm's place in a model.

    Attributes:
        name: its name in the rig
        mount: where its root goes
        mask: whom it touches
        group: group of its servos, which can be switched off together
    """

    name: str
    mount: Anchor
    mask: ContactMask
    group: int


def add_arm(
    spec: mujoco.MjSpec, arm: ArmDescription, place: Place, options: ModelOptions
) -> dict[str, Anchor]:
    """Add an arm to a model and return where each of its frames is.

    Args:
        spec: the model that grows
        arm: its description
        place: its name, mount and whom it touches
        options: choices for the whole model

    Raises:
        InputError: the description has no masses, so it can only be moved kinematically
    """
    massed = {body.frame for body in arm.bodies}
    bare = [f.name for f in arm.mechanism.frames if f.motion != "fixed" and f.name not in massed]
    if bare:
        why = "".join(f"; {m.what}: {m.why}" for m in arm.missing)
        raise InputError(f"{arm.name}: cannot be simulated, no mass for {', '.join(bare)}{why}")
    anchors = _add_frames(spec, arm, place, options)
    if place.name not in options.locked:
        _add_loops(spec, place.name, arm, anchors, options)
        _add_couplings(spec, place.name, arm, options)
        for joint in arm.joints:
            _add_servo(spec, place, joint)
    return anchors


def _add_frames(
    spec: mujoco.MjSpec, arm: ArmDescription, place: Place, options: ModelOptions
) -> dict[str, Anchor]:
    name = place.name
    locked = options.locked.get(name)
    at = None if locked is None else coordinates(arm.mechanism, locked)
    massed: dict[str, list[Body]] = {}
    for body in arm.bodies:
        massed.setdefault(body.frame, []).append(body)
    anchors: dict[str, Anchor] = {}
    for index, frame in enumerate(arm.mechanism.frames):
        parent = place.mount if frame.parent is None else anchors[frame.parent]
        zero = np.zeros(()) if at is None else at[index]
        pose = parent.pose @ local_pose(frame, zero)
        moves = frame.motion != "fixed" and at is None
        if not moves and frame.name not in massed and frame.parent is not None and at is None:
            anchors[frame.name] = Anchor(parent.body, pose)
            if options.decoration:
                _add_site(parent.body, naming.scoped(name, frame.name), pose)
            continue
        made = parent.body.add_body(
            name=naming.scoped(name, frame.name),
            pos=pose[:3, 3],
            quat=quaternion_from_matrix(pose[:3, :3]),
        )
        anchors[frame.name] = Anchor(made, np.eye(4))
        if moves:
            _add_hinge(made, name, frame, arm, options)
        bodies = massed.get(frame.name, [])
        set_mass(made, *merged(bodies))
        for number, shape in enumerate(s for b in bodies for s in b.shapes):
            add_shape(
                spec,
                made,
                naming.scoped(name, f"{frame.name}/{number}"),
                shape,
                place.mask,
                options,
            )
    return anchors


def _add_hinge(
    body: mujoco.MjsBody, name: str, frame: Frame, arm: ArmDescription, options: ModelOptions
) -> None:
    """Give a body its hinge or slide: the axis is z ahead of the frame's fixed `after`."""
    back = inverse(frame.after)
    slides = frame.motion == "prismatic"
    feels = hinge_of(arm, frame.name, options.friction)
    hinge = body.add_joint(
        name=naming.scoped(name, frame.name),
        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
        pos=back[:3, 3],
        axis=back[:3, 2],
        armature=feels.armature,
        damping=[feels.damping, 0.0, 0.0],
        frictionloss=feels.frictionloss,
    )
    if feels.stiffness:
        hinge.stiffness = [feels.stiffness, 0.0, 0.0]
        hinge.springref = feels.rest
    if np.isfinite([feels.lower, feels.upper]).all():
        hinge.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        hinge.range = [feels.lower, feels.upper]
        hinge.solref_limit = [STOP_PERIODS * options.timestep, 1.0]
        hinge.solimp_limit = STIFF_IMPEDANCE


def set_mass(made: mujoco.MjsBody, mass: float, com: Array, inertia: Array) -> None:
    """Give a body its mass, its centre and the inertia about it; nothing where it has none."""
    made.explicitinertial = True
    made.mass = mass
    if not mass:
        return
    made.ipos = com
    made.fullinertia = [inertia[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def add_shape(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    shape: Shape,
    mask: ContactMask,
    options: ModelOptions,
) -> None:
    """Add a massless geom for a shape, if it collides or decoration is wanted.

    What is seen is in group 1 where it collides, else in group 2; what only collides in group 3.
    """
    collide = shape.collide and options.collisions and mask.conaffinity != 0
    if collide and not options.decoration and shape.hull == "capsule":
        shape = capsule_about(shape)
    if not collide and not (options.decoration and shape.visible):
        return
    looks: dict[str, str] = {}
    if shape.mesh is not None:
        looks["meshname"] = add_mesh(spec, shape.mesh, convex=not shape.visible)
    if options.decoration:
        looks["material"] = add_material(spec, shape.material)
    body.add_geom(
        name=name,
        type=GEOMS[shape.kind],
        size=np.zeros(3) if shape.mesh else shape.size,
        pos=shape.pose[:3, 3],
        quat=quaternion_from_matrix(shape.pose[:3, :3]),
        mass=0.0,
        group=3 if not shape.visible else 1 if shape.collide else 2,
        contype=mask.contype if collide else 0,
        conaffinity=mask.conaffinity if collide else 0,
        condim=4,
        friction=CONTACT_FRICTION,
        solref=[CONTACT_PERIODS * options.timestep, 1.0],
        solimp=CONTACT_IMPEDANCE,
        **looks,
    )


def capsule_about(shape: Shape) -> Shape:
    """Return the capsule along a box's longest edge (or a cylinder's axis), as thick as it is wide.

    It has the length of the shape, so corners stick out and the middle of flat sides does not.
    """
    if shape.kind != "box":
        radius, half, _ = shape.size
        length = max(half - radius, 1e-4)
        return replace(shape, kind="capsule", size=np.array([radius, length, 0.0]))
    order = np.argsort(shape.size)
    axis = int(order[2])
    radius = float(shape.size[order[1]])
    turn = np.roll(np.eye(3), 2 - axis, axis=1)
    pose = shape.pose @ transform(turn, np.zeros(3))
    half = max(float(shape.size[axis]) - radius, 1e-4)
    return replace(shape, kind="capsule", pose=pose, size=np.array([radius, half, 0.0]))


def _add_loops(
    spec: mujoco.MjSpec,
    name: str,
    arm: ArmDescription,
    anchors: Mapping[str, Anchor],
    options: ModelOptions,
) -> None:
    closures = arm.mechanism.closures
    # A guard relies on the other loops: beside an open one it would hold what has come apart.
    parallel = loops_are_parallelograms(arm.mechanism)
    guarded = parallel and not any(c.open for c in closures)
    for closure in closures:
        for side, frame, point in (
            ("a", closure.frame_a, closure.point_a),
            ("b", closure.frame_b, closure.point_b),
        ):
            anchor = anchors[frame]
            at = anchor.pose @ transform(np.eye(3), point)
            _add_site(anchor.body, naming.closing_site(name, closure.name, side), at)
        if closure.open:  # its passive frames are tied by nothing else: they swing
            continue
        for layer in range(1 if parallel else LAYERS):
            _add_equality(
                spec,
                naming.connect(name, closure.name, layer),
                mujoco.mjtEq.mjEQ_CONNECT,
                options,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                name1=naming.closing_site(name, closure.name, "a"),
                name2=naming.closing_site(name, closure.name, "b"),
            )
        if closure.guard and guarded:
            _add_equality(
                spec,
                naming.guard(name, closure.name),
                mujoco.mjtEq.mjEQ_JOINT,
                options,
                name1=naming.scoped(name, closure.guard[0]),
                name2=naming.scoped(name, closure.guard[1]),
                data=[0.0, 1.0],
            )


def _add_site(body: mujoco.MjsBody, name: str, pose: Array) -> None:
    body.add_site(
        name=name,
        pos=pose[:3, 3],
        quat=quaternion_from_matrix(pose[:3, :3]),
        size=[SITE_RADIUS_M] * 3,
    )


def _add_couplings(
    spec: mujoco.MjSpec, name: str, arm: ArmDescription, options: ModelOptions
) -> None:
    """Tie frames that neither a motor nor a loop moves to the joint they follow."""
    for frame, leader, ratio in followers(arm):
        _add_equality(
            spec,
            naming.scoped(name, frame),
            mujoco.mjtEq.mjEQ_JOINT,
            options,
            name1=naming.scoped(name, frame),
            name2=naming.scoped(name, leader),
            data=[0.0, ratio],
        )


def _add_servo(spec: mujoco.MjSpec, place: Place, joint: JointDescription) -> None:
    """Add a joint's actuator (PID with feed-forward) on the hinge that it drives."""
    ((hinge, weight),) = joint.drive
    target = naming.scoped(place.name, hinge)
    servo = spec.add_actuator(
        name=naming.scoped(place.name, joint.name), target=target, trntype=mujoco.mjtTrn.mjTRN_JOINT
    )
    servo.gear = [weight, 0, 0, 0, 0, 0]
    servo.group = place.group
    servo.set_to_pid(kp=1.0, kv=1.0, ki=1.0, ctrlspec=SERVO_INPUTS)
    servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    servo.forcerange = [-joint.effort_max, joint.effort_max]


def _add_equality(
    spec: mujoco.MjSpec,
    name: str,
    kind: mujoco.mjtEq,
    options: ModelOptions,
    *,
    name1: str,
    name2: str = "",
    data: list[float] | None = None,
    objtype: mujoco.mjtObj = mujoco.mjtObj.mjOBJ_UNKNOWN,
) -> None:
    padded = np.zeros(12)
    padded[: len(data or [])] = data or []
    equality = spec.add_equality(
        name=name,
        type=kind,
        name1=name1,
        name2=name2,
        data=padded,
        solref=_stiff(options),
        solimp=STIFF_IMPEDANCE,
    )
    if objtype != mujoco.mjtObj.mjOBJ_UNKNOWN:
        equality.objtype = objtype


def _stiff(options: ModelOptions) -> list[float]:
    return [STIFF_PERIODS * options.timestep, 1.0]
