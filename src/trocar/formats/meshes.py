"""Meshes: written, read, checked, and decomposed into convex pieces.

Reading and mass properties are trimesh's, the convex decomposition is CoACD's (Wei et al. 2022,
"Approximate convex decomposition for 3D meshes with collision-aware concavity and tree search").
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import MOST_BYTES, MOST_TRIANGLES, Mesh, lfs_problem, welded
from trocar.descriptions.records import Shape
from trocar.errors import InputError, MissingExtraError
from trocar.formats.links import ImportFileError, LinkModel, mesh_shape, solid
from trocar.formats.xml_tree import XmlNode
from trocar.inputs import is_file

Array = NDArray[np.float64]

MATERIAL_FILE = "materials.mtl"
#: Endings of the files that are read.
SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".gltf", ".dae")
#: Smallest ratio of volume to hull volume of a body that counts as convex. Source: our own choice.
NEARLY_CONVEX = 0.98
#: Concavity that CoACD leaves, as a ratio to the size, and its largest number of pieces.
#: Source: its authors' default; our own choice, of what a physics step affords.
DENT, MOST_PIECES = 0.05, 32
#: Largest number of corners of a convex piece, which bounds the cost of a contact. Source: our own
#: choice.
MOST_CORNERS = 32
#: Limits of the size of a part [m]. Source: our own choice: a cart is 2 m high, a needle's thread
#: 0.1 mm thick.
SMALLEST_M, LARGEST_M = 5e-4, 10.0


def mesh_names(model: LinkModel) -> dict[Mesh, str]:
    """Return a name for each visible or colliding mesh of a model; equal meshes share theirs."""
    found: dict[Mesh, str] = {}
    owners: dict[str, Mesh] = {}
    for link in model.links:
        for shape in link.shapes:
            used = shape.visible or shape.collide
            if shape.mesh is None or shape.mesh in found or not used:
                continue
            stem = shape.mesh.name or link.name
            name, k = stem, 1
            while name in owners and not _alike(owners[name], shape.mesh):
                k += 1
                name = f"{stem}_{k}"
            owners.setdefault(name, shape.mesh)
            found[shape.mesh] = name
    return found


def _alike(one: Mesh, other: Mesh) -> bool:
    same = np.array_equal(one.vertices, other.vertices)
    return same and np.array_equal(one.faces, other.faces)


def seen_materials(model: LinkModel) -> dict[Mesh, str]:
    """Return the materials of visible meshes: rows of `descriptions.materials`."""
    shapes = [s for link in model.links for s in link.shapes if s.visible]
    return {s.mesh: s.material for s in reversed(shapes) if s.mesh is not None}


def mesh_files(
    meshes: Mapping[Mesh, str], materials: Mapping[Mesh, str] | None = None
) -> dict[str, bytes]:
    """Return each mesh as a file NAME.obj, in metres: {name of the file: content}.

    Args:
        meshes: {mesh: its name}
        materials: {mesh: a row of `descriptions.materials`}, written into a file beside the meshes
            for programs that read colours from there only
    """
    made_of = dict(materials or {})
    files = {MATERIAL_FILE: mtl(sorted(set(made_of.values())))} if meshes and made_of else {}
    return files | {
        f"{name}.obj": obj(mesh, made_of.get(mesh, "")) for mesh, name in meshes.items()
    }


def obj(mesh: Mesh, material: str = "") -> bytes:
    """Return a mesh as a Wavefront OBJ file, in metres: corners to a nanometre, and normals."""
    lines = [f"mtllib {MATERIAL_FILE}\n"] if material else []
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in np.round(mesh.vertices, 9) + 0.0]
    if mesh.normals is not None:
        normals = np.round(mesh.normals, 4) + 0.0
        lines += [f"vn {x:.4g} {y:.4g} {z:.4g}\n" for x, y, z in normals]
    lines += [f"usemtl {material}\n"] if material else []
    corner = "{0}" if mesh.normals is None else "{0}//{0}"
    face = f"f {corner} {corner.replace('0', '1')} {corner.replace('0', '2')}\n"
    return "".join([*lines, *(face.format(a, b, c) for a, b, c in mesh.faces + 1)]).encode()


def mtl(materials: Iterable[str]) -> bytes:
    """Return the colours of materials as a Wavefront MTL file; ambient is half of diffuse."""
    text = ""
    for name in materials:
        found = MATERIALS[name]
        red, green, blue, opaque = found.rgba
        shine = f" {found.gloss / 2:.4g}"
        text += (
            f"newmtl {name}\nKa {red / 2:.4g} {green / 2:.4g} {blue / 2:.4g}\n"
            f"Kd {red:.4g} {green:.4g} {blue:.4g}\nKs{3 * shine}\n"
            f"Ns {10 + 90 * found.gloss:.4g}\nd {opaque:.4g}\nillum 2\n"
        )
    return text.encode()


def obj_text(mesh: Mesh) -> str:
    """Return a mesh as OBJ in millimetres, in full precision."""
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in (1e3 * mesh.vertices).tolist())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
    return f"# millimetres\n{corners}{faces}"


@dataclass(frozen=True, eq=False)
class MeshSolid:
    """A body of triangles.

    Attributes:
        surface: visible triangles
        volume: [m^3]
        com: centre of its volume (3,) [m]
        gyration: inertia of 1 kg about that centre, (3, 3) [m^2]
        convex: convex pieces that fill it
    """

    surface: Mesh
    volume: float
    com: Array
    gyration: Array
    convex: tuple[Mesh, ...]


def load_surface(path: Path, scale: Array | float = 1.0) -> Mesh:
    """Return the triangles of a file, times `scale` (a number, or (3,), one per axis) [m].

    Corners at the same place are merged, as by `read_mesh`: STL repeats each six times.

    Raises:
        ImportFileError: no such file, an unknown format, no triangles, too many
        MissingExtraError: trimesh is not installed
    """
    trimesh = _trimesh()
    if path.suffix.lower() not in SUFFIXES:
        raise ImportFileError(str(path), f"unknown format; allowed: {', '.join(SUFFIXES)}")
    if not is_file(path):
        raise ImportFileError(str(path), "no such file")
    if path.stat().st_size > MOST_BYTES:
        raise ImportFileError(str(path), f"is larger than {1e-6 * MOST_BYTES:g} MB")
    with path.open("rb") as file:
        problem = lfs_problem(file.read(1024))
    if problem:
        raise ImportFileError(str(path), problem)
    log = logging.getLogger("trimesh")
    before = log.level
    log.setLevel(logging.CRITICAL)  # of facets without normals it logs a traceback
    try:
        found = trimesh.load(path, force="mesh", process=False)
    except Exception as problem:  # trimesh's readers raise whatever they meet
        raise ImportFileError(str(path), f"cannot be read: {problem}") from problem
    finally:
        log.setLevel(before)
    faces = np.asarray(getattr(found, "faces", []), dtype=np.int64).reshape(-1, 3)
    if not 0 < len(faces) <= MOST_TRIANGLES:
        raise ImportFileError(
            str(path), f"has {len(faces)} triangles; allowed: 1 to {MOST_TRIANGLES}"
        )
    vertices = np.asarray(found.vertices, dtype=np.float64) * scale
    if not np.isfinite(vertices).all():
        raise ImportFileError(str(path), "has coordinates that are not finite")
    return Mesh(*welded(vertices, faces))


def solid_of(surface: Mesh, file: str, *, hull: bool = False) -> MeshSolid:
    """Return a surface as a body.

    Args:
        surface: closed triangles [m]
        file: their file, for messages
        hull: return the convex hull instead of convex pieces

    Raises:
        InputError: not watertight, no volume
        MissingExtraError: trimesh or coacd is not installed
    """
    trimesh = _trimesh()
    body = trimesh.Trimesh(surface.vertices, surface.faces, process=True)
    body.merge_vertices(merge_norm=True, merge_tex=True)
    if hull:
        body = _hull(body, file)
    offer = "; --hull takes the convex hull instead"
    if not body.is_watertight:
        edges = np.sort(body.edges, axis=1)
        _, count = np.unique(edges, axis=0, return_counts=True)
        raise InputError(
            f"{file}: is not watertight: {int((count != 2).sum())} edges do not have two triangles"
            f" each{offer}"
        )
    body.fix_normals()
    extents: Array = np.maximum(body.extents, 1e-9)
    if not body.volume > 1e-6 * float(np.prod(extents)):
        raise InputError(f"{file}: has no volume (got {body.volume:.3g} m^3){offer}")
    properties = body.mass_properties
    gyration = np.asarray(properties["inertia"]) / properties["mass"]
    whole = _hull(body, file)
    if hull or body.volume >= NEARLY_CONVEX * whole.volume:
        convex = (_mesh(whole),)
    else:
        convex = _decomposed(body)
    shown = _mesh(body) if hull else surface
    return MeshSolid(shown, float(body.volume), np.asarray(body.center_mass), gyration, convex)


def hull_of(surface: Mesh, file: str) -> Mesh:
    """Return the convex hull of a surface, which need not be closed."""
    trimesh = _trimesh()
    return _mesh(_hull(trimesh.Trimesh(surface.vertices, surface.faces, process=False), file))


def check_size(extent: float, file: str) -> None:
    """Reject a size [m] outside of SMALLEST_M to LARGEST_M.

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
    hint = f"; in {fits[0]} it would be plausible: --unit {fits[0].split()[0]}" if fits else ""
    raise InputError(
        f"{file}: got a size of {extent:.3g} m; allowed: {SMALLEST_M:g} to {LARGEST_M:g} m{hint}"
    )


