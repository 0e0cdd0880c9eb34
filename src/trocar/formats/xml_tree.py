"""XML: elements and numbers, written and read; inertias and joints, which URDF and SDF share.

Written files have the same bytes each time: two spaces, numbers without noise.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.meshes import lfs_problem
from trocar.errors import MissingExtraError
from trocar.formats.links import ImportFileError, SourceJoint
from trocar.inputs import is_file, read_input

Array = NDArray[np.float64]

#: Largest magnitude of lengths and directions that is written as 0. Source: our own choice, far
#: below a micrometre.
NOISE = 1e-14
#: Size limit of a file [byte]. Source: our own choice; the largest of MuJoCo Menagerie has 0.2 MB.
MOST_BYTES = 16_000_000
#: Declaration of a version that XML does not have: Bullet's files have "0.0".
XML_VERSION = re.compile(rb"""^(<\?xml\s+version\s*=\s*["'])(?!1\.[01]["'])[^"']*""")
#: Blank lines before the declaration, which Bullet's reader takes.
XML_LATE = re.compile(rb"^(?:\xef\xbb\xbf)?(\s*)(<\?xml\b[^>]*>)")
#: Least similarity of a misspelled element to an allowed one, 0 to 1. Source: our own choice.
SIMILAR = 0.8
#: Smallest limit that stands for infinity. Source: sdformat, joint axis limits (1e16).
INFINITE = 1e15


def lxml_etree(purpose: str = "writing models for other simulators") -> ModuleType:
    """Import lxml.

    Raises:
        MissingExtraError: it is not installed; the message names `purpose`
    """
    try:
        from lxml import (  # pyright: ignore[reportMissingTypeStubs] - lxml has no types
            etree,  # pyright: ignore[reportAttributeAccessIssue, reportUnknownVariableType]
        )
    except ImportError as error:
        raise MissingExtraError("lxml", "export", purpose) from error
    return cast(ModuleType, etree)


def element(tag: str, attributes: Mapping[str, str] | None = None, text: str = "") -> Any:
    """Return an element of lxml with its attributes in the order given."""
    made = lxml_etree().Element(tag, dict(attributes or {}))
    made.text = text or None
    return made


def child(
    parent: Any, tag: str, attributes: Mapping[str, str] | None = None, text: str = ""
) -> Any:
    """Append an element to another and return it."""
    made = element(tag, attributes, text)
    parent.append(made)
    return made


def document(root: Any, comment: str = "") -> bytes:
    """Return a file: declaration, comment, elements."""
    etree = lxml_etree()
    etree.indent(root, space="  ")
    note = f"<!-- {comment.replace('--', '-')} -->\n".encode() if comment else b""
    body: bytes = etree.tostring(root, encoding="utf-8", pretty_print=True)
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + note + body


def number(value: float, digits: int = 12) -> str:
    """Write a number with `digits` significant digits."""
    return f"{float(value) + 0.0:.{digits}g}"


def numbers(values: Iterable[float], digits: int = 12, noise: float = NOISE) -> str:
    """Write numbers, separated by spaces; those below `noise` become 0."""
    return " ".join(number(0.0 if abs(v) < noise else v, digits) for v in values)


class XmlNode:
    """An element of a file, with its line."""

    def __init__(self, element: Any, file: str) -> None:
        self._element = element
        self._file = file

    @property
    def element(self) -> Any:
        """The element of lxml."""
        return self._element

    @property
    def tag(self) -> str:
        """Name of the element."""
        return str(self._element.tag)

    def fail(self, problem: str) -> ImportFileError:
        """Return an error with this element's file, line and tag."""
        _, _, local = self.tag.rpartition("}")
        name = f"{self._element.prefix}:{local}" if self._element.prefix else local
        return ImportFileError(self._file, f"<{name}> {problem}", self._element.sourceline)

    def children(self, tag: str | None = None) -> list[XmlNode]:
        """Return the elements inside, all or those with a tag; none of namespaces (drake:)."""
        inside = [e for e in self._element if isinstance(e.tag, str) and "{" not in e.tag]
        return [XmlNode(e, self._file) for e in inside if tag is None or e.tag == tag]

    def all_children(self) -> list[XmlNode]:
        """Return all elements inside, those of namespaces included."""
        return [XmlNode(e, self._file) for e in self._element if isinstance(e.tag, str)]

    def child(self, tag: str) -> XmlNode | None:
        """Return the one element with a tag, None without one.

        Raises:
            ImportFileError: more than one
        """
        found = self.children(tag)
        if len(found) > 1:
            raise self.fail(f"has {len(found)} <{tag}>; allowed: one")
        return found[0] if found else None

    def need(self, tag: str) -> XmlNode:
        """Return the one element with a tag.

        Raises:
            ImportFileError: none, or more than one
        """
        found = self.child(tag)
        if found is None:
            raise self.fail(f"lacks <{tag}>")
        return found

    def check(self, known: Iterable[str]) -> None:
        """Reject elements inside other than those of `known`.

        Raises:
            ImportFileError: there is one
        """
        allowed = tuple(known)
        for inside in self.children():
            if inside.tag not in allowed:
                raise inside.fail(f"is unknown inside <{self.tag}>; allowed: {', '.join(allowed)}")

    def unknown(self, known: Iterable[str]) -> list[str]:
        """Return a note of each element inside other than those of `known`.

        Raises:
            ImportFileError: one seems to be a misspelled one of `known`
        """
        allowed, found = tuple(known), list[str]()
        for inside in self.children():
            if inside.tag in allowed:
                continue
            near = get_close_matches(inside.tag, allowed, n=1, cutoff=SIMILAR)
            if near:
                raise inside.fail(
                    f"is unknown inside <{self.tag}>: did you mean <{near[0]}>? allowed:"
                    f" {', '.join(allowed)}"
                )
            found.append(f"{self._file}: <{inside.tag}> inside <{self.tag}> is unknown and ignored")
        return found

    def text(self) -> str:
        """Return the text inside."""
        return (self._element.text or "").strip()

    def attribute(self, key: str, default: str | None = None) -> str:
        """Return an attribute.

        Raises:
            ImportFileError: the attribute is missing and has no default
        """
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
        early = XML_LATE.sub(rb"\2\1", data)  # the lines keep their numbers
        return XmlNode(etree.fromstring(XML_VERSION.sub(rb"\g<1>1.0", early), parser), str(path))
    except OSError as problem:
        raise ImportFileError(str(path), f"cannot be read: {problem.strerror}") from problem
    except etree.XMLSyntaxError as problem:
        raise ImportFileError(str(path), f"is not XML: {problem.msg}", problem.lineno) from None


def package_places(name: str, folder: Path, packages: Iterable[Path]) -> list[Path]:
    """Return folders that may be a package's, the likeliest first.

    Args:
        name: of the package
        folder: that of the file that names it
        packages: folders in which packages are, or packages
    """
    above = [*packages, folder, *folder.parents]
    called = [p for p in above if p.name == name or _manifest_name(p / "package.xml") == name]
    return [*(p / name for p in above), *called]


def _manifest_name(path: Path) -> str:
    """Return the name in a package's manifest, "" without one."""
    if not is_file(path):
        return ""
    found = re.search(r"<name>\s*([^<\s]+)\s*</name>", path.read_text("utf-8", "replace"))
    return "" if found is None else found[1]


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
    joint: SourceJoint, node: XmlNode, along: Array, limits: tuple[float, float]
) -> SourceJoint:
    """Return a joint with its axis, limits, friction and coupling.

    Args:
        joint: the joint with links and pose
        node: parent of <limit>, <dynamics> and <mimic>: a URDF's joint, an SDF's axis
        along: axis in the child, of any length, (3,)
        limits: lower and upper
    """
    limit, dynamics, mimic = node.child("limit"), node.child("dynamics"), node.child("mimic")
    found = {"effort": np.inf, "velocity": np.inf, "damping": 0.0, "friction": 0.0}
    for key, value in found.items():
        holder = limit if value else dynamics
        if holder is not None:
            got = holder.number(key, -1.0 if value else 0.0)
            found[key] = got if not value or 0.0 < got < INFINITE else value
    follows = None
    if mimic is not None:
        ratio = mimic.number("multiplier", 1.0)
        offset = mimic.number("offset", 0.0) - ratio * mimic.number("reference", 0.0)
        follows = (mimic.attribute("joint"), ratio, offset)
    lower, upper = limits
    axis = along / np.linalg.norm(along)
    return replace(joint, axis=axis, lower=lower, upper=upper, follows=follows, **found)
