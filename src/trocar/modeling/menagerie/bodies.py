"""Bodies: an arm's frames and props with their masses, hinges and shapes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import merged
from trocar.descriptions.records import Body, RigArm, Shape
from trocar.errors import InputError
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.mechanism import Frame
from trocar.kinematics.tree import local_pose
from trocar.modeling.arm_model import capsule_about
from trocar.modeling.contacts import OBJECTS
from trocar.modeling.hinges import hinge_of
from trocar.modeling.markup import NOISE, child, number
from trocar.modeling.menagerie.servos import hinge_name, servo_defaults, servo_tag
from trocar.modeling.menagerie.sheet import Sheet
from trocar.modeling.menagerie.text import DIGITS, exact, placed, row
from trocar.modeling.menagerie.variants import MJX

Array = NDArray[np.float64]

#: How many numbers MuJoCo wants of a shape's size.
SIZES = {"box": 3, "capsule": 2, "cylinder": 2, "sphere": 1}
#: What stands before what inside a body.
ORDER = ("inertial", "freejoint", "joint", "geom", "site", "body")
#: What the name of a free joint ends in.
FREE = "free"
#: Damping of a joint that its brake holds. Source: simulation/drives.py, HOLDING_DAMPING.
BRAKED_DAMPING = 1e12


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where a frame is in the file: in a body's element, at a fixed pose T_body_frame (4, 4)."""

    body: Any
    pose: Array


@dataclass(frozen=True, eq=False)
class Bodies:
    """What was written of a rig's bodies.

    Attributes:
        anchors: {arm: {frame: where it is}}
        classes: {name of a hinge: its default class}
        hinges: {name of a hinge: (arm, frame)}
    """

    anchors: dict[str, dict[str, Anchor]]
    classes: dict[str, str]
    hinges: dict[str, tuple[str, str]]


def add_bodies(sheet: Sheet, world: Any) -> Bodies:
    """Write the props and arms of a rig into the element `worldbody`.

    Raises:
        InputError: a moving frame has no mass
    """
    ground = Anchor(world, np.eye(4))
    made = Bodies({}, {}, {})
    for prop in sheet.rig.props:
        said = {"name": prop.name, "childclass": sheet.classes.root, **placed(prop.pose)}
        body = child(world, "body", said)
        mask = sheet.masks[OBJECTS if prop.movable else ""]
        collision = sheet.classes.collision(OBJECTS if prop.movable else "prop", mask)
        if prop.movable is not None:
            child(body, "freejoint", {"name": f"{prop.name}_{FREE}"})
            _add_inertial(body, prop.movable.mass, prop.movable.com, prop.movable.inertia)
        for shape in prop.shapes:
            _add_shape(sheet, body, shape, collision if mask.conaffinity else "")
    for place in sheet.rig.arms:
        mount = made.anchors[place.on][place.frame] if place.on else ground
        at = Anchor(mount.body, mount.pose @ place.pose)
        made.anchors[place.name] = _add_arm(sheet, place, at, made)
    for body in world.iter("body"):
        body[:] = sorted(body, key=lambda part: ORDER.index(part.tag))
    return made


def _add_arm(sheet: Sheet, place: RigArm, mount: Anchor, made: Bodies) -> dict[str, Anchor]:
    arm = place.arm
    massed: dict[str, list[Body]] = {}
    for body in arm.bodies:
        massed.setdefault(body.frame, []).append(body)
    bare = [f.name for f in arm.mechanism.frames if f.motion != "fixed" and f.name not in massed]
    if bare:
        why = "".join(f"; {m.what}: {m.why}" for m in arm.missing)
        raise InputError(f"{arm.name}: has no mass for {', '.join(bare)}{why}")
    anchors: dict[str, Anchor] = {}
    for frame in arm.mechanism.frames:
        parent = mount if frame.parent is None else anchors[frame.parent]
        pose = parent.pose @ local_pose(frame, np.zeros(()))
        name = sheet.name(place.name, frame.name)
        if frame.motion == "fixed" and frame.name not in massed and frame.parent is not None:
            anchors[frame.name] = Anchor(parent.body, pose)
            child(parent.body, "site", {"class": "frame", "name": name, **placed(pose)})
            continue
        said = {"name": name} | placed(pose)
        if frame.parent is None:
            said = {"name": name, "childclass": sheet.classes.root, **placed(pose)}
        body = child(parent.body, "body", said)
        anchors[frame.name] = Anchor(body, np.eye(4))
        _add_mass(sheet, place, body, massed.get(frame.name, []))
        if frame.motion != "fixed":
            _add_hinge(sheet, place, body, frame, made)
        _add_shapes(sheet, place, body, massed.get(frame.name, []))
    return anchors


