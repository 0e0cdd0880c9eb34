"""Surfaces of mesh files: triangles in metres with z up, one mesh a colour.

trimesh reads the triangles and looks. Units and up axes are the files' own: metres and y of glTF
(its specification 2.0, section 3.4), <unit> and <up_axis> of COLLADA 1.5, comments of OBJ and PLY,
the header of STL.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.descriptions.meshes import MOST_BYTES, MOST_TRIANGLES, Mesh, lfs_problem, welded
from trocar.errors import MissingExtraError
from trocar.formats.collada import mended_collada
from trocar.formats.links import ImportFileError, material_of
from trocar.inputs import is_file

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Endings of the files that are read.
SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".gltf", ".dae")
#: {unit of a mesh's numbers: metres}
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
#: {axis that is up in a file: R_z-up_file}. Source: COLLADA 1.5, <up_axis>: right, up and towards
#: the viewer are -y, x, z of X_UP, x, y, z of Y_UP and x, z, -y of Z_UP.
UP = {
    "x": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
#: Largest number of colours of a surface; more, as of photographs, are reduced to as many.
#: Source: our own choice: each is a mesh of its own.
MOST_COLOURS = 16
#: Bytes of an OBJ's, PLY's or STL's beginning that are searched for a unit.
HEAD_BYTES = 4096
#: Barycentric coordinates at which a texture is averaged over a triangle, (10, 3).
SAMPLES = np.array([(i, j, 3 - i - j) for i in range(4) for j in range(4 - i)]) / 3.0 * 0.9 + 1 / 30
UNIT_WORD = r"(mm|millimet(?:er|re)s?|cm|centimet(?:er|re)s?|m|met(?:er|re)s?|in|inch(?:es)?)"
UNIT_OF_FILE = re.compile(
    rf"\bunits?\b[\s:=\"']*(?:(?:is|are|in)\b[\s:=\"']*)?{UNIT_WORD}\b|^\W*{UNIT_WORD}\W*$",
    re.IGNORECASE | re.MULTILINE,
)
UP_OF_FILE = re.compile(r"\b([xyz])[\s_-]*up\b|\bup[\s_-]*(?:axis)?[\s:=]*\+?([xyz])\b", re.I)
COLLADA_UNIT = re.compile(r"<unit\b[^>]*\bmeter\s*=\s*[\"']([^\"']+)[\"']")
COLLADA_UP = re.compile(r"<up_axis>\s*([XYZ])_UP\s*</up_axis>")


@dataclass(frozen=True, eq=False)
class MeshSurface:
    """The triangles of a file.

    Attributes:
        looks: (material, mesh) of each colour; the material is a name of `descriptions.materials`,
            "" of triangles without a colour [m]
        groups: the objects and groups of an OBJ, or all triangles [m]
        notes: looks, unit and axis of the file that were applied, changed or ignored
    """

    looks: tuple[tuple[str, Mesh], ...]
    groups: tuple[Mesh, ...]
    notes: tuple[str, ...] = ()

    @property
    def whole(self) -> Mesh:
        """All triangles."""
        return self.groups[0] if len(self.groups) == 1 else joined(self.groups)

    def scaled(self, scale: Array) -> MeshSurface:
        """Return the surface times (3,) factors; a mirrored one is turned outside out again."""

        def of(mesh: Mesh) -> Mesh:
            faces = mesh.faces[:, ::-1] if np.prod(scale) < 0.0 else mesh.faces
            return Mesh(mesh.vertices * scale, faces)

        looks = tuple((material, of(mesh)) for material, mesh in self.looks)
        return replace(self, looks=looks, groups=tuple(of(mesh) for mesh in self.groups))


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return meshes as one, corners at the same place merged."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(*welded(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces)))


def read_surface(path: Path, unit: str = "", up: str = "", part: str = "") -> MeshSurface:
    """Read the triangles of a file, with z up [m].

    Args:
        path: OBJ, STL, PLY, glTF or DAE
        unit: unit of its numbers, of `UNITS`; "": the file's own, else metres
        up: its up axis, of `UP`; "": the file's own, else z
        part: the name of one object in the file; "": all

    Raises:
        ImportFileError: no such file, an unknown format, no triangles, too many
        MissingExtraError: trimesh or pycollada is not installed
    """
    _check_file(path)
    trimesh = trimesh_library()
    split, collada = path.suffix.lower() == ".obj", path.suffix.lower() == ".dae"
    if collada and find_spec("collada") is None:
        raise MissingExtraError("pycollada", "convex", "reading DAE files")
    mended, lacking = mended_collada(path) if collada else (b"", [])
    log = logging.getLogger("trimesh")
    before = log.level
    log.setLevel(logging.CRITICAL)  # of facets without normals it logs a traceback
    try:
        found = trimesh.load(
            io.BytesIO(mended) if collada else path,
            file_type="dae" if collada else None,
            resolver=trimesh.resolvers.FilePathResolver(path) if collada else None,
            force="scene",
            process=False,
            **(dict.fromkeys(("split_objects", "split_groups"), True) if split else {}),
        )
        parts = list(_parts(found, linear=path.suffix.lower() in (".glb", ".gltf"), part=part))
    except Exception as problem:  # trimesh's readers raise whatever they meet
        raise ImportFileError(str(path), f"cannot be read: {problem}") from problem
    finally:
        log.setLevel(before)
    count = sum(len(faces) for _, faces, _ in parts)
    clouds = [one for one in found.geometry.values() if not hasattr(one, "faces")]
    points = sum(len(getattr(one, "vertices", ())) for one in clouds)
    if not count and not part and points:
        raise ImportFileError(
            str(path),
            f"has {points} points or lines and no triangles; allowed: a surface (MeshLab and Open3D"
            " reconstruct that of a scan)",
        )
    if not 0 < count <= MOST_TRIANGLES:
        of = f" in {part!r}" if part else ""
        raise ImportFileError(
            str(path), f"has {count} triangles{of}; allowed: 1 to {MOST_TRIANGLES}"
        )
    if not all(np.isfinite(vertices).all() for vertices, _, _ in parts):
        raise ImportFileError(str(path), "has coordinates that are not finite")
    for vertices, faces, _ in parts:
        if not 0 <= faces.min() <= faces.max() < len(vertices):
            corner = int(faces.max() if faces.min() >= 0 else faces.min())
            raise ImportFileError(
                str(path), f"has a triangle at corner {corner}; allowed: 0 to {len(vertices) - 1}"
            )
    metres, turn, notes = _conventions(path, unit, up)
    meshes = [Mesh(*welded(metres * v @ turn.T, faces)) for v, faces, _ in parts]
    looks, more = _looks(meshes, [look for _, _, look in parts])
    said = [*notes, *lacking, *more, *(_missing_looks(path) if split else ())]
    groups = tuple(meshes) if split else (joined(meshes),)
    return MeshSurface(looks, groups, tuple(f"{path.name}: {text}" for text in said))


def _check_file(path: Path) -> None:
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


def trimesh_library() -> Any:
    """Import trimesh.

    Raises:
        MissingExtraError: it is not installed
    """
    try:
        import trimesh
    except ImportError as problem:
        raise MissingExtraError("trimesh", "convex", "reading meshes") from problem
    return trimesh


@dataclass(frozen=True, eq=False)
class _Look:
    """Colours of a part's triangles as a screen has them, (m, 3) in 0 to 1; None without any."""

    rgb: Array | None
    textured: bool = False
    clear: bool = False


