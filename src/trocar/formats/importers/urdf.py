"""URDF files: a tree of links.

Source: the format as ROS documents it (wiki.ros.org/urdf/XML).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.formats.importers.model import (
    KINDS,
    ImportFileError,
    LinkShape,
    ModelJoint,
    SourceLink,
    SourceModel,
    as_tree,
    nearest_material,
)
from trocar.formats.importers.xml_tree import (
    MeshFinder,
    XmlNode,
    inertia_of,
    moving_joint,
    read_xml,
)
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

#: What other programs put beside the robot; it moves nothing.
PASSED_OVER = ("gazebo", "transmission", "mujoco")


def read_urdf(path: Path, packages: tuple[Path, ...] = ()) -> SourceModel:
    """Read a robot.

    Args:
        path: the file
        packages: folders that hold what package:// names; those above the file are searched too

    Raises:
        ImportFileError: not a tree, an unknown element, a file that is not there; with the line
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise root.fail("is not a robot; allowed: <robot> (URDF after xacro)")
    root.check(("link", "joint", "material", *PASSED_OVER))
    colours = {m.attribute("name"): _colour(m) for m in root.children("material")}
    finder = MeshFinder(path, packages)
    links = [_link(node, colours, finder) for node in root.children("link")]
    joints = [_joint(node) for node in root.children("joint")]
    tree, order = as_tree(str(path), links, joints)
    _check_mimics(str(path), order)
    passed = sorted({n.tag for n in root.children() if n.tag in PASSED_OVER})
    warnings = tuple(f"{path}: <{tag}> is ignored" for tag in passed)
    return SourceModel(root.attribute("name"), str(path), tree, order, (), warnings)


def _colour(node: XmlNode) -> Array | None:
    node.check(("color", "texture"))
    colour = node.child("color")
    return None if colour is None else colour.numbers(4, colour.attribute("rgba"))


def _link(node: XmlNode, colours: dict[str, Array | None], finder: MeshFinder) -> SourceLink:
    node.check(("inertial", "visual", "collision", *PASSED_OVER))
    shapes: list[LinkShape] = []
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
            LinkShape(
                finder.shape(visual.need("geometry"), _origin(visual), nearest_material(rgba)),
                True,
                False,
            )
        )
    for collision in node.children("collision"):
        collision.check(("origin", "geometry", "verbose"))
        shapes.append(
            LinkShape(
                finder.shape(collision.need("geometry"), _origin(collision), "casting"), False, True
            )
        )
    inertial = node.child("inertial")
    link = SourceLink(node.attribute("name"), shapes=tuple(shapes))
    if inertial is None:
        return link
    inertial.check(("origin", "mass", "inertia"))
    at, mass = _origin(inertial), inertial.need("mass").number("value")
    inertia = inertia_of(inertial.need("inertia"), at[:3, :3])
    return replace(link, mass=mass, com=at[:3, 3], inertia=inertia)


def _origin(node: XmlNode) -> Array:
    origin = node.child("origin")
    if origin is None:
        return np.eye(4)
    turn = matrix_from_rpy(*origin.figures("rpy", 3, (0, 0, 0)))
    return transform(turn, origin.figures("xyz", 3, (0, 0, 0)))


def _joint(node: XmlNode) -> ModelJoint:
    known = ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")
    node.check((*known, "calibration", "safety_controller"))
    kind = node.attribute("type")
    if kind not in KINDS:
        raise node.fail(f"got the type {kind!r}; allowed: {', '.join(KINDS)}")
    joint = ModelJoint(
        node.attribute("name"),
        KINDS[kind],
        node.need("parent").attribute("link"),
        node.need("child").attribute("link"),
        _origin(node),
    )
    if kind == "fixed":
        return joint
    axis = node.child("axis")
    along = np.array([1.0, 0.0, 0.0]) if axis is None else axis.figures("xyz", 3, (1, 0, 0))
    if not np.linalg.norm(along) > 0.0:
        raise (axis or node).fail("has an axis of length 0; allowed: a direction")
    limit, limits = node.child("limit"), (-np.inf, np.inf)
    if limit is not None and kind != "continuous":
        limits = limit.number("lower", 0.0), limit.number("upper", 0.0)
    elif kind != "continuous":
        raise node.fail("lacks <limit>, required for a revolute or prismatic joint")
    return moving_joint(joint, node, along, limits)


def _check_mimics(file: str, joints: tuple[ModelJoint, ...]) -> None:
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        if joint.follows and joint.follows[0] not in by_name:
            raise ImportFileError(
                file, f"joint {joint.name!r} mimics {joint.follows[0]!r}, which does not exist"
            )
        seen, lead = {joint.name}, joint.follows
        while lead is not None:
            if lead[0] in seen:
                raise ImportFileError(file, f"joint {joint.name!r} mimics itself")
            seen.add(lead[0])
            lead = by_name[lead[0]].follows
