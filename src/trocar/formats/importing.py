"""Import: robots and objects as arms and props, checked, and written whole or not at all."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.descriptions.inertial import apparent_inertias
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape
from trocar.descriptions.shapes import impossible
from trocar.descriptions.table import toml_text
from trocar.errors import InputError
from trocar.formats.format import formats
from trocar.formats.links import ImportFileError, Link, SourceModel, mesh_shape
from trocar.formats.mechanism import MechanismLayout, lay_out
from trocar.formats.meshes import DEFAULT_MATERIAL, ReadOptions, obj_text
from trocar.formats.pieces import OpenSurface, hull_of, solid_of
from trocar.formats.surfaces import SUFFIXES, UNITS, UP, read_surface
from trocar.formats.xml_tree import read_xml
from trocar.geometry.rotations import rpy_from_matrix
from trocar.inputs import is_file
from trocar.kinematics.mechanism import Frame
from trocar.outputs import check_folder, whole_folder

Array = NDArray[np.float64]
Kind = Literal["arm", "prop"]

#: Endings of files in any XML format; the root element decides.
ANY_XML = (".urdf", ".xacro", ".xml", ".mjcf")
#: Limits of the size of a part [m]. Source: our own choice: a cart is 2 m high, a needle's thread
#: 0.1 mm thick.
SMALLEST_M, LARGEST_M = 5e-4, 10.0
#: {kind: size [m] and mass [kg] above which a warning is given}. Source: our own choice: things
#: that lie under instruments, and the patient cart.
DOUBTFUL = {"prop": (1.0, 20.0), "arm": (4.0, 500.0)}
#: Ratio of an inertia to mass times the square of the farthest point's distance above which it is
#: replaced. Source: our own choice; no body exceeds 1, but drawings may lack parts of it.
LARGEST_INERTIA = 10.0
#: Density of a mesh whose mass is not given [kg/m^3]. Source: our own choice: hard plastic.
DENSITY = 1200.0
#: Natural frequency of the servos of an imported arm [rad/s]: gains P = I w^2, D = 2 I w.
#: Source: our own choice, slow enough for any arm at 1 ms.
SERVO_RATE = 30.0


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import.

    Attributes:
        name: name of the arm or prop; "": that of the file
        kind: None: an arm if it has moving joints, else a prop
        unit: unit of a mesh's numbers; "": the file's own, else metres
        mass: mass of a mesh [kg]; None: from DENSITY
        hull: colliding meshes become their convex hulls
        packages: folders of packages, for package:// and $(find)
        passive: joints that loops determine
        overwrite: replace existing files
        open_as: treatment of a mesh that is not closed
        up: up axis of meshes; "": the files' own, else z
        arguments: (name, value) of the arguments of a xacro file
    """

    name: str = ""
    kind: Kind | None = None
    unit: str = ""
    mass: float | None = None
    hull: bool = False
    packages: tuple[Path, ...] = ()
    passive: tuple[str, ...] = ()
    overwrite: bool = False
    open_as: OpenSurface = ""
    up: str = ""
    arguments: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Imported:
    """An imported arm or prop.

    Attributes:
        name, kind: those of the description
        file: the TOML file
        joints: names of its public joints
        links, triangles, pieces: numbers of links, visible triangles and colliding shapes
        mass: total [kg]
        size: of the box about its shapes where all coordinates are 0, (3,) [m]
        warnings: parts of the file that were changed or ignored
    """

    name: str
    kind: Kind
    file: str
    joints: tuple[str, ...]
    links: int
    triangles: int
    pieces: int
    mass: float
    size: tuple[float, float, float]
    warnings: tuple[str, ...]


