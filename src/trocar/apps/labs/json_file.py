"""The dVRK's JSON files: comments, both spellings of a key, and a record of what was read.

Source of the dialect: cisst reads them with jsoncpp, which takes comments; older files spell keys
with hyphens ("base-frame"), newer ones with underscores.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import DescriptionError

Array = NDArray[np.float64]

#: Keys that say what a file is, and mean nothing more.
MARKS = ("$id", "$version", "$schema", "id", "version", "comment", "comments")


class Node:
    """An object of a JSON file that knows where it stands, and what of it was read.

    Attributes:
        file, path: where it stands
        idle: keys that are known and have no counterpart in a simulation
    """

    def __init__(self, data: Mapping[str, Any], file: str, path: str = "") -> None:
        self.file, self.path = file, path
        self.idle: list[str] = []
        self._data = {_plain(key): (key, value) for key, value in data.items()}
        self._read: set[str] = set()
        self._inside: list[Node] = []

    def __contains__(self, key: str) -> bool:
        return _plain(key) in self._data

    def place(self, key: str) -> str:
        """Return the path of an entry, as messages have it."""
        spelled = self._data.get(_plain(key), (key, None))[0]
        return f"{self.path}.{spelled}".strip(".")

    def fail(self, key: str, problem: str) -> DescriptionError:
        """Return the error that names this file, this place and what is wrong there."""
        return DescriptionError(self.file, self.place(key), problem)

    def raw(self, key: str) -> Any:
        """Return an entry as it stands, None where there is none."""
        self._read.add(_plain(key))
        return self._data.get(_plain(key), (key, None))[1]

    def text(self, key: str, default: str | None = None, allowed: Iterable[str] = ()) -> str:
        """Return a text; without a default it must be there."""
        value = self.raw(key)
        if value is None:
            if default is None:
                raise self.fail(key, "is missing; a text is needed")
            return default
        known = tuple(allowed)
        if not isinstance(value, str) or (known and value not in known):
            raise self.fail(key, f"got {value!r}; allowed: {', '.join(known) or 'a text'}")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number; without a default it must be there."""
        value = self.raw(key)
        if value is None and default is not None:
            return default
        return self._finite(key, value)

    def flag(self, key: str) -> bool | None:
        """Return true or false, None where it is left out; 1 and 0 are taken, too."""
        value = self.raw(key)
        if value is None or isinstance(value, bool):
            return value
        if value in (0, 1):
            return bool(value)
        raise self.fail(key, f"got {value!r}; allowed: true, false")

    def numbers(self, key: str) -> Array:
        """Return a list of finite numbers, (n,)."""
        value = self.raw(key)
        if not isinstance(value, list):
            raise self.fail(key, f"got {value!r}; allowed: a list of numbers")
        return np.array([self._finite(key, v) for v in cast(list[Any], value)], dtype=np.float64)

    def matrix(self, key: str, rows: int, columns: int) -> Array:
        """Return rows of numbers, (rows, columns)."""
        value = self.raw(key)
        given = cast(list[Any], value) if isinstance(value, list) else []
        if len(given) != rows or any(
            not isinstance(row, list) or len(cast(list[Any], row)) != columns for row in given
        ):
            raise self.fail(key, f"got {value!r}; allowed: {rows} rows of {columns} numbers")
        return np.array([[self._finite(key, v) for v in row] for row in given])

    def node(self, key: str) -> Node:
        """Return an object that must be there."""
        value = self.raw(key)
        if not isinstance(value, dict):
            raise self.fail(key, f"got {value!r}; allowed: an object {{...}}")
        return self._child(cast(dict[str, Any], value), self.place(key))

    def nodes(self, key: str) -> list[Node]:
        """Return a list of objects, empty where there is none."""
        value = self.raw(key)
        if value is None:
            return []
        given: list[Any] = cast(list[Any], value) if isinstance(value, list) else [None]
        if not all(isinstance(item, dict) for item in given):
            raise self.fail(key, f"got {value!r}; allowed: a list of objects")
        return [self._child(item, f"{self.place(key)}[{i}]") for i, item in enumerate(given)]

    def without_use(self, *keys: str) -> None:
        """Say that these are known, and have no counterpart in a simulation."""
        for key in keys:
            if key in self:
                self.idle.append(self.place(key))
                self._read.add(_plain(key))

    def all_idle(self) -> list[str]:
        """Return what is known and not used, of this object and those inside."""
        return [*self.idle, *(place for node in self._inside for place in node.all_idle())]

    def unknown(self) -> list[str]:
        """Return the entries that nobody asked for, of this object and those inside."""
        own = [
            f"{self.path}.{spelled}".strip(".")
            for key, (spelled, _) in self._data.items()
            if key not in self._read and key not in MARKS
        ]
        return [*own, *(place for node in self._inside for place in node.unknown())]

    def _child(self, data: Mapping[str, Any], path: str) -> Node:
        node = Node(data, self.file, path)
        self._inside.append(node)
        return node

    def _finite(self, key: str, value: Any) -> float:
        if value is None:
            raise self.fail(key, "is missing; a number is needed")
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
        ):
            raise self.fail(key, f"got {value!r}; allowed: a finite number")
        return float(value)


def read_json(path: Path) -> Node:
    """Return the root of a JSON file, comments left out.

    Raises:
        DescriptionError: it cannot be read, is no JSON (line and column are named), holds no
            object, or gives a key twice
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        raise DescriptionError(str(path), "", f"cannot be read: {problem}") from problem

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        seen: dict[str, str] = {}
        for key, _ in pairs:
            if _plain(key) in seen:
                raise DescriptionError(
                    str(path),
                    key,
                    f"is given twice (before as {seen[_plain(key)]!r}); allowed: once",
                )
            seen[_plain(key)] = key
        return dict(pairs)

    try:
        data = json.loads(_without_comments(text), object_pairs_hook=once)
    except json.JSONDecodeError as problem:
        where = f"line {problem.lineno} column {problem.colno}"
        raise DescriptionError(str(path), "", f"is not JSON: {problem.msg} ({where})") from problem
    except RecursionError as problem:
        raise DescriptionError(str(path), "", "is not JSON: nested too deeply") from problem
    if not isinstance(data, dict):
        raise DescriptionError(str(path), "", "holds no object; allowed: {...} at the top")
    return Node(cast(dict[str, Any], data), str(path))


def _plain(key: str) -> str:
    return key.lower().replace("-", "_")


def _without_comments(text: str) -> str:
    """Put blanks where comments are, so that lines and columns stay."""
    out, at, inside = list(text), 0, False
    while at < len(text):
        if text[at] == "\\" and inside:
            at += 2
            continue
        if text[at] == '"':
            inside = not inside
        elif not inside and text.startswith(("//", "/*"), at):
            ends = text.find("\n", at) if text[at + 1] == "/" else text.find("*/", at + 2) + 2
            stop = len(text) if ends < at + 2 else ends
            for k in range(at, stop):
                out[k] = "\n" if text[k] == "\n" else " "
            at = stop
            continue
        at += 1
    return "".join(out)
