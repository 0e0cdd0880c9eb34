"""XML with line numbers, and the meshes that it names: what readers of URDF and SDF share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.meshes import Mesh, lfs_problem
from trocar.descriptions.records import Shape
from trocar.formats.importers.meshes import load_surface
from trocar.formats.importers.model import ImportFileError, ModelJoint, mesh_shape, solid
from trocar.formats.markup import lxml_etree
from trocar.inputs import is_file, read_input

Array = NDArray[np.float64]

#: Source: our own choice; the largest of MuJoCo Menagerie has 0.2 MB.
MOST_BYTES = 16_000_000
#: Infinite in SDF is any larger number than this. Source: sdformat, joint axis limits (1e16).
UNLIMITED = 1e15


class XmlNode:
    """An element that knows its file and line."""

    def __init__(self, element: Any, file: str) -> None:
        self._element = element
        self._file = file

    @property
    def tag(self) -> str:
        """Its name."""
        return str(self._element.tag)

    def fail(self, problem: str) -> ImportFileError:
        """Return an error that says where this element stands."""
        return ImportFileError(self._file, f"<{self.tag}> {problem}", self._element.sourceline)

    def children(self, tag: str | None = None) -> list[XmlNode]:
        """Return the elements inside, all or those called `tag`.

        Those of other namespaces (drake:..., gz:...) speak to other programs.
        """
        inside = [e for e in self._element if isinstance(e.tag, str) and "{" not in e.tag]
        return [XmlNode(e, self._file) for e in inside if tag is None or e.tag == tag]

    def child(self, tag: str) -> XmlNode | None:
        """Return the element called `tag`, None without one.

        Raises:
            ImportFileError: more than one
        """
        found = self.children(tag)
        if len(found) > 1:
            raise self.fail(f"has {len(found)} <{tag}>; allowed: one")
        return found[0] if found else None

    def need(self, tag: str) -> XmlNode:
        """Return the element called `tag`."""
        found = self.child(tag)
        if found is None:
            raise self.fail(f"lacks <{tag}>")
        return found

    def check(self, known: Iterable[str]) -> None:
        """Reject unknown elements inside."""
        allowed = tuple(known)
        for inside in self.children():
            if inside.tag not in allowed:
                raise inside.fail(f"is unknown inside <{self.tag}>; allowed: {', '.join(allowed)}")

    def text(self) -> str:
        """Return the text inside."""
        return (self._element.text or "").strip()

    def attribute(self, key: str, default: str | None = None) -> str:
        """Return an attribute."""
        value = self._element.get(key, default)
        if value is None:
            raise self.fail(f"lacks the attribute {key!r}")
        return str(value)

    def attributes(self) -> dict[str, str]:
        """Return all attributes."""
        return {str(key): str(value) for key, value in self._element.attrib.items()}

    def numbers(self, count: int, text: str | None = None) -> Array:
        """Return numbers from a text, by default the one inside, (count,)."""
        words = (self.text() if text is None else text).split()
        try:
            found = np.array([float(word) for word in words])
        except ValueError:
            found = np.zeros(0)
        if len(found) != count or not np.isfinite(found).all():
            raise self.fail(f"got {' '.join(words)!r}; allowed: {count} finite numbers")
        return found

    def figures(self, key: str, count: int, default: Iterable[float] | None = None) -> Array:
        """Return numbers of an attribute (URDF) or an element inside (SDF), (count,)."""
        inside, text = self.child(key), self._element.get(key)
        if inside is not None:
            return inside.numbers(count)
        if text is not None:
            return self.numbers(count, str(text))
        if default is None:
            raise self.fail(f"lacks {key!r}")
        return np.array(list(default), dtype=np.float64)

    def number(self, key: str, default: float | None = None) -> float:
        """Return a number of an attribute (URDF) or an element inside (SDF)."""
        return float(self.figures(key, 1, None if default is None else (default,))[0])


def read_xml(path: Path) -> XmlNode:
    """Return the root of an XML file; entities and networks are not followed.

    Raises:
        ImportFileError: no such file, or no XML
        MissingExtraError: lxml is not installed
    """
    etree = lxml_etree("reading robot files")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    try:
        data = read_input(path, MOST_BYTES)
        if problem := lfs_problem(data):
            raise ImportFileError(str(path), problem)
        return XmlNode(etree.fromstring(data, parser), str(path))
    except OSError as problem:
        raise ImportFileError(str(path), f"cannot be read: {problem.strerror}") from problem
    except etree.XMLSyntaxError as problem:
        raise ImportFileError(str(path), f"is not XML: {problem.msg}", problem.lineno) from None


def inertia_of(node: XmlNode | None, turn: Array, diagonal: float = 0.0) -> Array:
    """Return an inertia in the link's axes, (3, 3).

    Args:
        node: with ixx, iyy, izz, ixy, ixz, iyz; None has the defaults alone
        turn: R_link_inertia
        diagonal: default of ixx, iyy, izz
    """
    I = diagonal * np.eye(3)  # noqa: E741 - the symbol
    if node is not None:
        for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
            I[a, b] = I[b, a] = node.number(f"i{'xyz'[a]}{'xyz'[b]}", float(I[a, b]))
    return turn @ I @ turn.T


def moving_joint(
    joint: ModelJoint, node: XmlNode, along: Array, limits: tuple[float, float]
) -> ModelJoint:
    """Return a joint with its axis, limits, friction and what it follows.

    Args:
        joint: with its links and pose
        node: that holds <limit>, <dynamics> and <mimic>: a URDF's joint, an SDF's axis
        along: axis in the child, of any length, (3,)
        limits: lower and upper
    """
    limit, dynamics, mimic = node.child("limit"), node.child("dynamics"), node.child("mimic")
    found = {"effort": np.inf, "velocity": np.inf, "damping": 0.0, "friction": 0.0}
    for key, value in found.items():
        holder = limit if value else dynamics
        if holder is not None:
            got = holder.number(key, -1.0 if value else 0.0)
            found[key] = got if not value or 0.0 < got < UNLIMITED else value
    follows = None
    if mimic is not None:
        ratio = mimic.number("multiplier", 1.0)
        offset = mimic.number("offset", 0.0) - ratio * mimic.number("reference", 0.0)
        follows = (mimic.attribute("joint"), ratio, offset)
    lower, upper = limits
    axis = along / np.linalg.norm(along)
    return replace(joint, axis=axis, lower=lower, upper=upper, follows=follows, **found)


class MeshFinder:
    """Finds and reads the meshes that a robot's file names."""

    def __init__(self, path: Path, packages: tuple[Path, ...]) -> None:
        self._folder = path.resolve().parent
        self._packages = packages
        #: {file and scale: its triangles}: a link is often seen and touched as the same mesh.
        self._read: dict[tuple[Path, tuple[float, ...]], Mesh] = {}

    def find(self, node: XmlNode, uri: str) -> Path:
        """Return the file that a URI or relative path names.

        Raises:
            ImportFileError: it is not there; where it was looked for is named
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

    def shape(self, node: XmlNode, pose: Array, material: str) -> Shape:
        """Return the one shape of a <geometry>."""
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
            sizes = kind.figures("size", 3).tolist()
        else:
            keys = ("radius",) if kind.tag == "sphere" else ("radius", "length")
            sizes = [kind.number(key) for key in keys]
        return solid(kind.tag, pose, sizes, material)
