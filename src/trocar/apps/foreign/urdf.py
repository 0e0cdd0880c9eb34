"""URDF files: a tree of links.

Source: the format as ROS documents it (wiki.ros.org/urdf/XML).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.apps.foreign import solids
from trocar.apps.foreign.mesh_finder import MeshFinder
from trocar.apps.foreign.records import (
    KINDS,
    ForeignFileError,
    ForeignJoint,
    ForeignLink,
    ForeignModel,
    ForeignShape,
    as_tree,
)
from trocar.apps.foreign.xml_tree import Node, inertia_of, pose_of, read_xml
from trocar.descriptions.records import Shape

Array = NDArray[np.float64]

#: What other programs put beside the robot; it moves nothing.
PASSED_OVER = ("gazebo", "transmission", "mujoco")


def read_urdf(path: Path, packages: tuple[Path, ...] = ()) -> ForeignModel:
    """Read a robot.

    Args:
        path: the file
        packages: folders that hold what package:// names; those above the file are searched too

    Raises:
        ForeignFileError: not a tree, an unknown element, a file that is not there; with the line
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise root.fail("is no robot; allowed: <robot> (URDF after xacro)")
    root.check(("link", "joint", "material", *PASSED_OVER))
    colours = {m.attribute("name"): _colour(m) for m in root.children("material")}
    finder = MeshFinder(path, packages)
    links = [_link(node, colours, finder) for node in root.children("link")]
    joints = [_joint(node) for node in root.children("joint")]
    tree, order = as_tree(str(path), links, joints)
    _check_mimics(str(path), order)
    passed = sorted({n.tag for n in root.children() if n.tag in PASSED_OVER})
    said = tuple(f"{path}: <{tag}> is passed over" for tag in passed)
    return ForeignModel(root.attribute("name"), str(path), tree, order, (), said)


def _colour(node: Node) -> Array | None:
    node.check(("color", "texture"))
    colour = node.child("color")
    return None if colour is None else colour.numbers(4, colour.attribute("rgba"))


def _link(node: Node, colours: dict[str, Array | None], finder: MeshFinder) -> ForeignLink:
    node.check(("inertial", "visual", "collision", *PASSED_OVER))
    shapes: list[ForeignShape] = []
    for visual in node.children("visual"):
        visual.check(("origin", "geometry", "material"))
        material = visual.child("material")
        rgba = None
        if material is not None:
            name = material.attribute("name", "")
            own = _colour(material)
            rgba = colours.setdefault(name, own) if own is None else own
            colours[name] = rgba if name else None
        shapes.append(
            ForeignShape(_shape(visual, solids.nearest_material(rgba), finder), True, False)
        )
    for collision in node.children("collision"):
        collision.check(("origin", "geometry", "verbose"))
        shapes.append(ForeignShape(_shape(collision, "casting", finder), False, True))
    inertial = node.child("inertial")
    link = ForeignLink(node.attribute("name"), shapes=tuple(shapes))
    if inertial is None:
        return link
    inertial.check(("origin", "mass", "inertia"))
    at = _origin(inertial)
    values = inertial.need("inertia")
    six = {k: values.number(k, 0.0) for k in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")}
    turn = at[:3, :3]
    return replace(
        link,
        mass=inertial.need("mass").number("value"),
        com=at[:3, 3],
        inertia=turn @ inertia_of(six) @ turn.T,
    )


def _origin(node: Node) -> Array:
    origin = node.child("origin")
    if origin is None:
        return np.eye(4)
    return pose_of(origin.vector("xyz", (0, 0, 0)), origin.vector("rpy", (0, 0, 0)))


def _shape(node: Node, material: str, finder: MeshFinder) -> Shape:
    pose, geometry = _origin(node), node.need("geometry")
    geometry.check(("box", "cylinder", "sphere", "capsule", "mesh"))
    inside = geometry.children()
    if len(inside) != 1:
        raise geometry.fail(f"has {len(inside)} shapes; allowed: one")
    kind = inside[0]
    if kind.tag == "box":
        return solids.box(pose, kind.numbers(3, kind.attribute("size")), material)
    if kind.tag == "sphere":
        return solids.sphere(pose, kind.number("radius"), material)
    if kind.tag == "mesh":
        file = finder.find(kind, kind.attribute("filename"))
        return solids.mesh(pose, file, kind.vector("scale", (1, 1, 1)), material)
    make = solids.cylinder if kind.tag == "cylinder" else solids.capsule
    return make(pose, kind.number("radius"), kind.number("length"), material)


def _joint(node: Node) -> ForeignJoint:
    known = ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")
    node.check((*known, "calibration", "safety_controller"))
    kind = node.attribute("type")
    if kind not in KINDS:
        raise node.fail(f"got the type {kind!r}; allowed: {', '.join(KINDS)}")
    joint = ForeignJoint(
        node.attribute("name"),
        KINDS[kind],
        node.need("parent").attribute("link"),
        node.need("child").attribute("link"),
        _origin(node),
    )
    if kind == "fixed":
        return joint
    axis = node.child("axis")
    along = np.array([1.0, 0.0, 0.0]) if axis is None else axis.vector("xyz", (1, 0, 0))
    if not np.linalg.norm(along) > 0.0:
        raise (axis or node).fail("has an axis of length 0; allowed: a direction")
    dynamics, limit = node.child("dynamics"), node.child("limit")
    lower, upper = -np.inf, np.inf
    if limit is not None and kind != "continuous":
        lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
    elif kind != "continuous":
        raise node.fail("lacks <limit>, which a revolute or prismatic joint needs")
    return replace(
        joint,
        axis=along / np.linalg.norm(along),
        lower=lower,
        upper=upper,
        effort=_or_infinite(limit, "effort"),
        velocity=_or_infinite(limit, "velocity"),
        damping=0.0 if dynamics is None else dynamics.number("damping", 0.0),
        friction=0.0 if dynamics is None else dynamics.number("friction", 0.0),
        follows=_mimic(node),
    )


def _or_infinite(limit: Node | None, key: str) -> float:
    value = 0.0 if limit is None else limit.number(key, 0.0)
    return value if value > 0.0 else np.inf


def _mimic(node: Node) -> tuple[str, float, float] | None:
    mimic = node.child("mimic")
    if mimic is None:
        return None
    return (
        mimic.attribute("joint"),
        mimic.number("multiplier", 1.0),
        mimic.number("offset", 0.0),
    )


def _check_mimics(file: str, joints: tuple[ForeignJoint, ...]) -> None:
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.follows and joint.follows[0] not in by_name:
            raise ForeignFileError(
                file, f"joint {joint.name!r} mimics {joint.follows[0]!r}, which is not there"
            )
        seen, lead = {joint.name}, joint.follows
        while lead is not None:
            if lead[0] in seen:
                raise ForeignFileError(file, f"joint {joint.name!r} mimics itself")
            seen.add(lead[0])
            lead = by_name[lead[0]].follows
