"""Convex pieces of surfaces, and the mass properties of the solids within.

Mass properties are trimesh's, the convex decomposition is CoACD's (Wei et al. 2022, "Approximate
convex decomposition for 3D meshes with collision-aware concavity and tree search").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.meshes import Mesh
from trocar.errors import InputError, MissingExtraError
from trocar.formats.surfaces import MeshSurface, trimesh_library

Array = NDArray[np.float64]
#: Treatment of an open surface: an error, drawn without contact, or closed and decomposed.
OpenSurface = Literal["", "draw", "repair"]

#: Smallest ratio of volume to hull volume of a body that counts as convex. Source: our own choice.
NEARLY_CONVEX = 0.98
#: Ratio of a hull's volume to the cube of its size below which it is flat. Source: rounding; a wire
#: has a millionth.
FLAT = 1e-12
#: Ratio of a hull's volume to the body's above which a warning is given. Source: our own choice.
LARGER_HULL = 1.05
#: Concavity that CoACD leaves, as a ratio to the size, and its largest number of pieces.
#: Source: its authors' default; our own choice, of what a physics step affords.
DENT, MOST_PIECES = 0.05, 32
#: CoACD's search for cuts, and the resolution at which it closes open surfaces. Source: measured on
#: the ten colliding links of SurRoL's ECM: with its authors' defaults some took more than a minute,
#: with these at most 6 s of processor time, and the pieces' volume grew by up to 9 % of the hull's.
SEARCH = {
    "mcts_iterations": 30, "mcts_nodes": 10, "mcts_max_depth": 2, "resolution": 1000,
    "preprocess_resolution": 25,
}  # fmt: skip
#: Largest number of groups, or of separate bodies, that stay pieces of their own. Source: our own
#: choice: twice the pieces of a decomposition, the default of the V-HACD that labs use.
MOST_GROUPS = 64
#: Largest number of corners of a convex piece, which bounds the cost of a contact. Source: our own
#: choice.
MOST_CORNERS = 32
#: Ratio of the area of holes to the surface's up to which they are closed; larger openings are
#: those of vessels. Source: our own choice: a cube's open side is a fifth of the others.
LARGEST_HOLES = 0.1
#: Thickness of the piece of a flat surface [m]. Source: our own choice, more than a physics step's
#: motion of an instrument.
FLAT_M = 1e-3


@dataclass(frozen=True, eq=False)
class MeshSolid:
    """The body within a surface.

    Attributes:
        volume: [m^3]
        com: centre of its volume (3,) [m]
        gyration: inertia of 1 kg about that centre, (3, 3) [m^2]
        convex: convex pieces that fill it; none of a surface that is only drawn
        notes: what was repaired or is larger
    """

    volume: float
    com: Array
    gyration: Array
    convex: tuple[Mesh, ...]
    notes: tuple[str, ...] = ()


def solid_of(
    surface: MeshSurface, file: str, *, hull: bool = False, open_as: OpenSurface = ""
) -> MeshSolid:
    """Return a surface as a body.

    Args:
        surface: triangles [m]
        file: their file, for messages
        hull: return the convex hull instead of convex pieces
        open_as: treatment of a surface that is not closed

    Raises:
        InputError: not watertight, no volume; the message names the ways to import it
        MissingExtraError: trimesh or coacd is not installed
    """
    bodies = _bodies(surface)
    whole = bodies[0] if len(bodies) == 1 else _body(surface.whole)
    if open_as == "draw":
        return _drawn(whole)
    if hull:
        found = _hull(whole, file)
        return _weighed([found], (_mesh(found),), _larger(whole, found))
    if len(bodies) == 1 and not whole.is_watertight:
        open_edges = _open_edges(whole)
        if open_as != "repair":
            raise InputError(
                f"{file}: is not watertight: {open_edges} edges do not have two triangles each;"
                " --open repair closes and decomposes it, --open draw imports it without contact,"
                " --hull takes the convex hull instead"
            )
        bodies = [_filled(whole)]
        if not bodies[0].is_watertight:
            pieces = _decomposed(whole)
            note = f"{open_edges} open edges: replaced by thin walls for contact and mass"
            return _weighed([_body(piece) for piece in pieces], pieces, (note,))
    for body in bodies:
        body.fix_normals()
        extents: Array = np.maximum(body.extents, 1e-9)
        if not body.volume > 1e-6 * float(np.prod(extents)):
            raise InputError(
                f"{file}: has no volume (got {body.volume:.3g} m^3); --open draw imports it without"
                " contact, --hull takes the convex hull instead"
            )
    return _weighed(bodies, _pieces(bodies, file))


def collision_pieces(
    surface: MeshSurface, where: str, *, hull: bool
) -> tuple[list[Mesh], list[str]]:
    """Return the convex pieces of a colliding mesh, which need not be closed, and notes.

    Args:
        surface: triangles [m]
        where: their file, for messages
        hull: return the convex hull of all
    """
    whole = _body(surface.whole)
    if np.linalg.matrix_rank(whole.vertices - whole.vertices[0], tol=1e-6 * whole.scale) < 3:
        return [_thickened(whole, where)], [f"{where}: is flat: {1e3 * FLAT_M:g} mm thick"]
    if hull:
        found = _hull(whole, where)
        return [_mesh(found)], [f"{where}: {text}" for text in _larger(whole, found)]
    return list(_pieces(_bodies(surface), where)), []


def hull_of(surface: Mesh, file: str) -> Mesh:
    """Return the convex hull of a surface, which need not be closed."""
    return _mesh(_hull(_body(surface), file))


def _body(surface: Mesh) -> Any:
    body: Any = trimesh_library().Trimesh(surface.vertices, surface.faces, process=True)
    body.merge_vertices(merge_norm=True, merge_tex=True)
    return body


def _bodies(surface: MeshSurface) -> list[Any]:
    """Return the groups of a surface if each is closed, else all triangles as one body."""
    if len(surface.groups) > 1:
        groups = [_body(group) for group in surface.groups]
        if all(group.is_watertight for group in groups):
            return groups
    return [_body(surface.whole)]


def _open_edges(body: Any) -> int:
    _, count = np.unique(np.sort(body.edges, axis=1), axis=0, return_counts=True)
    return int((count != 2).sum())


def _weighed(
    bodies: Sequence[Any], convex: tuple[Mesh, ...], notes: tuple[str, ...] = ()
) -> MeshSolid:
    """Return the mass properties of uniform bodies together."""
    volumes = np.array([float(body.volume) for body in bodies])
    centres = np.array([body.center_mass for body in bodies])
    com = volumes @ centres / volumes.sum()
    gyration = np.zeros((3, 3))
    for body, volume, centre in zip(bodies, volumes, centres, strict=True):
        off = centre - com
        properties = body.mass_properties
        own = np.asarray(properties["inertia"]) / properties["mass"]
        gyration += volume * (own + off @ off * np.eye(3) - np.outer(off, off))
    return MeshSolid(float(volumes.sum()), com, gyration / volumes.sum(), convex, notes)


def _drawn(body: Any) -> MeshSolid:
    """Return the properties of a box about a surface, without pieces."""
    low, high = np.asarray(body.bounds)
    a, b, c = np.maximum(high - low, FLAT_M)
    gyration = np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) / 12.0
    note = "is drawn only: no contact; mass and inertia are those of a box about it"
    return MeshSolid(float(a * b * c), 0.5 * (low + high), gyration, (), (note,))


def _larger(body: Any, hull: Any) -> tuple[str, ...]:
    if not body.is_watertight or not hull.volume > LARGER_HULL * abs(body.volume):
        return ()
    more = 100.0 * (hull.volume / max(abs(body.volume), 1e-12) - 1.0)
    return (f"the convex hull is {more:.0f} % larger than the body: cavities are filled",)


def _pieces(groups: Sequence[Any], file: str) -> tuple[Mesh, ...]:
    """Return convex pieces: those that are convex stay, the others are decomposed."""
    bodies = [body for group in groups for body in group.split(only_watertight=False)]
    kept: list[Mesh] = []
    rest: list[Any] = []
    for open_or_closed in bodies:
        body = _filled(open_or_closed)
        found = _convex(body)
        if found is None:
            rest.append(body)
        else:
            kept.append(_mesh(found))
    hollow = any(body.is_watertight and body.volume < 0.0 for body in bodies)
    if len(kept) > MOST_GROUPS or (hollow and len(bodies) > 1):
        kept, rest = [], list(bodies)
    if not rest:
        return tuple(kept)
    parts = _decomposed(trimesh_library().util.concatenate(rest))
    if not parts:
        return (_mesh(_hull(trimesh_library().util.concatenate(list(groups)), file)),)
    return (*kept, *parts)


def _convex(body: Any) -> Any:
    """Return the convex hull of a body that is nearly convex, None of another."""
    if np.linalg.matrix_rank(body.vertices - body.vertices[0], tol=1e-6 * body.scale) < 3:
        return None
    hull = body.convex_hull
    return hull if body.is_watertight and abs(body.volume) >= NEARLY_CONVEX * hull.volume else None


def _filled(body: Any) -> Any:
    """Return a body with its small holes closed, or as it is where that does not close it."""
    if body.is_watertight:
        return body
    filled = body.copy()
    try:
        filled.fill_holes()
    except ModuleNotFoundError as problem:  # trimesh looks for it at the call
        raise MissingExtraError("networkx", "convex", "closing a mesh's holes") from problem
    small = filled.area <= (1.0 + LARGEST_HOLES) * body.area
    return filled if filled.is_watertight and small else body


def _thickened(body: Any, file: str) -> Mesh:
    """Return a flat surface with a thickness of `FLAT_M`."""
    centred = body.vertices - body.vertices.mean(axis=0)
    normal = np.linalg.svd(centred, full_matrices=True)[2][2]
    sides = [body.vertices + s * 0.5 * FLAT_M * normal for s in (-1.0, 1.0)]
    try:
        return _mesh(trimesh_library().convex.convex_hull(np.concatenate(sides)))
    except Exception as problem:  # Qhull's errors are its own
        raise InputError(f"{file}: is a line: no colliding shape") from problem


def _hull(body: Any, file: str) -> Any:
    try:
        found = body.convex_hull
    except Exception as problem:  # Qhull's errors are its own
        raise InputError(f"{file}: is planar or linear: the convex hull has no volume") from problem
    if not found.volume > FLAT * float(np.ptp(found.vertices, axis=0).max()) ** 3:
        raise InputError(f"{file}: is planar or linear: the convex hull has no volume")
    return found


def _decomposed(body: Any) -> tuple[Mesh, ...]:
    """Return CoACD's pieces; it closes open surfaces to thin walls first."""
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
        **SEARCH,
    )
    return tuple(
        Mesh(np.asarray(v, dtype=np.float64), np.asarray(f, dtype=np.int64)) for v, f in parts
    )


def _mesh(body: Any) -> Mesh:
    return Mesh(np.array(body.vertices, dtype=np.float64), np.array(body.faces, dtype=np.int64))
