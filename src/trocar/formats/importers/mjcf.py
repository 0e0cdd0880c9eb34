"""MJCF files, as MuJoCo itself compiles them: trees with hinges and slides, and connects.

A body with several joints becomes as many links, one behind the other.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.formats.importers.model import (
    ImportFileError,
    LinkShape,
    LoopPoint,
    ModelJoint,
    SourceLink,
    SourceModel,
    as_tree,
    mesh_shape,
    nearest_material,
    solid,
)
from trocar.formats.importers.xml_tree import XmlNode, read_xml
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.inputs import is_file
from trocar.kinematics.mechanism import Motion
from trocar.modeling.mujoco_log import log_mujoco_warnings

Array = NDArray[np.float64]

#: Groups from here on are not shown by MuJoCo's viewers unless one asks.
HIDDEN_GROUP = 3
KINDS: dict[int, Motion] = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
}
WORLD = "world"


#: Numbers of a file from which MuJoCo makes data: {element: attributes}, and how many the product
#: of them may ask for; those of `replicate` are multiplied by those around it, too.
#: Source: our own choice: a height field of 1000 x 1000, textures of 4096 x 4096, and more bodies
#: than a robot has. MuJoCo itself allocates whatever is asked for.
MOST_MADE = {
    "hfield": (("nrow", "ncol"), 1_000_000),
    "replicate": (("count",), 1_000),
    "composite": (("count",), 10_000),
    "flexcomp": (("count",), 10_000),
    "texture": (("width", "height"), 1 << 24),
}
#: The same of each attribute of `size` but `memory`, which is of the simulation.
MOST_OF_SIZE = 10_000


def read_mjcf(path: Path) -> SourceModel:
    """Read a model.

    Raises:
        ImportFileError: MuJoCo refuses it, or it has a ball joint, a weld, a tendon or a flex, or
            would be too large
    """
    _check_made(path, read_xml(path), 1, frozenset({path.resolve()}))
    log_mujoco_warnings()
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as problem:
        raise ImportFileError(str(path), f"rejected by MuJoCo: {problem}") from problem
    return _MjcfReader(model, str(path)).read(path.stem)


def _check_made(path: Path, node: XmlNode, around: float, seen: frozenset[Path]) -> None:
    """Check how much a file and those that it includes ask MuJoCo to make."""
    if node.tag in ("include", "model") and (name := node.attribute("file", "")):
        file = (path.parent / name).resolve()
        if file not in seen and is_file(file):  # else MuJoCo says what is wrong
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
    for child in node.children():
        _check_made(path, child, around, seen)


def _product(text: str) -> float:
    """Return the product of the numbers of a text, without what is none and MuJoCo rejects."""
    product = 1.0
    for word in text.split():
        with suppress(ValueError):
            product *= abs(float(word))
    return product


class _MjcfReader:
    def __init__(self, model: Any, file: str) -> None:
        self._m, self._file = model, file
        self._links: list[SourceLink] = []
        self._joints: list[ModelJoint] = []
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
        link = SourceLink(
            name,
            float(m.body_mass[body]),
            np.array(m.body_ipos[body]),
            turn @ np.diag(m.body_inertia[body]) @ turn.T,
            tuple(self._shapes(body)),
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
            self._joints.append(ModelJoint(f"{name}_fixed", "fixed", parent, name, pose))
        for k in range(first, first + count):
            joint = self._name(mujoco.mjtObj.mjOBJ_JOINT, k, f"{name}_joint_{k - first}")
            last = k == first + count - 1
            child = name if last else f"{name}_{joint}"
            if not last:
                self._links.append(SourceLink(child))
            if int(m.jnt_type[k]) == int(mujoco.mjtJoint.mjJNT_FREE):
                self._warnings.append(f"{self._file}: {joint}: free joint imported as fixed")
                self._joints.append(ModelJoint(joint, "fixed", parent, child, pose))
            else:
                self._joints.append(self._joint(k, joint, (parent, child), pose))
            parent, pose = child, np.eye(4)

    def _joint(self, k: int, name: str, ends: tuple[str, str], pose: Array) -> ModelJoint:
        m = self._m
        kind = KINDS.get(int(m.jnt_type[k]))
        if kind is None:
            raise ImportFileError(
                self._file, f"joint {name!r} is a ball joint; allowed: hinge, slide"
            )
        axis, point = np.array(m.jnt_axis[k]), np.array(m.jnt_pos[k])
        lower, upper = m.jnt_range[k] if m.jnt_limited[k] else (-np.inf, np.inf)
        dof = int(m.jnt_dofadr[k])
        found = ModelJoint(
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

    def _shapes(self, body: int) -> list[LinkShape]:
        m = self._m
        first = int(m.body_geomadr[body])
        found: list[LinkShape] = []
        for g in range(first, first + int(m.body_geomnum[body])):
            pose = transform(matrix_from_quaternion(m.geom_quat[g]), np.array(m.geom_pos[g]))
            shape = self._shape(g, pose)
            if shape is None:
                continue
            touches = bool(m.geom_contype[g] or m.geom_conaffinity[g])
            hidden = int(m.geom_group[g]) >= HIDDEN_GROUP
            found.append(LinkShape(shape, not hidden, touches))
        return found

    def _shape(self, g: int, pose: Array) -> Shape | None:
        m, kinds = self._m, mujoco.mjtGeom
        size, kind = np.array(m.geom_size[g]), int(m.geom_type[g])
        material = nearest_material(np.array(m.geom_rgba[g]))
        if kind == int(kinds.mjGEOM_MESH):
            return mesh_shape(pose, self._mesh(int(m.geom_dataid[g])), material)
        sizes = {
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

    def _mesh(self, k: int) -> Mesh:
        m = self._m
        at, count = int(m.mesh_vertadr[k]), int(m.mesh_vertnum[k])
        face, faces = int(m.mesh_faceadr[k]), int(m.mesh_facenum[k])
        return Mesh(
            np.array(m.mesh_vert[at : at + count], dtype=np.float64),
            np.array(m.mesh_face[face : face + faces], dtype=np.int64),
        )

    def _equalities(
        self, joints: tuple[ModelJoint, ...]
    ) -> tuple[tuple[LoopPoint, ...], tuple[ModelJoint, ...]]:
        m, kinds = self._m, mujoco.mjtEq
        loops: dict[tuple[str, ...], LoopPoint] = {}
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

    def _connect(self, e: int, name: str) -> LoopPoint:
        m = self._m
        one, two = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
        if int(m.eq_objtype[e]) == int(mujoco.mjtObj.mjOBJ_SITE):
            bodies = [int(m.site_bodyid[s]) for s in (one, two)]
            points = [np.array(m.site_pos[s]) for s in (one, two)]
        else:
            bodies = [one, max(two, 0)]
            points = [np.array(m.eq_data[e, :3]), np.array(m.eq_data[e, 3:6])]
        names = [self._link_name(body) for body in bodies]
        return LoopPoint(name, names[0], points[0], names[1], points[1])

    def _couple(self, e: int, name: str, by_name: dict[str, ModelJoint]) -> None:
        """Take a joint equality for a mimic; one inside a loop only guards its branch."""
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