def _parts(scene: Any, *, linear: bool, part: str) -> Iterator[tuple[Array, Ints, _Look]]:
    """Yield corners, triangles and look of each object of a scene, or of those of one name."""
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not hasattr(mesh, "faces") or (part and part not in (node, name)):
            continue
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
        if not len(faces):
            continue
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        vertices = vertices @ pose[:3, :3].T + pose[:3, 3]
        if np.linalg.det(pose[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
        yield vertices, faces, _look_of(mesh, linear)


def _look_of(mesh: Any, linear: bool) -> _Look:
    visual = mesh.visual
    count = len(mesh.faces)
    if visual.kind in ("vertex", "face"):
        rgba = np.asarray(visual.face_colors, dtype=np.float64) / 255.0
        rgb = _screen_from_linear(rgba[:, :3]) if linear else rgba[:, :3]
        return _Look(rgb, clear=bool((rgba[:, 3] < 1.0).any()))
    material = getattr(visual, "material", None)
    if material is None:
        return _Look(None)
    own = getattr(material, "kwargs", {})  # of an MTL, whose missing colour trimesh makes grey
    simple = hasattr(material, "diffuse")
    factor = material.diffuse if simple else getattr(material, "baseColorFactor", None)
    if simple and "kd" not in own:
        factor = None
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if simple and not own and image is not None and image.size == (2, 2):
        image = None  # trimesh's stand-in where a file has coordinates and no material
    rgba = np.ones(4) if factor is None else np.asarray(factor, dtype=np.float64) / 255.0
    clear = bool(rgba[3] < 1.0) or _opacity(own) < 1.0
    tint = _screen_from_linear(rgba[:3]) if linear else rgba[:3]
    uv = getattr(visual, "uv", None)
    if image is not None and uv is not None and len(uv) == len(mesh.vertices):
        texels = _texture(image, np.asarray(uv)[np.asarray(mesh.faces)])
        return _Look(texels if simple else texels * tint, textured=True, clear=clear)
    if factor is None:
        return _Look(None, textured=image is not None)
    return _Look(np.tile(tint, (count, 1)), textured=image is not None, clear=clear)


def _opacity(keys: dict[str, Any]) -> float:
    try:
        return float(keys["d"][0]) if "d" in keys else 1.0
    except (ValueError, IndexError, TypeError):
        return 1.0


def _screen_from_linear(light: Array) -> Array:
    """Return linear light as a screen's colour. Source: IEC 61966-2-1 (sRGB)."""
    clipped = np.clip(light, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def _texture(image: Any, uv: Array) -> Array:
    """Return the mean colour of an image over each triangle.

    Args:
        image: of Pillow
        uv: corners of the triangles in the image, (m, 3, 2)
    """
    pixels = np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0
    rows, columns = pixels.shape[:2]
    total = np.zeros((len(uv), 3))
    for weights in SAMPLES:
        u, v = np.nan_to_num(np.einsum("k,mkc->mc", weights, uv)).T % 1.0
        row = np.minimum(((1.0 - v) * rows).astype(int), rows - 1)
        total += pixels[row, np.minimum((u * columns).astype(int), columns - 1)]
    return total / len(SAMPLES)


def mean_colour(path: Path) -> Array:
    """Return the mean colour of an image file, (3,) in 0 to 1.

    Raises:
        ImportFileError: no image
    """
    try:
        with Image.open(path) as image:
            small = image.convert("RGB").resize((1, 1), Image.Resampling.BOX)
    except (OSError, Image.DecompressionBombError) as problem:
        raise ImportFileError(str(path), f"is no image: {problem}") from problem
    return np.asarray(small, dtype=np.float64).reshape(3) / 255.0


def _looks(
    meshes: Sequence[Mesh], looks: Sequence[_Look]
) -> tuple[tuple[tuple[str, Mesh], ...], list[str]]:
    """Return one mesh a colour, and notes."""
    rgb = np.concatenate([
        np.full((len(mesh.faces), 3), np.nan) if look.rgb is None else look.rgb
        for mesh, look in zip(meshes, looks, strict=True)
    ])  # fmt: skip
    whole = joined(meshes)  # triangles in the order of the parts
    coloured = np.isfinite(rgb).all(axis=1)
    found = (
        [("", Mesh(*welded(whole.vertices, whole.faces[~coloured])))] if (~coloured).any() else []
    )
    notes: list[str] = []
    if coloured.any():
        palette, place, count = _palette(rgb[coloured])
        faces = whole.faces[coloured]
        for k, colour in enumerate(palette):
            if (place == k).any():
                part = Mesh(*welded(whole.vertices, faces[place == k]))
                found.append((material_of(colour), part))
        if any(look.textured and look.rgb is not None for look in looks):
            notes.append(f"texture replaced by {len(palette)} flat colours")
        elif count > len(palette):
            notes.append(f"{count} colours reduced to {len(palette)}")
    if any(look.textured and look.rgb is None for look in looks):
        notes.append("texture without coordinates ignored")
    if any(look.clear for look in looks):
        notes.append("transparency ignored")
    by_name: dict[str, list[Mesh]] = {}
    for material, mesh in found:
        by_name.setdefault(material, []).append(mesh)
    return tuple((m, ms[0] if len(ms) == 1 else joined(ms)) for m, ms in by_name.items()), notes


def _palette(rgb: Array) -> tuple[Array, Ints, int]:
    """Return up to `MOST_COLOURS` colours (k, 3), that of each row (m,), and the true count."""
    eight = np.rint(255.0 * np.clip(rgb, 0.0, 1.0)).astype(np.uint8)
    own, place = np.unique(eight, axis=0, return_inverse=True)
    if len(own) <= MOST_COLOURS:
        return own / 255.0, place.reshape(-1).astype(np.int64), len(own)
    picture = Image.fromarray(np.ascontiguousarray(eight[None]))
    few = picture.quantize(MOST_COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    place = np.asarray(few, dtype=np.int64).reshape(-1)
    kept, place = np.unique(place, return_inverse=True)
    place = place.reshape(-1).astype(np.int64)
    means = np.stack([eight[place == k].mean(axis=0) for k in range(len(kept))])
    return means / 255.0, place, len(own)


def _missing_looks(path: Path) -> Iterator[str]:
    """Yield notes of material files and images that an OBJ names and that are not there."""
    text = path.read_text(encoding="utf-8", errors="replace")
    for name in dict.fromkeys(re.findall(r"^mtllib\s+(.+?)\s*$", text, re.MULTILINE)):
        library = path.parent / name
        if not is_file(library):
            yield f"material file {name!r} not found: its colours are missing"
            continue
        content = library.read_text(encoding="utf-8", errors="replace")
        for image in dict.fromkeys(re.findall(r"^\s*map_Kd\s+(.+?)\s*$", content, re.M | re.I)):
            if not is_file(library.parent / image):
                yield f"texture {image!r} not found: drawn in the material's colour"


def _conventions(path: Path, unit: str, up: str) -> tuple[float, Array, list[str]]:
    """Return the unit [m], the rotation to z up (3, 3), and notes on those of the file."""
    own_unit, own_up = _of_file(path)
    notes: list[str] = []
    metres = UNITS[unit] if unit else own_unit or 1.0
    if unit and own_unit is not None and not np.isclose(own_unit, UNITS[unit]):
        notes.append(f"--unit {unit} replaces the file's unit of {own_unit:g} m")
    elif own_unit is not None and own_unit != 1.0 and not unit:
        notes.append(f"the file's unit of {own_unit:g} m applied")
    axis = up or own_up or "z"
    if up and own_up is not None and own_up != up:
        notes.append(f"--up {up} replaces the file's up axis {own_up}")
    elif axis != "z" and not up:
        notes.append(
            f"the file's up axis {axis} turned to z, as RViz and Gazebo do not (--up z keeps it)"
        )
    return metres, UP[axis], notes


def _of_file(path: Path) -> tuple[float | None, str | None]:
    """Return the unit [m] and the up axis that a file gives, None where it gives none."""
    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf"):
        return 1.0, "y"
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES).decode("latin-1")
    if suffix == ".dae":
        with path.open("rb") as file:
            start = file.read(1 << 16)
        wide = start[:2] in (b"\xff\xfe", b"\xfe\xff")
        asset = start.decode("utf-16" if wide else "latin-1", "replace").partition("</asset>")[0]
        found, axis = COLLADA_UNIT.search(asset), COLLADA_UP.search(asset)
        try:
            unit = float(found[1]) if found else None
        except ValueError:
            unit = None
        known = unit is not None and np.isfinite(unit) and unit > 0.0
        # Source: COLLADA 1.5: without the elements a file is in metres with y up.
        return unit if known else 1.0, axis[1].lower() if axis else "y"
    if suffix == ".obj":
        head = "\n".join(line[1:] for line in head.splitlines() if line.startswith("#"))
    elif suffix == ".ply":
        header = head.partition("end_header")[0].splitlines()
        head = "\n".join(
            x.partition(" ")[2] for x in header if x.startswith(("comment", "obj_info"))
        )
    else:
        head = head.splitlines()[0] if head.startswith("solid") else head[:80]
    found, axis = UNIT_OF_FILE.search(head), UP_OF_FILE.search(head)
    unit = None if found is None else _metres(found[1] or found[2])
    return unit, (axis[1] or axis[2]).lower() if axis else None


def _metres(word: str) -> float:
    low = word.lower()
    short = {"mi": "mm", "ce": "cm", "me": "m", "in": "in"}
    return UNITS[low if low in UNITS else short[low[:2]]]
