"""SDF: links, hinges, and the joints that close loops.

A model is written in the pose with every public joint at 0 and the loops closed. Readers count
joints from there: a passive joint of a loop that is no parallelogram differs by `LinkModel.zero`.

Source: the format as sdformat.org documents it: poses are relative to the model unless they name
another frame (1.7), a joint's to its child; a joint's axis is given in the joint's frame, in the
model's where the file says so (`use_parent_model_frame` up to 1.6, `expressed_in` from 1.7).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.errors import UnknownNameError
from trocar.formats.folder import (
    ExportTask,
    filled,
    left_out,
    markdown_table,
    readme,
    write_meshes,
)
from trocar.formats.format import Format
from trocar.formats.links import (
    KINDS,
    WORLD,
    ImportFileError,
    Link,
    LinkJoint,
    LinkLoop,
    LinkModel,
    SourceJoint,
    SourceModel,
    as_tree,
    joint_motion,
    joints_above,
    material_of,
    without_capsule,
)
from trocar.formats.meshes import MeshFinder, ReadOptions
from trocar.formats.xml_tree import (
    INFINITE,
    XmlNode,
    child,
    document,
    element,
    inertia_of,
    lxml_etree,
    moving_joint,
    read_xml,
)
from trocar.geometry.rotations import matrix_from_rpy, rpy_from_matrix
from trocar.geometry.se3 import inverse, transform, translation
from trocar.modeling.options import CONTACT_FRICTION

Array = NDArray[np.float64]

#: Versions that are written: 1.7 for Gazebo Classic 11, 1.9 for Drake and Gazebo from Fortress on,
#: 1.11 for Gazebo from Harmonic on. Source: the table of versions in gazebosim/sdformat's README.
VERSIONS = ("1.9", "1.7", "1.11")
#: Link fixed to the world, with the fixed props.
GROUND = "ground"
#: Namespace of Drake's elements. Source: Drake's page "Supported parsing of SDFormat and URDF".
DRAKE = "http://drake.mit.edu"
#: Largest angle between parallel hinges [rad]. Source: our own choice, above rounding.
PARALLEL = 1e-9
Z = "0 0 1"
#: Name of the floor among props, and height of the ground in a rig without one [m].
#: Source: data/rigs, those with arms on stands.
FLOOR, FLOOR_Z = "floor", -0.75
#: Time step of Gazebo's physics [s]. Source: that of our own simulation.
STEP = 0.001
#: Direction and colour of the sun. Source: our own choice.
SUN_DIRECTION, SUN_COLOUR = (-0.5, 0.3, -0.9), (0.8, 0.8, 0.8, 1.0)
GREY = (0.7, 0.7, 0.72, 1.0)
MODEL = "model.sdf"
MODEL_PARTS = ("link", "joint", "frame", "pose", "include", "model")
#: Elements of an <include>.
INCLUDE_PARTS = ("uri", "name", "pose", "static", "plugin")
#: Models inside one another, at most. Source: our own choice.
DEEPEST = 8
#: Between the names of a model and of a part of it.
INSIDE = "::"
#: Frame of a model.
MODEL_FRAME = "__model__"
#: Elements of a model that configure a simulator; they are ignored with a warning.
PASSED_OVER = ("plugin", "static", "self_collide", "allow_auto_disable", "enable_wind")
#: Colours of Gazebo's materials. Source: gazebo-classic, media/materials/scripts/gazebo.material,
#: `diffuse`.
GAZEBO_COLOURS: Mapping[str, tuple[float, float, float]] = {
    "Gazebo/Grey": (0.7, 0.7, 0.7), "Gazebo/DarkGrey": (0.175, 0.175, 0.175),
    "Gazebo/White": (1.0, 1.0, 1.0), "Gazebo/FlatBlack": (0.1, 0.1, 0.1),
    "Gazebo/Black": (0.0, 0.0, 0.0), "Gazebo/Red": (1.0, 0.0, 0.0),
    "Gazebo/RedBright": (0.87, 0.26, 0.07), "Gazebo/Green": (0.0, 1.0, 0.0),
    "Gazebo/Blue": (0.0, 0.0, 1.0), "Gazebo/Yellow": (1.0, 1.0, 0.0),
    "Gazebo/ZincYellow": (0.9725, 0.9529, 0.2078), "Gazebo/Purple": (1.0, 0.0, 1.0),
    "Gazebo/Turquoise": (0.0, 1.0, 1.0), "Gazebo/Orange": (1.0, 0.5088, 0.0468),
    "Gazebo/Gold": (0.8, 0.64869, 0.120759),
}  # fmt: skip
LINK_PARTS = ("pose", "inertial", "visual", "collision")
LINK_PASSED_OVER = ("gravity", "self_collide", "kinematic", "enable_wind", "velocity_decay")


def check_version(version: str) -> str:
    """Return a version of SDF if it is one of `VERSIONS`.

    Raises:
        UnknownNameError: it is not
    """
    if version not in VERSIONS:
        raise UnknownNameError("SDF version", version, VERSIONS)
    return version


def model_name(model: LinkModel) -> str:
    """Return the name of a rig in files: letters, digits and _."""
    return re.sub(r"\W+", "_", model.name)


def sdf(model: LinkModel, version: str = "1.9", meshes: Mapping[Mesh, str] | None = None) -> bytes:
    """Return a rig as an SDF file of one model.

    A frame without mass is a `frame`, so no link is weightless; fixed props are one link, "ground".
    Numbers are exact in float64.

    Args:
        model: the rig
        version: one of `VERSIONS`
        meshes: {mesh: its file's name without folder and ending}; absent: each by its own name

    Raises:
        UnknownNameError: a version that cannot be written
        MissingExtraError: lxml is not installed
    """
    root = sdf_root(version)
    add_model(root, model, version, meshes)
    return document(root, f"{model.title}; SI units and radians")


def sdf_root(version: str) -> Any:
    """Return the root element of an SDF file.

    Raises:
        UnknownNameError: a version that cannot be written
    """
    spaces = {} if check_version(version) == "1.7" else {"drake": DRAKE}
    return lxml_etree().Element("sdf", {"version": version}, nsmap=spaces)


def add_model(
    parent: Any, model: LinkModel, version: str, meshes: Mapping[Mesh, str] | None = None
) -> None:
    """Append a rig as a model."""
    made = child(parent, "model", {"name": model_name(model)})
    carriers = rigid_links(model)
    links = {GROUND: child(made, "link", {"name": GROUND})}
    add_fixed(made, GROUND, WORLD, GROUND)
    for joint, link in zip(model.joints, model.links[1:], strict=True):
        on = GROUND if joint.parent == WORLD else joint.parent
        if link.mass:
            links[link.name] = _add_link(made, model, joint, link, on)
        else:
            add_pose(child(made, "frame", {"name": link.name, "attached_to": on}), joint.pose)
        names = meshes if meshes is not None else _own_names(link)
        carrier, frame = links[carriers[link.name]], "" if link.mass else link.name
        for k, shape in enumerate(link.shapes):
            add_shape(carrier, f"{link.name}_{k}", shape, frame, version, names)
    for joint in model.joints:
        if joint.child in links:
            add_joint(made, model, joint, carriers[joint.parent], version)
    for loop in model.loops:
        add_loop(made, model, loop)
    if version != "1.7":
        add_collision_filters(made, model, carriers)
        return
    for joint in model.joints:
        add_gearbox(made, model, joint, carriers[joint.parent])


def world(model: LinkModel, version: str, meshes: Mapping[Mesh, str] | None = None) -> bytes:
    """Return an SDF world with a rig, a ground plane and a sun.

    The model is part of the file, not included by name, so Gazebo opens the file in any folder.

    Args:
        model, version, meshes: as for `sdf`
    """
    root = sdf_root(version)
    made = child(root, "world", {"name": f"{model_name(model)}_world"})
    physics = child(made, "physics", {"name": "millisecond", "type": "ode"})
    child(physics, "max_step_size", text=exact([STEP]))
    child(physics, "real_time_factor", text=exact([1.0]))
    _add_sun(made)
    _add_ground(made, model)
    add_model(made, model, version, meshes)
    return document(root, f"{model.title}, in a world; SI units and radians")


def card(model: LinkModel, version: str, file: str) -> bytes:
    """Return the `model.config` of a model's file, for Gazebo."""
    root = element("model")
    child(root, "name", text=model_name(model))
    child(root, "version", text="1.0")
    child(root, "sdf", {"version": version}, file)
    child(child(root, "author"), "name", text="the trocar authors")
    child(root, "description", text=model.title)
    return document(root)


def rigid_links(model: LinkModel) -> dict[str, str]:
    """Return the SDF link of each link, {link: SDF link}; links without mass are its frames."""
    found = {WORLD: GROUND}
    for joint, link in zip(model.joints, model.links[1:], strict=True):
        found[link.name] = link.name if link.mass else found[joint.parent]
    return found


def standing(joint: LinkJoint, zero: Mapping[str, float]) -> Array:
    """Return T_parent_child in the file, (4, 4)."""
    return joint.pose @ joint_motion(joint.kind, zero.get(joint.name, 0.0))


def _own_names(link: Link) -> dict[Mesh, str]:
    return {s.mesh: s.mesh.name for s in link.shapes if s.mesh is not None}


def _add_link(parent: Any, model: LinkModel, joint: LinkJoint, link: Link, on: str) -> Any:
    made = child(parent, "link", {"name": link.name})
    add_pose(made, standing(joint, model.zero), on)
    inertial = child(made, "inertial")
    add_pose(inertial, transform(np.eye(3), link.com))
    child(inertial, "mass", text=exact([link.mass]))
    inertia = child(inertial, "inertia")
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        tag = f"i{'xyz'[row]}{'xyz'[column]}"
        child(inertia, tag, text=exact([link.inertia[row, column]]))
    return made


def joint_name(name: str) -> str:
    """Return the name of a joint in the file, where links and joints share a namespace."""
    return f"{name}_joint"


def add_fixed(parent: Any, name: str, on: str, link: str) -> None:
    """Append a fixed joint."""
    _start(parent, name, "fixed", on, link)


def add_joint(parent: Any, model: LinkModel, joint: LinkJoint, on: str, version: str) -> None:
    """Append the joint between a link and its parent.

    Args:
        parent: the model's element
        model: the rig
        joint: a joint whose child has mass
        on: SDF link of the joint's parent
        version: one of `VERSIONS`
    """
    if joint.kind == "fixed" or joint.hinge is None:
        add_fixed(parent, joint.name, on, joint.child)
        return
    made = _start(parent, joint.name, joint.kind, on, joint.child)
    axis = child(made, "axis")
    child(axis, "xyz", text=Z)
    if joint.follows and not joint.in_loop:
        _add_coupling(made, axis, model, joint, version)
    if joint.hinge.armature and version != "1.7" and not joint.in_loop:
        child(made, f"{{{DRAKE}}}rotor_inertia", text=exact([joint.hinge.armature]))
    _add_limit(axis, model, joint)
    _add_dynamics(axis, model, joint)


def _start(parent: Any, name: str, kind: str, on: str, link: str) -> Any:
    made = child(parent, "joint", {"name": joint_name(name), "type": kind})
    child(made, "parent", text=on)
    child(made, "child", text=link)
    return made


def _add_limit(axis: Any, model: LinkModel, joint: LinkJoint) -> None:
    """Append limits; a loop's passive joint has no motor, and no limit but those of its loop."""
    limit = child(axis, "limit")
    if joint.in_loop or joint.hinge is None:
        child(limit, "effort", text=exact([0.0]))
        return
    lower = max(joint.lower, joint.hinge.lower) - model.zero[joint.name]
    upper = min(joint.upper, joint.hinge.upper) - model.zero[joint.name]
    child(limit, "lower", text=exact([lower]))
    child(limit, "upper", text=exact([upper]))
    child(limit, "effort", text=exact([joint.effort]))
    if np.isfinite(joint.velocity):
        child(limit, "velocity", text=exact([joint.velocity]))


def _add_dynamics(axis: Any, model: LinkModel, joint: LinkJoint) -> None:
    hinge = joint.hinge
    if hinge is None or not (hinge.damping or hinge.frictionloss or hinge.stiffness):
        return
    dynamics = child(axis, "dynamics")
    child(dynamics, "damping", text=exact([hinge.damping]))
    child(dynamics, "friction", text=exact([hinge.frictionloss]))
    if hinge.stiffness:
        rest = hinge.rest - model.zero[joint.name]
        child(dynamics, "spring_reference", text=exact([rest]))
        child(dynamics, "spring_stiffness", text=exact([hinge.stiffness]))


def _add_coupling(made: Any, axis: Any, model: LinkModel, joint: LinkJoint, version: str) -> None:
    """Append a joint's coupling, in the elements that readers of the version support."""
    ((leader, ratio),) = joint.follows
    offset = joint.offset + ratio * model.zero[leader] - model.zero[joint.name]
    if version == "1.11":
        mimic = child(axis, "mimic", {"joint": joint_name(leader)})
        for tag, value in (("multiplier", ratio), ("offset", offset), ("reference", 0.0)):
            child(mimic, tag, text=exact([value]))
    elif version == "1.9":
        named = {
            "joint": joint_name(leader),
            "multiplier": exact([ratio]),
            "offset": exact([offset]),
        }
        child(made, f"{{{DRAKE}}}mimic", named)


def add_gearbox(parent: Any, model: LinkModel, joint: LinkJoint, on: str) -> None:
    """Append the gearbox between a hinge and its leader, if both have the same parent.

    Gazebo Classic turns the child by -ratio times the angle of the parent, both in the reference
    body. Source: the description of `gearbox_ratio` in SDF.
    """
    if joint.kind != "revolute" or not joint.follows or joint.in_loop:
        return
    ((name, ratio),) = joint.follows
    leader = model.joint(name)
    if leader.kind != "revolute" or leader.parent != joint.parent:
        return
    sides = leader.child, joint.child
    made = _start(parent, f"{joint.name}_gear", "gearbox", *sides)
    child(made, "gearbox_ratio", text=exact([-ratio]))
    child(made, "gearbox_reference_body", text=on)
    for tag, link in zip(("axis", "axis2"), sides, strict=True):
        child(child(made, tag), "xyz", {"expressed_in": link}, Z)


def add_loop(parent: Any, model: LinkModel, loop: LinkLoop) -> None:
    """Append the joint that closes a loop: a hinge, or a ball where the hinges are skew.

    Four skew hinges could not turn; with a ball and the pin that slides (`descriptions.frames`)
    they turn as the kinematics say.
    """
    kind = "revolute" if _flat(model, loop) else "ball"
    made = _start(parent, loop.name, kind, loop.link_a, loop.link_b)
    add_pose(made, translation(loop.point_a), loop.link_a)
    if kind == "revolute":
        axis = child(made, "axis")
        child(axis, "xyz", text=Z)
        child(child(axis, "limit"), "effort", text=exact([0.0]))


def _flat(model: LinkModel, loop: LinkLoop) -> bool:
    """Return whether all hinges of a loop are parallel."""
    sides = [joints_above(model.joints, link) for link in (loop.link_a, loop.link_b)]
    common = {joint.name for joint in sides[0]} & {joint.name for joint in sides[1]}
    directions: list[np.ndarray] = []
    for side in sides:
        turned = np.eye(3)
        for joint in (j for j in reversed(side) if j.name not in common):
            # About its own z a hinge turns no direction that is parallel to it.
            turned = turned @ joint.pose[:3, :3]
            if joint.kind == "revolute":
                directions.append(turned[:, 2])
    return max(float(np.linalg.norm(d - directions[0])) for d in directions) < PARALLEL


def add_collision_filters(parent: Any, model: LinkModel, carriers: Mapping[str, str]) -> None:
    """Append a group for each arm with the groups that it does not touch; Drake alone reads it.

    As `geoms.contact_masks`: an arm touches other arms and fixed props, never itself nor its
    carrier; carriers (setup joints) touch neither each other nor fixed props.

    Args:
        parent: the model's element
        model: the rig
        carriers: {link: SDF link}, those of `rigid_links`
    """
    arm_of = {link.name: link.arm for link in model.links}
    carried = {
        (arm_of[joint.parent], arm_of[joint.child])
        for joint in model.joints
        if arm_of[joint.parent] and arm_of[joint.parent] != arm_of[joint.child]
    }
    ground = carriers[WORLD]
    setup = {carrier for carrier, _ in carried}
    arms = list(dict.fromkeys(link.arm for link in model.links if link.arm))
    _add_group(parent, ground, [ground], [])
    for arm in arms:
        members = [link.name for link in model.links if link.arm == arm and link.mass]
        ignored = [arm, *(ridden for ridden in arms if (arm, ridden) in carried)]
        if arm in setup:
            ignored += [ground, *(other for other in arms if other in setup - {arm})]
        _add_group(parent, arm, members, ignored)


def _add_group(parent: Any, name: str, members: list[str], ignored: list[str]) -> None:
    # Names of links are taken, even for elements that a reader does not support.
    group = child(parent, f"{{{DRAKE}}}collision_filter_group", {"name": f"{name}_group"})
    for member in members:
        child(group, f"{{{DRAKE}}}member", text=member)
    for other in ignored:
        child(group, f"{{{DRAKE}}}ignored_collision_filter_group", text=f"{other}_group")


def exact(values: Iterable[float]) -> str:
    """Write numbers that read back as the same float64."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def add_pose(parent: Any, pose: Array, relative_to: str = "") -> None:
    """Append a `pose`, unless it is the identity in the default frame.

    Args:
        parent: an element of lxml
        pose: T_relative_to_element, (4, 4)
        relative_to: a link or frame; "": the default frame of the element
    """
    if relative_to or not np.array_equal(pose, np.eye(4)):
        named = {"relative_to": relative_to} if relative_to else {}
        child(parent, "pose", named, exact([*pose[:3, 3], *rpy_from_matrix(pose[:3, :3])]))


def add_shape(
    link: Any, name: str, shape: Shape, frame: str, version: str, meshes: Mapping[Mesh, str]
) -> None:
    """Append the `visual` and the `collision` of a shape.

    Args:
        link: the link's element
        name: unique in the link
        shape: a shape in `frame`
        frame: name of a frame, "" for the link
        version: one of `VERSIONS`; 1.7 has no capsule, which becomes a cylinder with two spheres
        meshes: {mesh: its file's name without folder and ending}
    """
    parts = without_capsule(shape) if version == "1.7" else (shape,)
    for k, part in enumerate(parts):
        own = name if len(parts) == 1 else f"{name}_{k}"
        if shape.visible:
            visual = child(link, "visual", {"name": f"{own}_visual"})
            add_pose(visual, part.pose, frame)
            _add_geometry(visual, part, meshes)
            _add_material(visual, shape.material)
        if shape.collide:
            collision = child(link, "collision", {"name": f"{own}_collision"})
            add_pose(collision, part.pose, frame)
            _add_geometry(collision, part, meshes)
            _add_friction(collision, shape)


def _add_geometry(parent: Any, shape: Shape, meshes: Mapping[Mesh, str]) -> None:
    geometry = child(parent, "geometry")
    if shape.mesh is not None:
        made = child(geometry, "mesh")
        child(made, "uri", text=f"meshes/{meshes[shape.mesh]}.obj")
        return
    made = child(geometry, shape.kind)
    if shape.kind == "box":
        child(made, "size", text=exact(2.0 * shape.size))
        return
    child(made, "radius", text=exact(shape.size[:1]))
    if shape.kind != "sphere":
        child(made, "length", text=exact(2.0 * shape.size[1:2]))


def _add_material(visual: Any, name: str) -> None:
    row = MATERIALS[name]
    material = child(visual, "material")
    child(material, "ambient", text=exact(row.rgba))
    child(material, "diffuse", text=exact(row.rgba))
    child(material, "specular", text=exact([row.gloss] * 3 + [1.0]))


def _add_friction(collision: Any, shape: Shape) -> None:
    slide = CONTACT_FRICTION[0] if shape.friction is None else shape.friction
    ode = child(child(child(collision, "surface"), "friction"), "ode")
    for tag in ("mu", "mu2"):
        child(ode, tag, text=exact([slide]))


def _add_sun(parent: Any) -> None:
    sun = child(parent, "light", {"name": "sun", "type": "directional"})
    child(sun, "cast_shadows", text="true")
    add_pose(sun, transform(np.eye(3), np.array([0.0, 0.0, 10.0])))
    child(sun, "diffuse", text=exact(SUN_COLOUR))
    child(sun, "specular", text=exact(SUN_COLOUR))
    child(sun, "direction", text=exact(SUN_DIRECTION))


def _add_ground(parent: Any, model: LinkModel) -> None:
    height = next((j.pose[2, 3] for j in model.joints if j.child == FLOOR), FLOOR_Z)
    made = child(parent, "model", {"name": "ground_plane"})
    child(made, "static", text="true")
    add_pose(made, transform(np.eye(3), np.array([0.0, 0.0, height])))
    link = child(made, "link", {"name": "plane"})
    for tag in ("visual", "collision"):
        part = child(link, tag, {"name": tag})
        plane = child(child(part, "geometry"), "plane")
        child(plane, "normal", text=exact([0.0, 0.0, 1.0]))
        child(plane, "size", text=exact([20.0, 20.0]))
        if tag == "visual":
            child(child(part, "material"), "diffuse", text=exact(GREY))


def write_sdf(task: ExportTask, *, sdf_version: str = "1.9") -> tuple[str, ...]:
    """Fill a folder with a rig's SDF, and return warnings.

    Args:
        task: rig and folder
        sdf_version: one of `VERSIONS`

    Raises:
        UnknownNameError: another version
    """
    version = check_version(sdf_version)
    name = f"{model_name(task.model)}.world.sdf"
    files = {
        MODEL: sdf(task.model, version, task.meshes),
        name: world(task.model, version, task.meshes),
        "model.config": card(task.model, version, MODEL),
        "README.md": _readme(task, version, name).encode(),
    }
    for file, data in files.items():
        (task.folder / file).write_bytes(data)
    write_meshes(task.meshes, task.folder / "meshes")
    return (*left_out(task.rig), *_warnings(task.model, version))


def coupled(model: LinkModel) -> list[LinkJoint]:
    """Return the joints with a leader, except passive joints of loops."""
    return [joint for joint in model.joints if joint.follows and not joint.in_loop]


def _warnings(model: LinkModel, version: str) -> tuple[str, ...]:
    loose = [
        joint.name
        for joint in coupled(model)
        if version == "1.9" or (version == "1.7" and joint.kind == "prismatic")
    ]
    return (
        (
            f"SDF {version} cannot couple these joints, which move freely in Gazebo:"
            f" {', '.join(loose)} (see README.md; --sdf-version 1.11 couples them)",
        )
        if loose
        else ()
    )


def _readme(task: ExportTask, version: str, world_file: str) -> str:
    model = task.model
    loops = ", ".join(f"`{loop.name}_joint`" for loop in model.loops)
    rows: list[tuple[str, str]] = []
    for joint in coupled(model):
        leads = " + ".join(f"{ratio:g} * {name}_joint" for name, ratio in joint.follows)
        rows.append((f"{joint.name}_joint", leads))
    how = {
        "1.7": "Turning pairs are geared (`gearbox`); a slide that follows is free.",
        "1.9": "Drake couples them (`drake:mimic`, discrete plants); in Gazebo they are free.",
        "1.11": "Gazebo from Harmonic on couples them (`mimic`), with its bullet-featherstone.",
    }[version]
    table = markdown_table(("joint", "follows"), rows)
    body = filled(
        "sdf.md",
        model=MODEL,
        version=version,
        world=world_file,
        loops=filled("sdf_loops.md", names=loops) if loops else "",
        couplings=filled("sdf_couplings.md", rows=table, how=how) if rows else "",
        left_out="".join(f"\n- {text}." for text in left_out(task.rig)),
    )
    return readme(task, "sdf", body)


def read_sdf(path: Path, options: ReadOptions) -> SourceModel:
    """Read a model.

    Args:
        path: the file
        options: those of its meshes

    Raises:
        ImportFileError: not exactly one model, an unknown element, a missing file
        MissingExtraError: lxml or trimesh is not installed
    """
    node, version = _only_model(path)
    return _SdfModel(node, path, version, options).read()


def _only_model(path: Path) -> tuple[XmlNode, tuple[int, ...]]:
    """Return the model of a file, and the version of its format."""
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
    return models[0], tuple(int(number) for number in numbers.groups())


@dataclass(frozen=True, eq=False)
class _Place:
    """A pose in the file, relative to the frame `to`."""

    pose: Array
    to: str


class _SdfModel:
    """A model of a file, with the models inside it.

    Args:
        node: its element
        path: of its file
        version: of the file's format
        options: those of its meshes
        outer: the model that it is in, None of the outermost
        name: by which the outer model names it
    """

    def __init__(
        self,
        node: XmlNode,
        path: Path,
        version: tuple[int, ...],
        options: ReadOptions,
        outer: _SdfModel | None = None,
        name: str = "",
    ) -> None:
        self._node, self._path, self._version, self._options = node, path, version, options
        node.check((*MODEL_PARTS, *PASSED_OVER))
        self._finder = MeshFinder(path, options)
        self._notes: dict[str, None] = {}
        self._prefix = "" if outer is None else outer.named(name) + INSIDE
        if self._prefix.count(INSIDE) > DEEPEST:
            raise node.fail(f"lies in more than {DEEPEST} models")
        self._still = {
            joint.need("child").text()
            for joint in node.children("joint")
            if joint.attribute("type") == "fixed" and joint.need("parent").text() == WORLD
        }
        self._from_world = inverse(_own_pose(node)) if outer is None else outer._from_world
        self._places: dict[str, _Place] = {} if outer is None else outer._places
        self._inner = [
            *(self._included(one) for one in node.children("include")),
            *(self._nested(one) for one in node.children("model")),
        ]
        for link in node.children("link"):
            self._place(link, MODEL_FRAME)
        for joint in node.children("joint"):
            self._place(joint, joint.need("child").text())
        for frame in node.children("frame"):
            self._place(frame, frame.attribute("attached_to", "") or MODEL_FRAME)

    def named(self, name: str) -> str:
        """Return the name in the outermost model of what this one calls by a name."""
        return name if name == WORLD else self._prefix + name

    def _included(self, node: XmlNode) -> _SdfModel:
        """Return the model of an <include>: of a folder, by its model.config, or of a file."""
        node.check(INCLUDE_PARTS)
        if node.attribute("merge", "false") in ("1", "true"):
            raise node.fail("merges a model (merge), which is not supported")
        uri = node.need("uri")
        path = self._finder.model(uri, uri.text())
        model, version = _only_model(path)
        named = node.child("name")
        name = model.attribute("name") if named is None else named.text()
        pose = node if node.child("pose") is not None else model
        return self._with(pose, _SdfModel(model, path, version, self._options, self, name))

    def _nested(self, node: XmlNode) -> _SdfModel:
        name = node.attribute("name")
        inner = _SdfModel(node, self._path, self._version, self._options, self, name)
        return self._with(node, inner)

    def _with(self, posed: XmlNode, inner: _SdfModel) -> _SdfModel:
        """Place a model inside this one, which has its pose from an element, and return it."""
        pose = posed.child("pose")
        to = "" if pose is None else pose.attribute("relative_to", "")
        at = _Place(_own_pose(posed), self.named(to or MODEL_FRAME))
        self._places[inner.named(MODEL_FRAME)] = at
        return inner

    def _place(self, node: XmlNode, default: str) -> None:
        pose = node.child("pose")
        at = np.eye(4) if pose is None else _read_pose(pose)
        to = default if pose is None else (pose.attribute("relative_to", "") or default)
        name = self.named(node.attribute("name"))
        if name in self._places:
            raise node.fail(f"has the duplicate name {name!r}")
        self._places[name] = _Place(at, self.named(to))

    def at(self, name: str, node: XmlNode, seen: tuple[str, ...] = ()) -> Array:
        """Return the pose of a named link, joint, frame or model in the outermost model, (4, 4)."""
        if name == MODEL_FRAME:
            return np.eye(4)
        if name == WORLD:
            return self._from_world
        if name in seen:
            raise node.fail(f"poses of {', '.join(seen)} form a cycle")
        if name not in self._places and name + INSIDE + MODEL_FRAME in self._places:
            name = name + INSIDE + MODEL_FRAME  # a model stands for its frame
        if name not in self._places:
            raise node.fail(f"names {name!r}; known: {', '.join(self._places)}")
        place = self._places[name]
        return self.at(place.to, node, (*seen, name)) @ place.pose

    def read(self) -> SourceModel:
        """Return the model: a tree, and a closure for each further joint of a link."""
        file = str(self._path)
        parts = [*self._parts()]
        links = [link for part in parts for link in part.links()]
        pairs = [(part, node) for part in parts for node in part.joints()]
        if any(node.need("parent").text() == WORLD for _, node in pairs):
            links.insert(0, Link(WORLD))
        tree: list[SourceJoint] = []
        loops: list[LinkLoop] = []
        taken: set[str] = set()
        for part, node in pairs:
            joint = part.joint(node)
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
                LinkLoop(joint.name, joint.parent, sides[0][:3], joint.child, sides[1][:3])
            )
        try:
            ordered, joints = as_tree(file, links, tree)
        except ImportFileError as problem:
            raise self._node.fail(str(problem).partition(": ")[2]) from problem
        notes = [note for part in parts for note in part.notes()]
        name = self._node.attribute("name")
        return SourceModel(name, file, ordered, joints, tuple(loops), tuple(dict.fromkeys(notes)))

    def _parts(self) -> Iterator[_SdfModel]:
        """Yield this model and those inside it."""
        yield self
        for inner in self._inner:
            yield from inner._parts()

    def links(self) -> list[Link]:
        """Return its own links."""
        return [self._link(node) for node in self._node.children("link")]

    def joints(self) -> list[XmlNode]:
        """Return the elements of its own joints."""
        return self._node.children("joint")

    def notes(self) -> list[str]:
        """List the warnings of this file: ignored elements, files that were not found."""
        tags = sorted({n.tag for n in self._node.children() if n.tag in PASSED_OVER})
        passed = [f"{self._path}: <{tag}> is ignored" for tag in tags]
        return [*passed, *self._finder.notes, *self._notes]

    def _link(self, node: XmlNode) -> Link:
        node.check((*LINK_PARTS, *LINK_PASSED_OVER, "sensor", "light"))
        shapes: list[Shape] = []
        for visual in node.children("visual"):
            material = self._material(visual)
            if (geometry := self._finder.geometry(visual)) is not None:
                shapes += self._finder.visual(geometry, _own_pose(visual), material)
        for collision in node.children("collision"):
            if (geometry := self._finder.geometry(collision)) is not None:
                shapes += self._finder.collision(geometry, _own_pose(collision))
        link = Link(self.named(node.attribute("name")), shapes=tuple(shapes))
        inertial = node.child("inertial")
        if inertial is None:  # the format's default; none for an empty link fixed to the world
            nothing = not shapes and node.attribute("name") in self._still
            return link if nothing else replace(link, mass=1.0, inertia=np.eye(3))
        at, values = _own_pose(inertial), inertial.child("inertia")
        inertia = inertia_of(values, at[:3, :3], diagonal=1.0)
        return replace(link, mass=inertial.number("mass", 1.0), com=at[:3, 3], inertia=inertia)

    def _material(self, visual: XmlNode) -> str:
        """Return the name of a material in `descriptions.materials`, "" without a colour."""
        material = visual.child("material")
        if material is None:
            return ""
        script, pbr = material.child("script"), material.child("pbr")
        metal = None if pbr is None else pbr.child("metal") or pbr.child("specular")
        texture = None if metal is None else metal.child("albedo_map")
        if texture is not None and texture.text():
            return material_of(self._finder.colour(texture, texture.text()))
        name = None if script is None else script.child("name")
        if name is not None and name.text() in GAZEBO_COLOURS:
            return material_of(np.array(GAZEBO_COLOURS[name.text()]))
        colour = material.child("diffuse") or material.child("ambient")
        if colour is not None:
            return material_of(colour.numbers(4 if len(colour.text().split()) != 3 else 3))
        if name is not None:
            self._notes[f"{self._path}: the material {name.text()!r} is not known"] = None
        return ""

    def joint(self, node: XmlNode) -> SourceJoint:
        """Return a joint of the model."""
        kind, name = node.attribute("type"), self.named(node.attribute("name"))
        if kind not in KINDS:
            raise node.fail(f"got the type {kind!r}; allowed: {', '.join(KINDS)}")
        node.check(("pose", "parent", "child", "axis", "physics", "sensor"))
        parent, child = (self.named(node.need(end).text()) for end in ("parent", "child"))
        at_child, here = self.at(child, node), self.at(name, node)
        pose = inverse(self.at(parent, node)) @ at_child
        joint = SourceJoint(name, KINDS[kind], parent, child, pose)
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
            return self.at(self.named(named), axis)[:3, :3] @ along
        flag = axis.child("use_parent_model_frame")
        in_model = flag is not None and flag.text() in ("1", "true")
        own = self.at(self.named(MODEL_FRAME), axis) if in_model or self._version < (1, 5) else here
        return own[:3, :3] @ along


def _read_pose(node: XmlNode) -> Array:
    values = node.numbers(6)
    if node.attribute("degrees", "false") in ("1", "true"):
        values[3:] = np.radians(values[3:])
    return transform(matrix_from_rpy(*values[3:]), values[:3])


def _own_pose(node: XmlNode) -> Array:
    pose = node.child("pose")
    return np.eye(4) if pose is None else _read_pose(pose)


def _bound(value: float) -> float:
    return float(np.sign(value) * np.inf) if abs(value) > INFINITE else value


FORMAT = Format(
    title="SDF: Gazebo, Drake",
    order=20,
    options="""
        --sdf-version V = 1.9  sdf: format version, 1.7, 1.9 or 1.11
    """,
    suffixes=(".sdf",),
    root="sdf",
    write=write_sdf,
    read=read_sdf,
)
