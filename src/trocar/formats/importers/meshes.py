"""Triangles of meshes: read, judged, and taken apart into convex pieces.

Reading and mass properties are trimesh's, the convex decomposition is CoACD's (Wei et al. 2022,
"Approximate convex decomposition for 3D meshes with collision-aware concavity and tree search").
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.meshes import MOST_BYTES, MOST_TRIANGLES, Mesh, lfs_problem, welded
from trocar.errors import InputError, MissingExtraError
from trocar.formats.importers.model import ImportFileError
from trocar.inputs import is_file

Array = NDArray[np.float64]

FORMATS = (".obj", ".stl", ".ply", ".glb", ".gltf", ".dae")
#: A body that fills so much of its convex hull is taken for convex. Source: our own choice.
NEARLY_CONVEX = 0.98
#: How deep a dent CoACD leaves, as a share of the size, and how many pieces it may make. Source:
#: its authors' default is 0.05; 32 pieces are what a physics step can carry.
DENT, MOST_PIECES = 0.05, 32
#: Corners of a convex piece at most, so that touching stays cheap. Source: our own choice.
MOST_CORNERS = 32
#: Sizes that no part of an operating theatre has [m]. Source: our own choice: a cart is 2 m high, a
#: needle's thread 0.1 mm thick.
SMALLEST_M, LARGEST_M = 5e-4, 10.0


@dataclass(frozen=True, eq=False)
class MeshSolid:
    """A body of triangles.

    Attributes:
        surface: what it looks like
        volume: [m^3]
        com: centre of its volume (3,) [m]
        gyration: inertia about it of 1 kg, (3, 3) [m^2]
        convex: convex pieces that fill it
    """

    surface: Mesh
    volume: float
    com: Array
    gyration: Array
    convex: tuple[Mesh, ...]


def load_surface(path: Path, scale: Array | float = 1.0) -> Mesh:
    """Return the triangles of a file, times `scale` (a number, or one an axis).

    Corners at the same place are one, as `read_mesh` has them: STL repeats each six times.

    Raises:
        ImportFileError: no such file, an unknown format, no triangles, too many
        MissingExtraError: trimesh is not installed
    """
    trimesh = _trimesh()
    if path.suffix.lower() not in FORMATS:
        raise ImportFileError(str(path), f"unknown format; allowed: {', '.join(FORMATS)}")
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
        file: where they are from, for messages
        hull: take the convex hull of them instead of convex pieces

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
    if not body.volume > 1e-6 * float(np.prod(np.maximum(body.extents, 1e-9))):
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
    """Refuse a size that betrays the wrong unit.

    Raises:
        InputError: naming the size that was got and the units that would make sense of it
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
        import coacd
    except ImportError as problem:
        raise MissingExtraError("coacd", "convex", "mesh decomposition") from problem
    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(np.asarray(body.vertices), np.asarray(body.faces)),
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