def import_file(
    path: str | Path, folder: str | Path, options: ImportOptions | None = None
) -> Imported:
    """Convert a file to a folder with the TOML and the meshes of an arm or a prop.

    Args:
        path: URDF, SDF, MJCF, or a mesh (OBJ, STL, PLY, glTF, DAE)
        folder: a new folder, or an empty one
        options: see `ImportOptions`

    Raises:
        InputError: a file that cannot be used, a wrong unit, a folder that is not empty
        MissingExtraError: a library of the extras export or convex is not installed
    """
    chosen, source, target = options or ImportOptions(), Path(path), Path(folder)
    check_folder(target, chosen.overwrite)
    model = _read(source, chosen)
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", chosen.name or model.name).strip("_")
    if not name:
        got = chosen.name or model.name
        raise InputError(f"got the name {got!r}; allowed: letters, digits, _ and -")
    at = model.poses()
    corners = [_corners(shape, at[link.name]) for link in model.links for shape in link.shapes]
    size = np.ptp(np.concatenate(corners), axis=0) if corners else np.zeros(3)
    if corners:
        check_size(float(size.max()), str(source), robot=source.suffix.lower() not in SUFFIXES)
    head = {
        "name": name,
        "title": f"{model.name}, imported",
        "source": f"{source.name}, sha256 {sha256(source.read_bytes()).hexdigest()}",
    }
    kind: Kind = chosen.kind or ("arm" if model.moves else "prop")
    layout = lay_out(model, chosen.passive) if kind == "arm" else None
    warnings, joints = list(model.warnings), ()
    if layout is not None:
        warnings += layout.warnings
        joints = layout.mechanism.joint_names
        carrier = layout.carrier
        moving = {frame.name for frame in layout.mechanism.frames if frame.motion != "fixed"}
    else:
        if model.moves:
            warnings.append(f"{model.file}: imported as prop: joints are fixed at 0")
        carrier, moving = {link: ("prop", T) for link, T in at.items()}, set[str]()
    found = (_body(model, link, *carrier[link.name], moving, warnings) for link in model.links)
    bodies = [body for body in found if body is not None]
    shapes = [shape for body in bodies for shape in body.shapes]
    if layout is None and not shapes:
        raise ImportFileError(model.file, "has no shapes; allowed: a file with at least one shape")
    mass = float(sum(body.mass for body in bodies))
    warnings += _doubts(str(source), kind, size, mass)
    with whole_folder(target, chosen.overwrite) as built:
        _write(built, head, layout, bodies)
    return Imported(
        name,
        kind,
        str(target / f"{name}.toml"),
        joints,
        len(model.links),
        sum(len(s.mesh.faces) for s in shapes if s.mesh is not None and s.visible),
        sum(s.collide for s in shapes),
        mass,
        (float(size[0]), float(size[1]), float(size[2])),
        tuple(dict.fromkeys(warnings)),
    )


