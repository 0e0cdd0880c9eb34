"""URDF: a tree of links, in which passive joints mimic those with motors.

Source: the specification of URDF (wiki.ros.org/urdf/XML), and MuJoCo's extension of it.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from trocar import __version__
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.errors import InputError
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
    SHARE,
    SLACK,
    ImportFileError,
    Link,
    LinkJoint,
    LinkModel,
    SourceJoint,
    SourceModel,
    as_tree,
    helper_link,
    link_poses,
    material_of,
    without_capsule,
)
from trocar.formats.meshes import MeshFinder, ReadOptions, seen_materials
from trocar.formats.tip_chain import fit_tips
from trocar.formats.xacro import expand, is_xacro
from trocar.formats.xml_tree import (
    XmlNode,
    child,
    document,
    element,
    inertia_of,
    moving_joint,
    number,
    numbers,
    read_xml,
)
from trocar.geometry.rotations import matrix_from_rpy, rpy_from_matrix
from trocar.geometry.se3 import transform
from trocar.modeling.geoms import capsule_about

Array = NDArray[np.float64]

#: Limit of a joint without one, as URDF requires a number [N m, N, rad/s, m/s]. Source: our own
#: choice, beyond every limit of the catalogue.
UNLIMITED = 1000.0
#: Separator of the leader's name, which comes first, and the joint's own.
BEHIND = "_and_"
#: Package names that are valid in ROS 1 and ROS 2. Source: REP 144, "Naming Rules".
PACKAGE_NAME = re.compile(r"[a-z][a-z0-9_]+")
#: Ratio of the camera's distance to the largest extent of the links' origins. Source: by eye.
DISTANCE = 1.7
DESCRIPTION_TOPIC = """Description Source: Topic
      Description Topic:
        Durability Policy: Transient Local
        Reliability Policy: Reliable
        Value: /robot_description"""

PACKAGE_FILES = """
| `package.xml`, `CMakeLists.txt` | a ROS package, for ROS 1 (catkin) and ROS 2 (ament) |"""
#: Elements of other programs, which are ignored with a warning.
PASSED_OVER = (
    "gazebo", "transmission", "mujoco", "drake", "ros2_control", "sensor", "self_collide",
    "self_collision_checking", "audio_source",
)  # fmt: skip
#: Elements of Bullet's <contact>, of which the first is read. Source: Bullet's UrdfParser.cpp.
CONTACT = (
    "lateral_friction", "rolling_friction", "spinning_friction", "restitution", "contact_cfm",
    "contact_erp", "stiffness", "damping", "friction_anchor", "inertia_scaling",
)  # fmt: skip


def urdf_tree(model: LinkModel) -> LinkModel:
    """Return a model in which joints have one leader at most and are sorted behind it by name.

    Source: measured with pinocchio 4.1.0, which reads `mimic` only of joints before it in the order
    of urdfdom: by name.
    """
    return leaders_first(single_leaders(model))


def urdf(
    model: LinkModel, meshes: Mapping[Mesh, str] | None = None, *, friction: bool = True
) -> bytes:
    """Return the URDF of a rig.

    Args:
        model: the rig
        meshes: {mesh: its file}, such as "meshes/PSM1_yaw.obj" or
            "package://davinci/meshes/PSM1_yaw.obj"
        friction: write dry friction, which Drake ignores with a warning
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
        robot.append(_link_element(link, places))
        if link.name in joints:
            robot.append(_joint_element(joints[link.name], friction))
    return document(robot, model.title)


def _for_mujoco(places: Iterable[str]) -> Any:
    """Return MuJoCo's own element, ignored by others: keep every link and every shape."""
    named = next((place for place in places if "://" in place), "")
    found = {"strippath": "true", "meshdir": "meshes"} if named else {"strippath": "false"}
    mujoco = element("mujoco")
    kept = dict.fromkeys(("fusestatic", "discardvisual", "inertiafromgeom"), "false")
    child(mujoco, "compiler", {**found, **kept})
    return mujoco


def _link_element(link: Link, places: Mapping[Mesh, str]) -> Any:
    made = element("link", {"name": link.name})
    if link.mass > 0.0:
        inertial = child(made, "inertial")
        child(inertial, "origin", {"xyz": numbers(link.com), "rpy": "0 0 0"})
        child(inertial, "mass", {"value": number(link.mass)})
        child(inertial, "inertia", _inertia_of(link.inertia))
    for shape in link.shapes:
        if shape.visible:
            for part in without_capsule(shape):
                visual = _add_shape(made, "visual", part, places)
                child(visual, "material", {"name": shape.material})
    for shape in link.shapes:
        if shape.collide:
            for part in without_capsule(capsule_about(shape) if shape.hull == "capsule" else shape):
                _add_shape(made, "collision", part, places)
    return made


