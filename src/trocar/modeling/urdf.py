"""A rig as URDF: a tree of links, in which passive joints mimic those that motors move.

Source: the specification of URDF (wiki.ros.org/urdf/XML), and MuJoCo's extension of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.geometry.rotations import rpy_from_matrix
from trocar.geometry.se3 import transform
from trocar.modeling.arm_model import capsule_about
from trocar.modeling.links import Link, LinkJoint, LinkModel
from trocar.modeling.markup import child, document, element, number, numbers
from trocar.modeling.trees import leaders_first, single_leaders

Array = NDArray[np.float64]

#: What stands for no limit, as URDF wants a number [N m, N, rad/s, m/s]. Source: our own choice,
#: beyond what anything here does.
UNLIMITED = 1000.0


def urdf_tree(model: LinkModel) -> LinkModel:
    """Return a model as URDF tells it: joints follow one other at most, and are sorted behind it.

    Source: measured with pinocchio 4.1.0, which reads `mimic` only of joints that it knows, in the
    order in which urdfdom hands them out: by name.
    """
    return leaders_first(single_leaders(model))


def urdf(
    model: LinkModel, meshes: Mapping[Mesh, str] | None = None, *, friction: bool = True
) -> bytes:
    """Return the URDF of a rig.

    Args:
        model: the rig
        meshes: {mesh: where its file is}, such as "meshes/PSM1_yaw.obj" or
            "package://davinci/meshes/PSM1_yaw.obj"
        friction: whether joints have dry friction, which Drake warns that it leaves out
    """
    tree = urdf_tree(model)
    places = dict(meshes or {})
    robot = element("robot", {"name": model.name})
    robot.append(_for_mujoco(places.values()))
    for name in sorted({s.material for link in tree.links for s in link.shapes}):
        material = child(robot, "material", {"name": name})
        child(material, "color", {"rgba": numbers(MATERIALS[name].rgba)})
    joints = {joint.child: joint for joint in tree.joints}
    for link in tree.links:
        robot.append(_link(link, places))
        if link.name in joints:
            robot.append(_joint(joints[link.name], friction))
    return document(robot, model.title)


def _for_mujoco(places: Iterable[str]) -> Any:
    """Return MuJoCo's own element, which others pass over: keep every link and every shape."""
    named = next((place for place in places if "://" in place), "")
    found = {"strippath": "true", "meshdir": "meshes"} if named else {"strippath": "false"}
    mujoco = element("mujoco")
    kept = dict.fromkeys(("fusestatic", "discardvisual", "inertiafromgeom"), "false")
    child(mujoco, "compiler", {**found, **kept})
    return mujoco


def _link(link: Link, places: Mapping[Mesh, str]) -> Any:
    made = element("link", {"name": link.name})
    if link.mass > 0.0:
        inertial = child(made, "inertial")
        child(inertial, "origin", {"xyz": numbers(link.com), "rpy": "0 0 0"})
        child(inertial, "mass", {"value": number(link.mass)})
        child(inertial, "inertia", _inertia(link.inertia))
    for shape in link.shapes:
        if shape.visible:
            for part in _drawn(shape):
                visual = _shape(made, "visual", part, places)
                child(visual, "material", {"name": shape.material})
    for shape in link.shapes:
        if shape.collide:
            for part in _drawn(capsule_about(shape) if shape.hull == "capsule" else shape):
                _shape(made, "collision", part, places)
    return made


def _inertia(inertia: Array) -> dict[str, str]:
    noise = 1e-15 * float(np.trace(inertia))
    pairs = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2),
             "izz": (2, 2)}  # fmt: skip
    return {key: numbers([inertia[at]], noise=noise) for key, at in pairs.items()}


def _drawn(shape: Shape) -> Iterator[Shape]:
    """Yield what a shape is made of in URDF, which knows no capsules."""
    if shape.kind != "capsule":
        yield shape
        return
    radius, half, _ = shape.size
    yield replace(shape, kind="cylinder")
    for end in (-half, half):
        at = shape.pose @ transform(np.eye(3), np.array([0.0, 0.0, end]))
        yield replace(shape, kind="sphere", pose=at, size=np.array([radius, 0.0, 0.0]))


def _shape(link: Any, tag: str, shape: Shape, places: Mapping[Mesh, str]) -> Any:
    made = child(link, tag)
    child(made, "origin", _origin(shape.pose))
    geometry = child(made, "geometry")
    a, b, _ = shape.size
    if shape.mesh is not None:
        child(geometry, "mesh", {"filename": places[shape.mesh]})
    elif shape.kind == "box":
        child(geometry, "box", {"size": numbers(2.0 * shape.size)})
    elif shape.kind == "sphere":
        child(geometry, "sphere", {"radius": number(a)})
    else:
        child(geometry, "cylinder", {"radius": number(a), "length": number(2.0 * b)})
    return made


def _origin(pose: Array) -> dict[str, str]:
    return {"xyz": numbers(pose[:3, 3]), "rpy": numbers(rpy_from_matrix(pose[:3, :3]))}


def _joint(joint: LinkJoint, friction: bool) -> Any:
    made = element("joint", {"name": joint.name, "type": joint.kind})
    child(made, "origin", _origin(joint.pose))
    child(made, "parent", {"link": joint.parent})
    child(made, "child", {"link": joint.child})
    if joint.hinge is None:
        return made
    child(made, "axis", {"xyz": "0 0 1"})
    lower, upper = max(joint.lower, joint.hinge.lower), min(joint.upper, joint.hinge.upper)
    limits = {"lower": lower, "upper": upper, "effort": joint.effort, "velocity": joint.velocity}
    known = {k: v if np.isfinite(v) else UNLIMITED for k, v in limits.items()}
    child(made, "limit", {key: number(value) for key, value in known.items()})
    dynamics = {"damping": number(joint.hinge.damping)}
    if friction:
        dynamics["friction"] = number(joint.hinge.frictionloss)
    child(made, "dynamics", dynamics)
    for name, ratio in joint.follows:
        follows = {"joint": name, "multiplier": number(ratio), "offset": number(joint.offset)}
        child(made, "mimic", follows)
    return made