def _hull(body: Any, file: str) -> Any:
    try:
        found = body.convex_hull
    except Exception as problem:  # Qhull's errors are its own
        raise InputError(f"{file}: is planar or linear: the convex hull has no volume") from problem
    if not found.volume > 0.0:
        raise InputError(f"{file}: is planar or linear: the convex hull has no volume")
    return found


def _decomposed(body: Any) -> tuple[Mesh, ...]:
    try:
        import coacd  # pyright: ignore[reportMissingTypeStubs] - it has no types
    except ImportError as problem:
        raise MissingExtraError("coacd", "convex", "mesh decomposition") from problem
    library: Any = coacd
    library.set_log_level("error")
    parts = library.run_coacd(
        library.Mesh(np.asarray(body.vertices), np.asarray(body.faces)),
        threshold=DENT,
        max_convex_hull=MOST_PIECES,
        max_ch_vertex=MOST_CORNERS,
        decimate=True,
        seed=0,
    )
    return tuple(
        Mesh(np.asarray(v, dtype=np.float64), np.asarray(f, dtype=np.int64)) for v, f in parts
    )


def _mesh(body: Any) -> Mesh:
    return Mesh(np.array(body.vertices, dtype=np.float64), np.array(body.faces, dtype=np.int64))


def _trimesh() -> Any:
    try:
        import trimesh
    except ImportError as problem:
        raise MissingExtraError("trimesh", "convex", "reading meshes") from problem
    return trimesh