def _inertia_of(inertia: Array) -> dict[str, str]:
    noise = 1e-15 * float(np.trace(inertia))
    pairs = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2),
             "izz": (2, 2)}  # fmt: skip
    return {key: numbers([inertia[at]], noise=noise) for key, at in pairs.items()}


def _add_shape(link: Any, tag: str, shape: Shape, places: Mapping[Mesh, str]) -> Any:
    made = child(link, tag)
    child(made, "origin", _origin_of(shape.pose))
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


def _origin_of(pose: Array) -> dict[str, str]:
    return {"xyz": numbers(pose[:3, 3]), "rpy": numbers(rpy_from_matrix(pose[:3, :3]))}


def _joint_element(joint: LinkJoint, friction: bool) -> Any:
    made = element("joint", {"name": joint.name, "type": joint.kind})
    child(made, "origin", _origin_of(joint.pose))
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
    """Return a model whose joints have one leader at most.

    A joint with two leaders becomes two joints about the same axis, one behind the other, each with
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
    """Return a model in which each joint comes after its leader when joints are sorted by name.

    Some readers sort the joints of a link by name, go down each branch, and require leaders before
    followers. A joint whose branch comes too early gets the name of the branch that must come first
    in front of its own. Independent joints keep their names, so a model in which two of them wait
    for one another stays as it is.
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
    """Yield (old, new) names of joints that come too early, at most one per parent link."""
    for joints in _branches(model).values():
        for joint in sorted(joints, key=lambda joint: joint.name):
            later = [other.name for other in joints if other.name > joint.name
                     and _waits_for(model, joint, other)]  # fmt: skip
            if later and (joint.follows or joint.kind == "fixed"):
                yield joint.name, f"{max(later)}{BEHIND}{joint.name.split(BEHIND)[-1]}"
                break


def late_leaders(model: LinkModel) -> tuple[tuple[str, str], ...]:
    """Return (follower, leader) of each joint that comes before its leader, sorted by name."""
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
    """Return the joints of each parent link."""
    found: dict[str, list[LinkJoint]] = defaultdict(list)
    for joint in model.joints:
        found[joint.parent].append(joint)
    return found


def _waits_for(model: LinkModel, joint: LinkJoint, other: LinkJoint) -> bool:
    """Return whether `joint`, or one behind it, follows `other`, or one behind that."""
    mine, theirs = _behind(model, joint), {j.name for j in _behind(model, other)}
    return any(name in theirs for j in mine for name, _ in j.follows)


def _behind(model: LinkModel, root: LinkJoint) -> list[LinkJoint]:
    found, reached = [root], {root.child}
    for joint in model.joints:  # parents come before children
        if joint.parent in reached:
            found.append(joint)
            reached.add(joint.child)
    return found


def write_urdf(task: ExportTask, *, package: str = "", fit_tip: bool = False) -> tuple[str, ...]:
    """Fill a folder with a rig's URDF, and return warnings.

    Args:
        task: rig and folder
        package: name of the ROS package that the folder becomes; "" for relative paths
        fit_tip: fit the chain of a calibrated arm to its tip

    Raises:
        InputError: invalid name of a ROS package
    """
    name = file_name(task.model.name)
    if package and not PACKAGE_NAME.fullmatch(package):
        raise InputError(
            f"--package: got {package!r}; allowed: a lower-case letter, then lower-case letters,"
            " digits and underscores (REP 144)"
        )
    if fit_tip:
        task = replace(task, model=fit_tips(task.model, task.rig))
    prefix = f"package://{package}/meshes" if package else "meshes"
    places = {mesh: f"{prefix}/{stem}.obj" for mesh, stem in task.meshes.items()}
    write_meshes(task.meshes, task.folder / "meshes", seen_materials(task.model))
    _write(task.folder / f"{name}.urdf", urdf(task.model, places))
    _write(task.folder / f"{name}_drake.urdf", urdf(task.model, places, friction=False))
    _write(task.folder / "rviz" / "trocar.rviz", rviz_config(task.model, 1).encode())
    _write(task.folder / "rviz" / "trocar_ros2.rviz", rviz_config(task.model, 2).encode())
    _write(task.folder / "rviz" / "start.yaml", start_message(task.model).encode())
    if package:
        # Source: REP 149 (format 3), and the documentation of catkin and ament_cmake.
        title = escape(task.model.title)
        manifest = filled("package.xml", package=package, version=__version__, title=title)
        _write(task.folder / "package.xml", manifest.encode())
        _write(task.folder / "CMakeLists.txt", filled("CMakeLists.txt", package=package).encode())
    warnings = _warnings(task, fit_tip)
    _write(task.folder / "README.md", _readme(task, name, package, warnings).encode())
    return warnings