def check_size(extent: float, file: str, *, robot: bool = False) -> None:
    """Reject a size [m] outside of SMALLEST_M to LARGEST_M; robot files are in metres.

    Raises:
        InputError: the message names the units in which the size would be plausible
    """
    if SMALLEST_M <= extent <= LARGEST_M:
        return
    fits = [
        unit
        for unit, metres in (("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254), ("m (of mm)", 1e3))
        if SMALLEST_M <= extent * metres <= LARGEST_M
    ]
    way = 'scale="..." of its <mesh>' if robot else f"--unit {fits[0].split()[0]}" if fits else ""
    hint = f"; in {fits[0]} it would be plausible: {way}" if fits else ""
    raise InputError(
        f"{file}: got a size of {extent:.3g} m; allowed: {SMALLEST_M:g} to {LARGEST_M:g} m{hint}"
    )


def _doubts(file: str, kind: Kind, size: Array, mass: float) -> list[str]:
    """Return warnings of a size and a mass that are plausible for few things."""
    largest, heaviest = DOUBTFUL[kind]
    box = " x ".join(f"{edge:.3g}" for edge in size)
    found: list[str] = []
    if size.max() > largest:
        found.append(f"{file}: is {box} m large: check its unit")
    if mass > heaviest:
        found.append(f"{file}: weighs {mass:.4g} kg at {box} m: check its unit and mass")
    return found


def _read(path: Path, options: ImportOptions) -> SourceModel:
    if not is_file(path):
        raise ImportFileError(str(path), "no such file")
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        return _object(path, options)
    if options.up and options.up not in UP:
        raise InputError(f"got the up axis {options.up!r}; allowed: {', '.join(UP)}")
    meshes = ReadOptions(options.packages, options.hull, options.up, options.arguments)
    known = [(one, one.read) for one in formats().values() if one.read is not None]
    if suffix in ANY_XML:
        root = read_xml(path)
        readers = {one.root: read for one, read in known if one.root}
        if root.tag not in readers:
            allowed = ", ".join(f"<{tag}>" for tag in readers)
            raise root.fail(f"is not a robot; allowed: {allowed}")
        return readers[root.tag](path, meshes)
    readers = {ending: read for one, read in known for ending in one.suffixes}
    if suffix not in readers:
        allowed = ", ".join((*readers, *SUFFIXES))
        raise ImportFileError(str(path), f"unknown format {suffix!r}; allowed: {allowed}")
    return readers[suffix](path, meshes)


def _object(path: Path, options: ImportOptions) -> SourceModel:
    """Return a mesh as a model of one link."""
    if options.unit and options.unit not in UNITS:
        raise InputError(f"got the unit {options.unit!r}; allowed: {', '.join(UNITS)}")
    if options.up and options.up not in UP:
        raise InputError(f"got the up axis {options.up!r}; allowed: {', '.join(UP)}")
    surface = read_surface(path, options.unit, options.up)
    check_size(float(np.ptp(surface.whole.vertices, axis=0).max()), str(path))
    body = solid_of(surface, str(path), hull=options.hull, open_as=options.open_as)
    mass = DENSITY * body.volume if options.mass is None else options.mass
    if not 0.0 < mass < np.inf:
        raise InputError(f"got a mass of {mass:g} kg; allowed: above 0")
    shapes = [mesh_shape(np.eye(4), one, look or DEFAULT_MATERIAL) for look, one in surface.looks]
    for piece in body.convex:
        touched = mesh_shape(np.eye(4), piece, DEFAULT_MATERIAL)
        shapes.append(replace(touched, visible=False, collide=True))
    link = Link(
        path.stem, mass=mass, com=body.com, inertia=mass * body.gyration, shapes=tuple(shapes)
    )
    warnings = [*surface.notes, *(f"{path.name}: {note}" for note in body.notes)]
    if options.mass is None:
        warnings.append(f"{path.name}: mass from {DENSITY:g} kg/m^3: {mass:.4g} kg")
    return SourceModel(path.stem, str(path), (link,), (), (), tuple(warnings))


def _write(
    folder: Path,
    head: Mapping[str, Any],
    layout: MechanismLayout | None,
    bodies: Iterable[ImportedBody],
) -> None:
    """Write an arm, or a prop where there is no layout, and its meshes into a folder."""
    meshes: dict[str, Mesh] = {}
    rows = [_body_row(body, meshes) for body in bodies]
    for name, mesh in meshes.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(obj_text(mesh), encoding="utf-8")
    file = folder / f"{head['name']}.toml"
    document = {"schema": 1, **head} | ({} if layout is None else _arm_rows(layout))
    if layout is not None:
        # Gains for SERVO_RATE, from each motor's apparent inertia at home.
        bare = [{**row, "shape": None} for row in rows]  # without meshes to read
        file.write_text(toml_text(document | {"body": bare}), encoding="utf-8")
        arm = load_arm(file)
        felt = apparent_inertias(arm, arm.pose("home"))
        control = {
            "source": "our own choice: what closes each joint's loop in a tenth of a second;"
            " trocar tune makes better ones",
            "gravity_compensation": True,
            "pid": {
                joint.name: [float(inertia * SERVO_RATE**2), 0.0, float(2.0 * inertia * SERVO_RATE)]
                for joint, inertia in zip(arm.joints, felt, strict=True)
            },
        }
        document["control"] = {"dvrk": control}
    file.write_text(toml_text(document | {"body": rows}), encoding="utf-8")
    if layout is not None:
        load_arm(file)


#: Mass and radius of the ball that stands for a moving link without mass. Source: our own choice,
#: negligible.
NO_MASS_KG, NO_MASS_RADIUS_M = 1e-4, 0.01


@dataclass(frozen=True, eq=False)
class ImportedBody:
    """A link's mass and shapes in the frame that it moves with."""

    frame: str
    link: str
    mass: float
    com: Array
    inertia: Array
    shapes: tuple[Shape, ...]
    source: str


def _body(
    model: SourceModel,
    link: Link,
    frame: str,
    at: Array,
    moving: set[str],
    warnings: list[str],
) -> ImportedBody | None:
    """Return a link's body in the frame that carries it, None of an empty link.

    Args:
        model: the model that was read
        link: one of its links
        frame, at: the frame and T_frame_link, (4, 4)
        moving: frames with a moving joint, which need a mass
        warnings: list to which corrections are added
    """
    moves = frame in moving
    mass, source = link.mass, "the file"
    inertia, com = link.inertia, link.com
    if mass <= 0.0:
        if not moves and not link.shapes:
            return None
        mass, com = NO_MASS_KG, np.zeros(3)
        inertia = 0.4 * mass * NO_MASS_RADIUS_M**2 * np.eye(3)
        source = "placeholder: the file gives no mass"
        if moves:
            warnings.append(f"link {link.name}: movable link without mass; set to {mass:g} kg")
    problem = impossible(inertia) or _too_large(inertia, mass, com, link)
    if problem:
        inertia = mass * _gyration(link)
        source = f"mass: the file; its inertia is {problem}; that of a box about the shapes"
        warnings.append(f"link {link.name}: inertia is {problem}; replaced by the inertia of a box")
    turn = at[:3, :3]
    return ImportedBody(
        frame,
        link.name,
        mass,
        turn @ com + at[:3, 3],
        turn @ inertia @ turn.T,
        tuple(_placed(s, at, f"{model.file}: {link.name}") for s in link.shapes),
        source,
    )


def _too_large(inertia: Array, mass: float, com: Array, link: Link) -> str:
    """Return the problem of an inertia that no mass within a link's shapes has, "" without one."""
    if not link.shapes:
        return ""
    corners = np.concatenate([_corners(shape) for shape in link.shapes])
    reach = float(np.linalg.norm(corners - com, axis=1).max())
    largest = float(np.linalg.eigvalsh(inertia)[-1])
    if largest <= LARGEST_INERTIA * mass * reach**2:
        return ""
    return (
        f"no possible body: {largest:.3g} kg m^2, where {mass:.3g} kg within {reach:.3g} m have"
        f" {mass * reach**2:.3g} at most"
    )


def _placed(shape: Shape, at: Array, where: str) -> Shape:
    """Return a shape at T_frame_link; an invisible colliding mesh becomes its convex hull."""
    placed = replace(shape, pose=at @ shape.pose)
    if placed.mesh is not None and placed.collide and not placed.visible:
        return replace(placed, mesh=hull_of(placed.mesh, where))
    return placed


def _gyration(link: Link) -> Array:
    """Return the inertia of 1 kg of a box about a link's shapes, (3, 3) [m^2]."""
    reach = [_corners(s) for s in link.shapes] or [np.array([[-0.01] * 3, [0.01] * 3])]
    corners = np.concatenate(reach)
    a, b, c = np.maximum(np.ptp(corners, axis=0), 1e-3) / 2.0
    return np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 3.0


def _corners(shape: Shape, at: Array | None = None) -> Array:
    """Return corners about a shape in its link, or with T_root_link in the root, (k, 3) [m]."""
    if shape.mesh is not None:
        points = shape.mesh.vertices
    else:
        a, b, _ = shape.size
        half = shape.size if shape.kind == "box" else np.array([a, a, a + b])
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        points = signs * half
    pose = shape.pose if at is None else at @ shape.pose
    return points @ pose[:3, :3].T + pose[:3, 3]


def _arm_rows(layout: MechanismLayout) -> dict[str, Any]:
    """Return an arm's entries without its bodies."""
    mechanism = layout.mechanism
    joints: list[dict[str, Any]] = []
    for joint in mechanism.joints:
        unit = "rad" if joint.kind == "revolute" else "m"
        found = layout.sources[joint.name]
        row: dict[str, Any] = {"name": joint.name, "kind": joint.kind}
        row |= {f"lower_{unit}": joint.lower, f"upper_{unit}": joint.upper}
        if np.isfinite(found.effort):
            row["effort_max_nm" if unit == "rad" else "effort_max_n"] = found.effort
        if np.isfinite(found.velocity):
            row[f"velocity_max_{unit}_s"] = found.velocity
        joints.append({**row, "drive": dict(joint.drive)})
    closures = [
        {
            "name": closure.name,
            "frame_a": closure.frame_a,
            "point_a_m": closure.point_a,
            "frame_b": closure.frame_b,
            "point_b_m": closure.point_b,
            "passive": list(closure.passive),
        }
        for closure in mechanism.closures
    ]
    friction = _friction(layout)
    still = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    return {
        "type": "OTHER",
        "root": mechanism.reference,
        "relative_to": mechanism.reference,
        "tip": mechanism.tip,
        "joint": joints,
        "frame": [_frame_row(frame) for frame in mechanism.frames],
        "closure": closures or None,
        "friction": {"identified": {"source": "the file", **friction}} if friction else None,
        "pose": [{"name": "home", "q_rad_m": still}],
    }


def _frame_row(frame: Frame) -> dict[str, Any]:
    row: dict[str, Any] = {"name": frame.name}
    if frame.parent is not None:
        row["parent"] = frame.parent
    row |= _pose_row("xyz_m", frame.before)
    if frame.motion != "fixed":
        row |= {"motion": frame.motion, "q": dict(frame.couplings)}
    return row


def _pose_row(key: str, pose: Array) -> dict[str, Any]:
    row: dict[str, Any] = {}
    if pose[:3, 3].any():
        row[key] = pose[:3, 3]
    if not np.array_equal(pose[:3, :3], np.eye(3)):
        row["rotation"] = pose[:3, :3]
    return row


def _body_row(body: ImportedBody, meshes: dict[str, Mesh]) -> dict[str, Any]:
    i = body.inertia
    shapes = [_shape_row(shape, f"{body.link}_{k}", meshes) for k, shape in enumerate(body.shapes)]
    return {
        "frame": body.frame,
        "mass_kg": body.mass,
        "com_m": body.com,
        "inertia_kgm2": [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]],
        "source": body.source,
        "shape": shapes or None,
    }


def _shape_row(shape: Shape, name: str, meshes: dict[str, Mesh]) -> dict[str, Any]:
    row: dict[str, Any] = {"kind": shape.kind}
    turn, at = shape.pose[:3, :3], shape.pose[:3, 3]
    if shape.mesh is not None:
        file = f"meshes/{name}.obj"
        meshes[file] = shape.mesh
        row |= {"file": file, "center_m": at, **_turn(turn)}
    elif shape.kind == "box":
        row |= {"center_m": at, "size_m": 2.0 * shape.size, **_turn(turn)}
    elif shape.kind == "sphere":
        row |= {"center_m": at, "radius_m": float(shape.size[0])}
    else:
        along = float(shape.size[1]) * turn[:, 2]
        row |= {"from_m": at - along, "to_m": at + along, "radius_m": float(shape.size[0])}
    colour = shape.material.removeprefix("color_")
    looks = {"material": colour} if colour == shape.material else {"color": f"#{colour}"}
    row |= {**looks, "collide": shape.collide}
    if shape.friction is not None:
        row["friction"] = shape.friction
    return row if shape.visible else {**row, "visible": False}


def _turn(turn: Array) -> dict[str, Any]:
    return {} if np.array_equal(turn, np.eye(3)) else {"rpy_rad": rpy_from_matrix(turn)}


def _friction(layout: MechanismLayout) -> dict[str, Any]:
    """Return the friction of joints, {joint: entries}, of those with any."""
    rows: dict[str, Any] = {}
    for name, joint in layout.sources.items():
        turns = joint.kind == "revolute"
        row: dict[str, Any] = {}
        if joint.friction:
            row["coulomb_nm" if turns else "coulomb_n"] = joint.friction
        if joint.damping:
            row["viscous_nms" if turns else "viscous_ns_per_m"] = joint.damping
        if row:
            rows[name] = row
    return rows