class MeshFinder:
    """Shapes of a robot's file; each mesh that it names is read once."""

    def __init__(self, path: Path, packages: tuple[Path, ...]) -> None:
        self._folder = path.resolve().parent
        self._packages = packages
        #: {file and scale: its triangles}: a link is often seen and touched as the same mesh.
        self._read: dict[tuple[Path, tuple[float, ...]], Mesh] = {}

    def find(self, node: XmlNode, uri: str) -> Path:
        """Return the file of a URI or relative path.

        Raises:
            ImportFileError: no such file; the message names the places searched
        """
        scheme, mark, rest = uri.partition("://")
        if not mark:
            places = [self._folder / uri]
        elif scheme == "file":
            places = [Path(rest)]
        elif scheme in ("package", "model"):
            name, _, inside = rest.strip("/").partition("/")
            inside = inside.lstrip("/")  # model://ecm//meshes/base_link.STL of dvrk_env
            above = [*self._packages, self._folder, *self._folder.parents]
            places = [p / name / inside for p in above]
            places += [p / inside for p in above if p.name == name or is_file(p / "package.xml")]
        else:
            raise node.fail(f"got {uri!r}; allowed: a path, file://, package:// or model://")
        found = next((place for place in places if is_file(place)), None)
        if found is None:
            near = ", ".join(str(place) for place in places[:3])
            raise node.fail(
                f"{uri!r} not found (searched {near}); add its folder with --package-path DIR"
            )
        return found

    def visual(self, node: XmlNode, pose: Array, material: str) -> Shape:
        """Return the visible shape of a <geometry>, at T_link_shape, (4, 4)."""
        return replace(self._shape(node, pose, material), visible=True, collide=False)

    def collision(self, node: XmlNode, pose: Array) -> Shape:
        """Return the colliding shape of a <geometry>, at T_link_shape, (4, 4)."""
        return replace(self._shape(node, pose, "casting"), visible=False, collide=True)

    def _shape(self, node: XmlNode, pose: Array, material: str) -> Shape:
        node.check(("box", "cylinder", "sphere", "capsule", "mesh"))
        inside = node.children()
        if len(inside) != 1:
            raise node.fail(f"has {len(inside)} shapes; allowed: one")
        (kind,) = inside
        if kind.tag == "mesh":
            uri = kind.child("uri")
            name = kind.attribute("filename") if uri is None else uri.text()
            path, scale = self.find(uri or kind, name), kind.figures("scale", 3, (1, 1, 1))
            key = path, tuple(scale.tolist())
            if key not in self._read:
                self._read[key] = load_surface(path, scale)
            return mesh_shape(pose, self._read[key], material)
        if kind.tag == "box":
            return solid("box", pose, kind.figures("size", 3).tolist(), material)
        if kind.tag == "sphere":
            return solid("sphere", pose, [kind.number("radius")], material)
        sizes = [kind.number("radius"), kind.number("length")]
        return solid("cylinder" if kind.tag == "cylinder" else "capsule", pose, sizes, material)
