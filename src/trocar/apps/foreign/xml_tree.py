"""XML with line numbers: what readers of URDF and SDF share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.foreign.records import ForeignFileError
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import transform
from trocar.modeling.markup import lxml_etree

Array = NDArray[np.float64]


class Node:
    """An element that knows its file and line."""

    def __init__(self, element: Any, file: str) -> None:
        self._element = element
        self._file = file

    @property
    def tag(self) -> str:
        """Its name."""
        return str(self._element.tag)

    def fail(self, problem: str) -> ForeignFileError:
        """Return an error that says where this element stands."""
        return ForeignFileError(self._file, f"<{self.tag}> {problem}", self._element.sourceline)

    def children(self, tag: str | None = None) -> list[Node]:
        """Return the elements inside, all or those called `tag`.

        Those of other namespaces (drake:..., gz:...) speak to other programs.
        """
        inside = [e for e in self._element if isinstance(e.tag, str) and "{" not in e.tag]
        return [Node(e, self._file) for e in inside if tag is None or e.tag == tag]

    def child(self, tag: str) -> Node | None:
        """Return the element called `tag`, None without one.

        Raises:
            ForeignFileError: more than one
        """
        found = self.children(tag)
        if len(found) > 1:
            raise self.fail(f"has {len(found)} <{tag}>; allowed: one")
        return found[0] if found else None

    def need(self, tag: str) -> Node:
        """Return the element called `tag`."""
        found = self.child(tag)
        if found is None:
            raise self.fail(f"lacks <{tag}>")
        return found

    def check(self, known: Iterable[str]) -> None:
        """Refuse elements inside that nobody knows."""
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

    def number(self, key: str, default: float | None = None) -> float:
        """Return an attribute that is a number."""
        text = self._element.get(key)
        if text is None and default is not None:
            return default
        return float(self.numbers(1, self.attribute(key))[0])

    def value(self, tag: str, default: float) -> float:
        """Return the number inside a child element."""
        found = self.child(tag)
        return default if found is None else float(found.numbers(1)[0])

    def vector(self, key: str, default: Iterable[float]) -> Array:
        """Return an attribute of three numbers, (3,)."""
        text = self._element.get(key)
        return np.array(list(default)) if text is None else self.numbers(3, text)


def read_xml(path: Path) -> Node:
    """Return the root of an XML file; entities and networks are not followed.

    Raises:
        ForeignFileError: no such file, or no XML
        MissingExtraError: lxml is not installed
    """
    etree = lxml_etree("reading robot files")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    try:
        return Node(etree.fromstring(path.read_bytes(), parser), str(path))
    except OSError as problem:
        raise ForeignFileError(str(path), f"cannot be read: {problem.strerror}") from problem
    except etree.XMLSyntaxError as problem:
        raise ForeignFileError(str(path), f"is no XML: {problem.msg}", problem.lineno) from None


def pose_of(xyz: Array, rpy: Array) -> Array:
    """Return a pose from URDF's and SDF's numbers (fixed axes x, y, z), (4, 4)."""
    return transform(matrix_from_rpy(*rpy), xyz)


def inertia_of(values: Mapping[str, float]) -> Array:
    """Return (3, 3) from ixx, iyy, izz, ixy, ixz, iyz."""
    v = values
    return np.array(
        [
            [v["ixx"], v["ixy"], v["ixz"]],
            [v["ixy"], v["iyy"], v["iyz"]],
            [v["ixz"], v["iyz"], v["izz"]],
        ]
    )
