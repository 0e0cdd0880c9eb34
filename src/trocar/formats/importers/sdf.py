"""SDF files: one model, loops allowed.

Source: the format as sdformat.org documents it: poses are relative to the model unless they name
another frame (1.7), a joint's to its child; a joint's axis is given in the joint's frame, in the
model's where the file says so (`use_parent_model_frame` up to 1.6, `expressed_in` from 1.7).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.formats.importers.model import (
    KINDS,
    ImportFileError,
    LinkShape,
    LoopPoint,
    ModelJoint,
    SourceLink,
    SourceModel,
    as_tree,
    nearest_material,
)
from trocar.formats.importers.xml_tree import (
    UNLIMITED,
    MeshFinder,
    XmlNode,
    inertia_of,
    moving_joint,
    read_xml,
)
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import inverse, transform

Array = NDArray[np.float64]

MODEL = ("link", "joint", "frame", "pose")
#: Says how a simulator treats the model, not what it is.
PASSED_OVER = ("plugin", "static", "self_collide", "allow_auto_disable", "enable_wind")
LINK = ("pose", "inertial", "visual", "collision")
LINK_PASSED_OVER = ("gravity", "self_collide", "kinematic", "enable_wind", "velocity_decay")
WORLD = "world"


def read_sdf(path: Path, packages: tuple[Path, ...] = ()) -> SourceModel:
    """Read a model.

    Raises:
        ImportFileError: no single model, an unknown element, a file that is not there; with the
            line
    """
    root = read_xml(path)
    if root.tag != "sdf":
        raise root.fail("is not SDF; allowed: <sdf>")
    root.check(("model", "world"))
    models = root.children("model") + [
        m for w in root.children("world") for m in w.children("model")
    ]
    if len(models) != 1:
        raise root.fail(f"contains {len(models)} models; allowed: one")
    version = root.attribute("version", "1.6")
    numbers = re.match(r"(\d{1,3})\.(\d{1,3})", version)
    if numbers is None:
        raise root.fail(f"version: got {version[:40]!r}; allowed: two numbers, as in 1.7")
    major, minor = map(int, numbers.groups())
    return _SdfModel(models[0], str(path), (major, minor), packages).read(path)


@dataclass(frozen=True, eq=False)
class _Place:
    """A pose as it is written: relative to the frame of that name."""

    pose: Array
    to: str


class _SdfModel:
    def __init__(
        self, node: XmlNode, file: str, version: tuple[int, ...], packages: tuple[Path, ...]
    ) -> None:
        self._node, self._file = node, file
        self._version = version
        node.check((*MODEL, *PASSED_OVER))
        self._finder = MeshFinder(Path(file), packages)
        self._still = {
            joint.need("child").text()
            for joint in node.children("joint")
            if joint.attribute("type") == "fixed" and joint.need("parent").text() == WORLD
        }
        self._from_world = inverse(_own_pose(node))
        self._places: dict[str, _Place] = {}
        for link in node.children("link"):
            self._place(link, "__model__")
        for joint in node.children("joint"):
            self._place(joint, joint.need("child").text())
        for frame in node.children("frame"):
            self._place(frame, frame.attribute("attached_to", "") or "__model__")

    def _place(self, node: XmlNode, default: str) -> None:
        pose = node.child("pose")
        at = np.eye(4) if pose is None else _pose(pose)
        to = default if pose is None else (pose.attribute("relative_to", "") or default)
        name = node.attribute("name")
        if name in self._places:
            raise node.fail(f"has the duplicate name {name!r}")
        self._places[name] = _Place(at, to)

    def at(self, name: str, node: XmlNode, seen: tuple[str, ...] = ()) -> Array:
        """Return T_model_frame of anything that has a name, (4, 4)."""
        if name == "__model__":
            return np.eye(4)
        if name == WORLD:
            return self._from_world
        if name in seen:
            raise node.fail(f"poses of {', '.join(seen)} form a cycle")
        if name not in self._places:
            raise node.fail(f"names {name!r}; known: {', '.join(self._places)}")
        place = self._places[name]
        return self.at(place.to, node, (*seen, name)) @ place.pose

    def read(self, path: Path) -> SourceModel:
        """Return links, the joints of a tree, and what closes loops."""
        links = [self._link(node) for node in self._node.children("link")]
        nodes = self._node.children("joint")
        if any(node.need("parent").text() == WORLD for node in nodes):
            links.insert(0, SourceLink(WORLD))
        tree: list[ModelJoint] = []
        loops: list[LoopPoint] = []
        warnings = [
            f"{self._file}: <{tag}> is ignored"
            for tag in sorted({n.tag for n in self._node.children() if n.tag in PASSED_OVER})
        ]
        taken: set[str] = set()
        for node in nodes:
            joint = self._joint(node)
            if joint.child not in taken:
                taken.add(joint.child)
                tree.append(joint)
                continue
            at = self.at(joint.name, node)[:3, 3]
            sides = [
                inverse(self.at(name, node)) @ np.append(at, 1.0)
                for name in (joint.parent, joint.child)
            ]
            loops.append(
                LoopPoint(joint.name, joint.parent, sides[0][:3], joint.child, sides[1][:3])
            )
        try:
            ordered, joints = as_tree(str(path), links, tree)
        except ImportFileError as problem:
            raise self._node.fail(str(problem).partition(": ")[2]) from problem
        name = self._node.attribute("name")
        return SourceModel(name, self._file, ordered, joints, tuple(loops), tuple(warnings))

    def _link(self, node: XmlNode) -> SourceLink:
        node.check((*LINK, *LINK_PASSED_OVER, "sensor", "light"))
        shapes: list[LinkShape] = []
        for visual in node.children("visual"):
            shapes.append(
                LinkShape(
                    self._finder.shape(
                        visual.need("geometry"), _own_pose(visual), _material(visual)
                    ),
                    True,
                    False,
                )
            )
        for collision in node.children("collision"):
            shapes.append(
                LinkShape(
                    self._finder.shape(collision.need("geometry"), _own_pose(collision), "casting"),
                    False,
                    True,
                )
            )
        link = SourceLink(node.attribute("name"), shapes=tuple(shapes))
        inertial = node.child("inertial")
        if inertial is None:  # the format's own default; what is nothing and stands still has none
            nothing = not shapes and link.name in self._still
            return link if nothing else replace(link, mass=1.0, inertia=np.eye(3))
        at, values = _own_pose(inertial), inertial.child("inertia")
        inertia = inertia_of(values, at[:3, :3], diagonal=1.0)
        return replace(link, mass=inertial.number("mass", 1.0), com=at[:3, 3], inertia=inertia)

    def _joint(self, node: XmlNode) -> ModelJoint:
        node.check(("pose", "parent", "child", "axis", "physics", "sensor"))
        kind, name = node.attribute("type"), node.attribute("name")
        if kind not in KINDS:
            raise node.fail(f"got the type {kind!r}; allowed: {', '.join(KINDS)}")
        parent, child = node.need("parent").text(), node.need("child").text()
        at_child, here = self.at(child, node), self.at(name, node)
        pose = inverse(self.at(parent, node)) @ at_child
        joint = ModelJoint(name, KINDS[kind], parent, child, pose)
        if kind == "fixed":
            return joint
        axis = node.need("axis")
        axis.check(("xyz", "limit", "dynamics", "use_parent_model_frame", "mimic"))
        along = inverse(at_child)[:3, :3] @ self._axis(axis, here)
        limit, limits = axis.child("limit"), (-np.inf, np.inf)
        if limit is not None and kind != "continuous":
            limits = _bound(limit.number("lower", -1e16)), _bound(limit.number("upper", 1e16))
        joint = replace(joint, point=(inverse(at_child) @ here)[:3, 3])
        return moving_joint(joint, axis, along, limits)

    def _axis(self, axis: XmlNode, here: Array) -> Array:
        """Return a joint's axis in the model's frame, (3,)."""
        xyz = axis.child("xyz")
        along = np.array([0.0, 0.0, 1.0]) if xyz is None else xyz.numbers(3)
        if not np.linalg.norm(along) > 0.0:
            raise axis.fail("has a length of 0; allowed: a direction")
        named = "" if xyz is None else xyz.attribute("expressed_in", "")
        if named:
            return self.at(named, axis)[:3, :3] @ along
        flag = axis.child("use_parent_model_frame")
        in_model = flag is not None and flag.text() in ("1", "true")
        return along if in_model or self._version < (1, 5) else here[:3, :3] @ along


def _pose(node: XmlNode) -> Array:
    values = node.numbers(6)
    if node.attribute("degrees", "false") in ("1", "true"):
        values[3:] = np.radians(values[3:])
    return transform(matrix_from_rpy(*values[3:]), values[:3])


def _own_pose(node: XmlNode) -> Array:
    pose = node.child("pose")
    return np.eye(4) if pose is None else _pose(pose)


def _material(visual: XmlNode) -> str:
    material = visual.child("material")
    colour = None if material is None else (material.child("diffuse") or material.child("ambient"))
    if colour is None:
        return nearest_material(None)
    return nearest_material(np.array([float(v) for v in colour.text().split()]))


def _bound(value: float) -> float:
    return float(np.sign(value) * np.inf) if abs(value) > UNLIMITED else value
