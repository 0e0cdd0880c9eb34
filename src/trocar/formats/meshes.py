"""Meshes: written, and found where a robot's file names them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import Shape, ShapeKind
from trocar.formats.links import LinkModel, mesh_shape, solid
from trocar.formats.pieces import collision_pieces
from trocar.formats.surfaces import SUFFIXES, MeshSurface, mean_colour, read_surface
from trocar.formats.xml_tree import XmlNode, package_places, read_xml
from trocar.inputs import is_file

Array = NDArray[np.float64]

MATERIAL_FILE = "materials.mtl"
#: Material of shapes without a colour.
DEFAULT_MATERIAL = "casting"


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


@dataclass(frozen=True)
class ReadOptions:
    """Options of reading a robot's file and its meshes.

    Attributes:
        packages: folders of packages, for package://, model:// and $(find)
        hull: colliding meshes become their convex hulls
        up: up axis of every mesh, of `surfaces.UP`; "": the files' own
        arguments: (name, value) of the arguments of a xacro file
    """

    packages: tuple[Path, ...] = ()
    hull: bool = False
    up: str = ""
    arguments: tuple[tuple[str, str], ...] = ()


#: {element: kind of shape}
PRIMITIVES: Mapping[str, ShapeKind] = {
    "box": "box", "sphere": "sphere", "cylinder": "cylinder", "capsule": "capsule"
}  # fmt: skip
#: Shapes without a solid: of floors and terrain, and Bullet's distance fields.
ENDLESS = ("plane", "heightmap", "cdf")
#: A mesh's file, its object ("" for all), whether that is centred, and the scale.
MeshKey = tuple[Path, str, bool, tuple[float, ...]]


class MeshFinder:
    """Shapes of a robot's file; each mesh that it names is read and decomposed once.

    Attributes:
        notes: units, axes, looks and hulls that were applied or changed, each once
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._folder = path.resolve().parent
        self._options = options
        self.notes: dict[str, None] = {}
        self._files: dict[tuple[Path, str], MeshSurface] = {}
        self._scaled: dict[MeshKey, MeshSurface] = {}
        self._pieces: dict[MeshKey, list[Mesh]] = {}

    def find(self, node: XmlNode, uri: str) -> Path:
        """Return the file of a URI or relative path.

        Raises:
            ImportFileError: no such file; the message names the places searched
        """
        scheme, mark, rest = uri.partition("://")
        if not mark:
            places = [folder / uri for folder in (self._folder, *self._options.packages)]
        elif scheme == "file":
            places = [Path(rest)]
        elif scheme in ("package", "model"):
            name, _, inside = rest.strip("/").partition("/")
            inside = inside.lstrip("/")  # model://ecm//meshes/base_link.STL of dvrk_env
            packages = package_places(name, self._folder, self._options.packages)
            places = [place / inside for place in packages]
        else:
            raise node.fail(f"got {uri!r}; allowed: a path, file://, package:// or model://")
        found = next((place for place in places if is_file(place)), None)
        if found is None:
            near = ", ".join(str(place) for place in places[:3])
            raise node.fail(
                f"{uri!r} not found (searched {near}); add its folder with --package-path DIR"
            )
        return found

    def model(self, node: XmlNode, uri: str) -> Path:
        """Return the SDF file of a model's URI: the file, or the newest of a model's folder.

        Raises:
            ImportFileError: no such model, or one of a server
        """
        scheme, mark, rest = uri.rstrip("/").partition("://")
        if mark and scheme not in ("file", "model", "package"):
            raise node.fail(f"got {uri!r}; allowed: a path, file://, model:// or package://")
        name, _, inside = rest.strip("/").partition("/")
        if not mark:
            places = [self._folder / uri]
        elif scheme == "file":
            places = [Path(rest)]
        else:
            found = package_places(name, self._folder, self._options.packages)
            places = [place / inside if inside else place for place in found]
        for place in places:
            if is_file(place):
                return place
            config = place / "model.config"
            if is_file(config):
                files = read_xml(config).children("sdf")
                return place / max(files, key=_version_of).text()
        near = ", ".join(str(place) for place in places[:3])
        raise node.fail(
            f"{uri!r} not found (searched {near}); add its folder with --package-path DIR"
        )

    def note(self, texts: Iterable[str]) -> None:
        """Add warnings."""
        self.notes |= dict.fromkeys(texts)

    def geometry(self, owner: XmlNode) -> XmlNode | None:
        """Return the <geometry> of a <visual> or <collision>; note and pass over an empty one."""
        found = owner.child("geometry")
        shapes = [] if found is None else found.children()
        for shape in shapes:
            if shape.tag in ENDLESS:
                self.notes[f"<{shape.tag}> of a <{owner.tag}> is ignored"] = None
                return None
        if not shapes or [shape.tag for shape in shapes] == ["empty"]:
            self.notes[f"<{owner.tag}> without a shape is ignored"] = None
            return None
        return found

    def visual(self, node: XmlNode, pose: Array, material: str) -> list[Shape]:
        """Return the visible shapes of a <geometry> at T_link_shape, (4, 4).

        Args:
            node: the <geometry>
            pose: T_link_shape, (4, 4)
            material: of the shape; "": those of its mesh's file
        """
        mesh = self._mesh(node)
        if mesh is None:
            shapes = self._primitive(node, pose, material or DEFAULT_MATERIAL)
            return [replace(shape, visible=True, collide=False) for shape in shapes]
        surface = self._surface(mesh)
        if material:
            return [mesh_shape(pose, surface.whole, material)]
        return [mesh_shape(pose, part, look or DEFAULT_MATERIAL) for look, part in surface.looks]

    def collision(self, node: XmlNode, pose: Array) -> list[Shape]:
        """Return the colliding shapes of a <geometry>, at T_link_shape, (4, 4)."""
        mesh = self._mesh(node)
        if mesh is None:
            shapes = self._primitive(node, pose, DEFAULT_MATERIAL)
        else:
            shapes = [mesh_shape(pose, part, DEFAULT_MATERIAL) for part in self._convex(mesh)]
        return [replace(shape, visible=False, collide=True) for shape in shapes]

    def colour(self, node: XmlNode, uri: str) -> Array:
        """Return the mean colour of a texture, (3,) in 0 to 1."""
        path = self.find(node, uri)
        self.notes[f"{path.name}: texture replaced by its mean colour"] = None
        return mean_colour(path)

    def _mesh(self, node: XmlNode) -> MeshKey | None:
        """Return the mesh of a <geometry>, None of a primitive."""
        known = (*PRIMITIVES, "mesh")
        inside = [shape for shape in node.children() if shape.tag in known]
        if len(inside) == 1:
            self.note(node.unknown(known))
        else:
            node.check(known)
        if len(inside) != 1:
            raise node.fail(f"has {len(inside)} shapes; allowed: one")
        (kind,) = inside
        if kind.tag != "mesh":
            return None
        uri, part = kind.child("uri"), kind.child("submesh")
        name = kind.attribute("filename") if uri is None else uri.text()
        path, scale = self.find(uri or kind, name), kind.figures("scale", 3, (1, 1, 1))
        if path.suffix.lower() not in SUFFIXES:
            raise kind.fail(f"got {name!r}; allowed: a file that ends in {', '.join(SUFFIXES)}")
        if not scale.all():
            raise kind.fail("has a scale of 0; allowed: three numbers other than 0")
        if part is None:
            return path, "", False, tuple(scale.tolist())
        middle = part.child("center")
        centred = middle is not None and middle.text() in ("1", "true")
        return path, part.need("name").text(), centred, tuple(scale.tolist())

    def _primitive(self, node: XmlNode, pose: Array, material: str) -> list[Shape]:
        """Return the box, sphere, cylinder or capsule of a <geometry>, none of no size."""
        (kind,) = (shape for shape in node.children() if shape.tag in PRIMITIVES)
        if kind.tag == "box":
            sizes = kind.figures("size", 3).tolist()
        elif kind.tag == "sphere":
            sizes = [kind.number("radius")]
        else:
            sizes = [kind.number("radius"), kind.number("length")]
        if min(sizes) < 0.0:
            raise kind.fail(f"has a size of {min(sizes):g}; allowed: above 0")
        if min(sizes) == 0.0:
            self.notes[f"<{kind.tag}> of no size is ignored"] = None
            return []
        return [solid(PRIMITIVES[kind.tag], pose, sizes, material)]

    def _surface(self, key: MeshKey) -> MeshSurface:
        if key not in self._scaled:
            path, part, centred, scale = key
            if (path, part) not in self._files:
                found = read_surface(path, up=self._options.up, part=part)
                self.notes |= dict.fromkeys(found.notes)
                self._files[path, part] = found
            found = self._files[path, part]
            self._scaled[key] = (_centred(found) if centred else found).scaled(np.array(scale))
        return self._scaled[key]

    def _convex(self, key: MeshKey) -> list[Mesh]:
        if key not in self._pieces:
            name = key[0].name
            found, notes = collision_pieces(self._surface(key), name, hull=self._options.hull)
            self.notes |= dict.fromkeys(notes)
            self._pieces[key] = found
        return self._pieces[key]


def _centred(surface: MeshSurface) -> MeshSurface:
    """Return a surface with its origin in the middle of the box about it."""
    points = surface.whole.vertices
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))

    def of(mesh: Mesh) -> Mesh:
        return Mesh(mesh.vertices - middle, mesh.faces)

    looks = tuple((material, of(mesh)) for material, mesh in surface.looks)
    return replace(surface, looks=looks, groups=tuple(of(mesh) for mesh in surface.groups))


def _version_of(node: XmlNode) -> tuple[int, ...]:
    """Return the version that an element names, as numbers."""
    parts = node.attribute("version", "0").split(".")
    return tuple(int(part) if part.isdecimal() else 0 for part in parts)
