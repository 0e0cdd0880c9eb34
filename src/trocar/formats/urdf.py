"""A rig as URDF: a tree of links, in which passive joints mimic those that motors move.

Source: the specification of URDF (wiki.ros.org/urdf/XML), and MuJoCo's extension of it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.formats.links import SHARE, SLACK, Link, LinkJoint, LinkModel, helper_link
from trocar.formats.markup import child, document, element, number, numbers
from trocar.geometry.rotations import rpy_from_matrix
from trocar.geometry.se3 import transform
from trocar.modeling.geoms import capsule_about

Array = NDArray[np.float64]

#: What stands for no limit, as URDF wants a number [N m, N, rad/s, m/s]. Source: our own choice,
#: beyond what anything here does.
UNLIMITED = 1000.0
#: Between a joint's own name and that of the one that it is to stand behind.
BEHIND = "_and_"


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


def single_leaders(model: LinkModel) -> LinkModel:
    """Return a model whose joints follow one joint at most: the others get a link of their own.

    A joint that follows two becomes two joints about the same axis, one behind the other; each has
    the damping and the friction of the one. The link between them has a millionth of the mass.
    """
    links: list[Link] = []
    joints: list[LinkJoint] = []
    start: dict[str, float] = dict(model.start)
    by_child = {joint.child: joint for joint in model.joints}
    for link in model.links:
        joint = by_child.get(link.name)
        if joint is None or len(joint.follows) < 2:
            links.append(link)
            joints += [joint] if joint else []
            continue
        parts = list(_split(model, joint))
        between = [helper_link(link, part.child) for part in parts[:-1]]
        left = 1.0 - SHARE * len(between)
        links += [*between, replace(link, mass=left * link.mass, inertia=left * link.inertia)]
        joints += parts
        del start[joint.name]
        start |= {p.name: p.offset + sum(r * start[n] for n, r in p.follows) for p in parts}
    return replace(model, links=tuple(links), joints=tuple(joints), start=start)


def _split(model: LinkModel, joint: LinkJoint) -> Iterator[LinkJoint]:
    last = len(joint.follows) - 1
    parent, pose, offset = joint.parent, joint.pose, joint.offset
    for k, (name, ratio) in enumerate(joint.follows):
        leader = model.joint(name)
        own = joint.name if k == last else f"{joint.name}_{k + 1}"
        child = joint.child if k == last else f"{joint.child}_{k + 1}"
        lower, upper = np.sort(offset + ratio * np.array([leader.lower, leader.upper]))
        yield replace(
            joint,
            name=own,
            parent=parent,
            child=child,
            pose=pose,
            lower=float(lower) - SLACK,
            upper=float(upper) + SLACK,
            velocity=abs(ratio) * leader.velocity,
            offset=offset,
            follows=((name, ratio),),
        )
        parent, pose, offset = child, np.eye(4), 0.0


def leaders_first(model: LinkModel) -> LinkModel:
    """Return a model in which sorting joints by name brings each behind the joint that it follows.

    Readers that sort the joints of a link by name, and then go down each branch, want to know a
    joint before those that follow it. A joint whose branch comes too early is renamed: behind the
    name of the branch that must come first comes its own. Joints that move on their own keep their
    names, so a model in which two of them wait for one another stays as it is.
    """
    for _ in model.joints:
        renamed = dict(_to_rename(model))
        if not renamed:
            break
        joints = tuple(replace(j, name=renamed.get(j.name, j.name)) for j in model.joints)
        start = {renamed.get(name, name): value for name, value in model.start.items()}
        model = replace(model, joints=joints, start=start)
    return model


def _to_rename(model: LinkModel) -> Iterator[tuple[str, str]]:
    """Yield (old, new) names of joints that come too early, at most one of each link's."""
    for joints in _branches(model).values():
        for joint in sorted(joints, key=lambda joint: joint.name):
            later = [other.name for other in joints if other.name > joint.name
                     and _waits_for(model, joint, other)]  # fmt: skip
            if later and (joint.follows or joint.kind == "fixed"):
                yield joint.name, f"{max(later)}{BEHIND}{joint.name.split(BEHIND)[-1]}"
                break


def late_leaders(model: LinkModel) -> tuple[tuple[str, str], ...]:
    """Return (follower, leader) of each joint that sorting by name brings ahead of its leader."""
    order: dict[str, int] = {}
    branches = _branches(model)

    def visit(link: str) -> None:
        for joint in sorted(branches.get(link, ()), key=lambda joint: joint.name):
            order[joint.name] = len(order)
            visit(joint.child)

    visit(model.links[0].name)
    return tuple(
        (joint.name, name)
        for joint in model.joints
        for name, _ in joint.follows
        if order[name] > order[joint.name]
    )


def _branches(model: LinkModel) -> Mapping[str, list[LinkJoint]]:
    """Return the joints that hang on each link."""
    found: dict[str, list[LinkJoint]] = defaultdict(list)
    for joint in model.joints:
        found[joint.parent].append(joint)
    return found


def _waits_for(model: LinkModel, joint: LinkJoint, other: LinkJoint) -> bool:
    """Tell whether a joint behind `joint`, or itself, follows one behind `other`, or itself."""
    mine, theirs = _behind(model, joint), {j.name for j in _behind(model, other)}
    return any(name in theirs for j in mine for name, _ in j.follows)


def _behind(model: LinkModel, root: LinkJoint) -> list[LinkJoint]:
    found, reached = [root], {root.child}
    for joint in model.joints:  # parents come before children
        if joint.parent in reached:
            found.append(joint)
            reached.add(joint.child)
    return found