def _add_mass(sheet: Sheet, place: RigArm, body: Any, bodies: list[Body]) -> None:
    if not bodies:
        return
    if sheet.weightless(place):
        body.set("gravcomp", "1")
    _add_inertial(body, *merged(bodies))


def _add_inertial(body: Any, mass: float, com: Array, inertia: Array) -> None:
    six = [inertia[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    said = {"mass": exact(mass), "pos": row(com), "fullinertia": " ".join(map(_inertia, six))}
    child(body, "inertial", said)


def _inertia(value: float) -> str:
    """Write an inertia, which may be smaller than what is noise in a length."""
    return number(value, DIGITS)


def _add_hinge(sheet: Sheet, place: RigArm, body: Any, frame: Frame, made: Bodies) -> None:
    """Write a body's hinge or slide: the axis is z ahead of the frame's fixed `after`."""
    feels = hinge_of(place.arm, frame.name, sheet.options.friction)
    braked = feels.joint is not None and sheet.braked(place)
    said: dict[str, str] = {"type": "slide"} if frame.motion == "prismatic" else {}
    if np.isfinite([feels.lower, feels.upper]).all():
        said["range"] = row([feels.lower, feels.upper])
    values = {
        "armature": feels.armature,
        "damping": BRAKED_DAMPING if braked else feels.damping,
        "frictionloss": 0.0 if braked else feels.frictionloss,
    }
    said |= {key: exact(value) for key, value in values.items() if value}
    if feels.stiffness:
        said |= {"stiffness": exact(feels.stiffness), "springref": exact(feels.rest)}
    name = sheet.name(place.name, frame.name)
    family, kind = ({"joint": said}, frame.name) if said else ({}, "passive")
    if feels.joint is not None:
        family[servo_tag(sheet, feels.joint)] = servo_defaults(sheet, place, feels.joint)
        name, kind = hinge_name(sheet, place, feels.joint), feels.joint.name
    shared = kind if len(sheet.rig.arms) == 1 else f"{place.arm.name}_{kind}"
    made.classes[name] = sheet.classes.family(shared, family)
    made.hinges[name] = (place.name, frame.name)
    back = inverse(frame.after)
    where = {"name": name, "class": made.classes[name]}
    if np.abs(back[:3, 3]).max() >= NOISE:
        where["pos"] = row(back[:3, 3])
    if np.abs(back[:3, 2] - np.array([0.0, 0.0, 1.0])).max() >= NOISE:
        where["axis"] = row(back[:3, 2])
    child(body, "joint", where)


def _add_shapes(sheet: Sheet, place: RigArm, body: Any, bodies: Iterable[Body]) -> None:
    mask = sheet.masks[place.name]
    owner = "" if len(sheet.rig.arms) == 1 else place.name
    collision = sheet.classes.collision(owner, mask) if mask.conaffinity else ""
    for shape in (s for b in bodies for s in b.shapes):
        _add_shape(sheet, body, shape, collision)


def _add_shape(sheet: Sheet, body: Any, shape: Shape, collision: str) -> None:
    """Write what is seen of a shape and what it collides as: with an empty class as nothing."""
    if shape.visible:
        said = {"class": "visual", "material": shape.material}
        child(body, "geom", said | _form(sheet, shape, "mesh") | placed(shape.pose))
    if shape.collide and collision:
        if shape.hull == "capsule" or (sheet.variant is MJX and shape.kind == "cylinder"):
            shape = capsule_about(shape)
        said = {"class": collision}
        child(body, "geom", said | _form(sheet, shape, "capsule") | placed(shape.pose))


def _form(sheet: Sheet, shape: Shape, default: str) -> dict[str, str]:
    said = {} if shape.kind == default else {"type": shape.kind}
    if shape.mesh is not None:
        return {**said, "mesh": sheet.meshes[shape.mesh]}
    return {**said, "size": row(shape.size[: SIZES[shape.kind]])}


def at_point(anchor: Anchor, point: Array) -> Array:
    """Return the pose of a point of a frame in the body that carries it, (4, 4)."""
    return anchor.pose @ transform(np.eye(3), point)