def file_name(name: str) -> str:
    """Return the name of a rig's file: letters, digits, - and _."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_") or "robot"


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)


def _warnings(task: ExportTask, fitted: bool) -> tuple[str, ...]:
    found = list(left_out(task.rig))
    how = "helper joints fit the chain to the tip" if fitted else "passive joints mimic linearly"
    found += [
        f"{arm}: its loops are not parallelograms, and no tree moves as they do: {how}; off by up"
        f" to {1e3 * error.tip:.3f} mm and {1e3 * error.tip_angle:.2f} mrad at the tip,"
        f" {1e3 * error.worst:.3f} mm at {error.frame}"
        + ("" if fitted else " (--fit-tip fits the chain to the tip)")
        for arm, error in task.model.line_errors.items()
    ]
    if fitted and not task.model.line_errors:
        found.append("--fit-tip: nothing to fit, for all loops are parallelograms")
    found += [
        f"{follower} mimics {leader}, later in alphabetical order: pinocchio rejects this"
        for follower, leader in late_leaders(urdf_tree(task.model))
    ]
    return tuple(found)


def _readme(task: ExportTask, name: str, package: str, warnings: tuple[str, ...]) -> str:
    joints = [
        (joint.arm, joint.hinge.joint.name, f"`{joint.name}`", f"{joint.hinge.weight:g}")
        for joint in task.model.joints
        if joint.hinge is not None and joint.hinge.joint is not None
    ]
    body = filled(
        "urdf.md",
        name=name,
        package_files=PACKAGE_FILES if package else "",
        package_dirs="[Path.cwd().parent]" if package else '["."]',
        drake=f'parser.package_map().Add("{package}", ".")\n' if package else "",
        rviz=filled("rviz.md", name=name).strip()
        if package
        else "RViz finds meshes in ROS packages only: export with `--package NAME`.",
        joints=markdown_table(("arm", "joint", "is the URDF's", "times"), joints),
        warnings="".join(f"\n- {text}" for text in warnings)
        and "\n## Warnings\n" + "".join(f"\n- {text}" for text in warnings),
    )
    return readme(task, "urdf", body)


def rviz_config(model: LinkModel, ros: int) -> str:
    """Return a view of a rig for RViz.

    Source: a file saved by RViz 1.14 (ROS 1), reduced; rviz_default_plugins for names in ROS 2.

    Args:
        model: the rig
        ros: version of ROS, 1 or 2, which have different names of classes
    """
    places = link_poses(model, model.start)
    at = np.array([places[link.name][:3, 3] for link in model.links if link.arm])
    low, high = at.min(axis=0), at.max(axis=0)
    x, y, z = 0.5 * (low + high)
    plugin = "rviz" if ros == 1 else "rviz_default_plugins"
    source = "Robot Description: robot_description" if ros == 1 else DESCRIPTION_TOPIC
    return filled(
        "view.rviz",
        panel="rviz" if ros == 1 else "rviz_common",
        plugin=plugin,
        source=source,
        floor=f"{min(pose[2, 3] for pose in places.values()):.4g}",
        x=f"{x:.4g}",
        y=f"{y:.4g}",
        z=f"{z:.4g}",
        distance=f"{DISTANCE * float((high - low).max()) + 0.3:.4g}",
    )


def start_message(model: LinkModel) -> str:
    """Return a sensor_msgs/JointState of the pose "start", in YAML."""
    tree = urdf_tree(model)
    own = [joint.name for joint in tree.joints if joint.kind != "fixed" and not joint.follows]
    values = ", ".join(f"{tree.start[name] + 0.0:.6g}" for name in own)
    names = ", ".join(own)
    return f"header: auto\nname: [{names}]\nposition: [{values}]\nvelocity: []\neffort: []\n"


def read_urdf(path: Path, options: ReadOptions) -> SourceModel:
    """Read a robot, in ROS's dialect, with xacro or without, or in Bullet's.

    Args:
        path: the file
        options: those of its meshes; folders above the file are searched for packages, too

    Raises:
        ImportFileError: not a tree, a misspelled element, a missing file
        MissingExtraError: lxml or trimesh is not installed
    """
    root = read_xml(path)
    if is_xacro(root):
        root = expand(root, path, options.packages, dict(options.arguments))
    finder = MeshFinder(path, options)
    finder.note(root.unknown(("link", "joint", "material", *PASSED_OVER)))
    materials = {m.attribute("name"): _read_material(m, finder) for m in root.children("material")}
    links = [_read_link(node, materials, finder) for node in root.children("link")]
    if not links:
        raise root.fail("has no links; allowed: a robot (a xacro file of macros alone is included)")
    joints = [_read_joint(node, finder) for node in root.children("joint")]
    tree, order = as_tree(str(path), links, joints)
    _check_mimics(str(path), order)
    ends = [root, *root.children("link")]
    passed = {n.tag: "" for end in ends for n in end.children() if n.tag in PASSED_OVER}
    for contact in (c for link in ends[1:] for c in link.children("contact")):
        passed |= {n.tag: " of <contact>" for n in contact.children() if n.tag != CONTACT[0]}
    warnings = [f"{path}: <{tag}>{of} is ignored" for tag, of in sorted(passed.items())]
    name = root.attribute("name")
    return SourceModel(name, str(path), tree, order, (), (*warnings, *finder.notes))


def _read_material(node: XmlNode, finder: MeshFinder) -> str:
    """Return the name of a material in `descriptions.materials`, "" of a reference by name."""
    node.check(("color", "texture", "specular", "ambient"))
    colour, texture = node.child("color"), node.child("texture")
    if texture is not None and texture.attribute("filename", ""):
        return material_of(finder.colour(texture, texture.attribute("filename")))
    if colour is None:
        return ""
    rgba = colour.attribute("rgba")
    return material_of(colour.numbers(4 if len(rgba.split()) != 3 else 3, rgba))


def _read_link(node: XmlNode, materials: dict[str, str], finder: MeshFinder) -> Link:
    finder.note(node.unknown(("inertial", "visual", "collision", "contact", *PASSED_OVER)))
    shapes: list[Shape] = []
    for visual in node.children("visual"):
        finder.note(visual.unknown(("origin", "geometry", "material")))
        looks = visual.child("material")
        material = ""
        if looks is not None:
            name = looks.attribute("name", "")
            material = _read_material(looks, finder) or (materials.get(name, "") if name else "")
            materials[name] = material
        if (geometry := finder.geometry(visual)) is not None:
            shapes += finder.visual(geometry, _read_origin(visual), material)
    contact, friction = node.child("contact"), None
    if contact is not None:
        contact.check(CONTACT)
        lateral = contact.child(CONTACT[0])
        friction = None if lateral is None else lateral.number("value")
    for collision in node.children("collision"):
        finder.note(collision.unknown(("origin", "geometry", "verbose", "material")))
        if (geometry := finder.geometry(collision)) is not None:
            touched = finder.collision(geometry, _read_origin(collision))
            shapes += [replace(shape, friction=friction) for shape in touched]
    inertial = node.child("inertial")
    link = Link(node.attribute("name"), shapes=tuple(shapes))
    if inertial is None:
        return link
    inertial.check(("origin", "mass", "inertia"))
    at, mass = _read_origin(inertial), inertial.need("mass").number("value")
    inertia = inertia_of(inertial.need("inertia"), at[:3, :3])
    return replace(link, mass=mass, com=at[:3, 3], inertia=inertia)


def _read_origin(node: XmlNode) -> Array:
    origin = node.child("origin")
    if origin is None:
        return np.eye(4)
    turn = matrix_from_rpy(*origin.figures("rpy", 3, (0, 0, 0)))
    return transform(turn, origin.figures("xyz", 3, (0, 0, 0)))


def _read_joint(node: XmlNode, finder: MeshFinder) -> SourceJoint:
    known = ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic")
    finder.note(node.unknown((*known, "calibration", "safety_controller", "joint_properties")))
    kind = node.attribute("type")
    if kind not in KINDS:
        raise node.fail(f"got the type {kind!r}; allowed: {', '.join(KINDS)}")
    joint = SourceJoint(
        node.attribute("name"),
        KINDS[kind],
        node.need("parent").attribute("link"),
        node.need("child").attribute("link"),
        _read_origin(node),
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
        if limits[0] > limits[1]:
            low, high = limits
            limits = -np.inf, np.inf
            note = f"joint {joint.name}: limits {low:g} to {high:g} mean none, as in Bullet"
            finder.note([note])
    elif kind != "continuous":
        raise node.fail("lacks <limit>, required for a revolute or prismatic joint")
    return moving_joint(joint, node, along, limits)


def _check_mimics(file: str, joints: tuple[SourceJoint, ...]) -> None:
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


FORMAT = Format(
    title="URDF: ROS, RViz, pinocchio, Drake, MuJoCo, yourdfpy",
    order=10,
    options="""
        --package NAME  urdf: write a ROS package NAME
        --fit-tip       urdf of a calibrated arm: add helper joints that fit the chain to its tip
    """,
    suffixes=(".urdf", ".xacro"),
    root="robot",
    write=write_urdf,
    read=read_urdf,
)
