"""Foreign files as arms and props: read, judged, written whole or not at all."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.apps.folders import check_folder, whole_folder
from trocar.apps.foreign.bodies import ForeignBody, body_of, extent, with_hulls
from trocar.apps.foreign.layout import Layout, lay_out
from trocar.apps.foreign.mjcf import read_mjcf
from trocar.apps.foreign.records import (
    ForeignFileError,
    ForeignLink,
    ForeignModel,
    ForeignShape,
)
from trocar.apps.foreign.sdf import read_sdf
from trocar.apps.foreign.solids import given_mesh
from trocar.apps.foreign.surfaces import FORMATS, check_size, load_surface, solid_of
from trocar.apps.foreign.urdf import read_urdf
from trocar.apps.foreign.write import MeshStore, arm_text, obj_text, prop_text
from trocar.apps.foreign.xml_tree import read_xml
from trocar.descriptions import load_arm
from trocar.descriptions.inertial import apparent_inertias
from trocar.errors import InputError

Array = NDArray[np.float64]
Kind = Literal["arm", "prop"]

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
#: Density of a mesh whose mass is not given [kg/m^3]. Source: our own choice: hard plastic.
DENSITY = 1200.0
#: How fast the servos of an imported arm are [rad/s]: gains P = I w^2, D = 2 I w. Source: our own
#: choice, slow enough for any arm at 1 ms.
SERVO_RATE = 30.0


@dataclass(frozen=True)
class Order:
    """What the user wants.

    Attributes:
        name: of the arm or prop; the file's own when empty
        kind: arm, prop, or what the file looks like when None
        unit: of a mesh's numbers
        mass: of a mesh [kg]; from DENSITY when None
        hull: take the convex hull of a mesh
        packages: folders that hold what package:// names
        passive: joints that loops determine
        force: write over what is there
    """

    name: str = ""
    kind: Kind | None = None
    unit: str = "m"
    mass: float | None = None
    hull: bool = False
    packages: tuple[Path, ...] = ()
    passive: tuple[str, ...] = ()
    force: bool = False


@dataclass(frozen=True)
class Imported:
    """What came of it.

    Attributes:
        name, kind: what it is now
        file: the TOML file
        joints: its public joints
        links, triangles, pieces: how many links, triangles and colliding convex pieces
        mass: [kg]
        warnings: what was mended or passed over
    """

    name: str
    kind: Kind
    file: str
    joints: tuple[str, ...]
    links: int
    triangles: int
    pieces: int
    mass: float
    warnings: tuple[str, ...]


def bring_in(path: str | Path, folder: str | Path, order: Order | None = None) -> Imported:
    """Turn a foreign file into a folder with an arm's or a prop's TOML and meshes.

    Args:
        path: URDF, SDF, MJCF, or a mesh (OBJ, STL, PLY, glTF, DAE)
        folder: where it goes; made, and refused when it holds anything
        order: what the user wants

    Raises:
        InputError: a file that cannot be used, a wrong unit, a folder that is not empty
        MissingExtraError: a library of the extras export or convex is not installed
    """
    wanted, source = order or Order(), Path(path)
    target = Path(folder)
    check_folder(target.expanduser(), wanted.force)
    model = _read(source, wanted)
    name = _clean(wanted.name or model.name)
    kind: Kind = wanted.kind or ("arm" if model.moves else "prop")
    longest = _size(model)
    if longest:
        check_size(longest, str(source))
    head = {
        "name": name,
        "title": f"{model.name}, imported",
        "source": f"{source.name}, sha256 {sha256(source.read_bytes()).hexdigest()}",
    }
    with whole_folder(target, wanted.force) as built:
        return _write(with_hulls(model), name, kind, head, (built, target), wanted)


def _read(path: Path, order: Order) -> ForeignModel:
    if not path.is_file():
        raise ForeignFileError(str(path), "there is no such file")
    suffix = path.suffix.lower()
    if suffix in FORMATS:
        return _object(path, order)
    if suffix == ".sdf":
        return read_sdf(path, order.packages)
    if suffix in (".urdf", ".xml", ".mjcf"):
        root = read_xml(path)
        if root.tag == "robot":
            return read_urdf(path, order.packages)
        if root.tag == "sdf":
            return read_sdf(path, order.packages)
        if root.tag == "mujoco":
            return read_mjcf(path)
        raise root.fail("is no robot; allowed: <robot>, <sdf>, <mujoco>")
    allowed = ", ".join((".urdf", ".sdf", ".xml", ".mjcf", *FORMATS))
    raise ForeignFileError(str(path), f"unknown format {suffix!r}; allowed: {allowed}")


def _object(path: Path, order: Order) -> ForeignModel:
    """Return a mesh as a model of one link."""
    if order.unit not in UNITS:
        raise InputError(f"got the unit {order.unit!r}; allowed: {', '.join(UNITS)}")
    surface = load_surface(path, UNITS[order.unit])
    check_size(float(np.ptp(surface.vertices, axis=0).max()), str(path))
    solid = solid_of(surface, str(path), hull=order.hull)
    mass = DENSITY * solid.volume if order.mass is None else order.mass
    if not 0.0 < mass < np.inf:
        raise InputError(f"got a mass of {mass:g} kg; allowed: above 0")
    seen = ForeignShape(given_mesh(np.eye(4), solid.surface, "casting"), True, False)
    touched = [
        ForeignShape(given_mesh(np.eye(4), piece, "casting"), False, True) for piece in solid.convex
    ]
    inertia = mass * solid.gyration
    link = ForeignLink(path.stem, mass, solid.com, inertia, (seen, *touched))
    said = (
        () if order.mass is not None else (f"{path}: mass from {DENSITY:g} kg/m^3: {mass:.4g} kg",)
    )
    return ForeignModel(path.stem, str(path), (link,), (), (), said)


def _size(model: ForeignModel) -> float:
    at = {model.links[0].name: np.eye(4)}
    for joint in model.joints:
        at[joint.child] = at[joint.parent] @ joint.pose
    return extent((at[link.name], shape) for link in model.links for shape in link.shapes)


def _write(
    model: ForeignModel, name: str, kind: Kind, head: dict[str, Any],
    places: tuple[Path, Path], order: Order,
) -> Imported:  # fmt: skip
    warnings, store = list(model.warnings), MeshStore()
    joints: tuple[str, ...] = ()
    if kind == "arm":
        layout = lay_out(model, order.passive)
        warnings += layout.warnings
        moving = {f.name for f in layout.mechanism.frames if f.motion != "fixed"}
        bodies = _bodies(model, layout, moving, warnings)
        joints = layout.mechanism.joint_names
        text = arm_text(layout, bodies, head, store)
    else:
        if model.moves:
            warnings.append(f"{model.file}: a prop does not move: joints are held at 0")
        layout = None
        bodies = _still_bodies(model, warnings)
        text = prop_text(bodies, head, store)
    beside, target = places
    for file, mesh in store.files.items():
        (beside / file).parent.mkdir(exist_ok=True)
        (beside / file).write_text(obj_text(mesh), encoding="utf-8")
    file = beside / f"{name}.toml"
    file.write_text(text, encoding="utf-8")
    if kind == "arm" and layout is not None:
        file.write_text(arm_text(layout, bodies, head, store, _gains(file)), encoding="utf-8")
        load_arm(file)
    shapes = [shape for body in bodies for shape in body.shapes]
    return Imported(
        name,
        kind,
        str(target / f"{name}.toml"),
        joints,
        len(model.links),
        sum(len(s.shape.mesh.faces) for s in shapes if s.shape.mesh is not None and s.visible),
        sum(s.collide for s in shapes),
        float(sum(body.mass for body in bodies)),
        tuple(warnings),
    )


def _bodies(
    model: ForeignModel, layout: Layout, moving: set[str], warnings: list[str]
) -> list[ForeignBody]:
    found: list[ForeignBody] = []
    for link in model.links:
        frame, at = layout.carrier[link.name]
        body = body_of(link, frame, at, moves=frame in moving, warnings=warnings)
        if body is not None:
            found.append(body)
    return found


def _still_bodies(model: ForeignModel, warnings: list[str]) -> list[ForeignBody]:
    at = {model.links[0].name: np.eye(4)}
    for joint in model.joints:
        at[joint.child] = at[joint.parent] @ joint.pose
    found = [
        body_of(link, "prop", at[link.name], moves=False, warnings=warnings) for link in model.links
    ]
    bodies = [replace(body, frame="prop") for body in found if body is not None]
    if not any(body.shapes for body in bodies):
        raise ForeignFileError(model.file, "has no shapes, so there is nothing to place")
    return bodies


def _gains(file: Path) -> dict[str, tuple[float, float, float]]:
    """Return gains that give each joint the same speed, from what its motor feels at home."""
    arm = load_arm(file)
    felt = apparent_inertias(arm, arm.pose("home"))
    return {
        joint.name: (float(inertia * SERVO_RATE**2), 0.0, float(2.0 * inertia * SERVO_RATE))
        for joint, inertia in zip(arm.joints, felt, strict=True)
    }


def _clean(name: str) -> str:
    """Return a name that works as a file's and in TOML."""
    found = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_")
    if not found:
        raise InputError(f"got the name {name!r}; allowed: letters, digits, _ and -")
    return found
