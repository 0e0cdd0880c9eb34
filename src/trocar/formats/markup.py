"""XML as the exports write it: two spaces, numbers without noise, the same bytes each time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import ModuleType
from typing import Any

from trocar.errors import MissingExtraError

#: Lengths and directions below this are rounding. Source: our own choice, far below a micrometre.
NOISE = 1e-14


def lxml_etree(purpose: str = "writing models for other simulators") -> ModuleType:
    """Import lxml.

    Raises:
        MissingExtraError: it is not installed; `purpose` says what needs it
    """
    try:
        from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] - lxml has no types
    except ImportError as error:
        raise MissingExtraError("lxml", "export", purpose) from error
    return etree


def element(tag: str, attributes: Mapping[str, str] | None = None, text: str = "") -> Any:
    """Return an element of lxml, its attributes in their order."""
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
    """Return a whole file: declaration, comment, elements."""
    etree = lxml_etree()
    etree.indent(root, space="  ")
    note = f"<!-- {comment.replace('--', '-')} -->\n".encode() if comment else b""
    body: bytes = etree.tostring(root, encoding="utf-8", pretty_print=True)
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + note + body


def number(value: float, digits: int = 12) -> str:
    """Write a number with so many digits."""
    return f"{float(value) + 0.0:.{digits}g}"


def numbers(values: Iterable[float], digits: int = 12, noise: float = NOISE) -> str:
    """Write numbers with spaces between them; what is below `noise` is 0."""
    return " ".join(number(0.0 if abs(v) < noise else v, digits) for v in values)
