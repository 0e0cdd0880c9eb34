"""Input files, bounded in size, nesting and numbers: none takes all memory or minutes to read."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from trocar.errors import InputError

#: Tables and lists inside each other. Source: our own choice; our files have 4.
MOST_LEVELS = 64
#: Source: TOML 1.0, "Integer": 64 bits, signed.
INTEGERS = -(1 << 63), (1 << 63) - 1


def read_input(path: str | Path, most_bytes: int) -> bytes:
    """Return the content of a file.

    Raises:
        InputError: it is larger than `most_bytes`
        OSError: it cannot be read
    """
    with Path(path).expanduser().open("rb") as stream:
        data = stream.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise InputError(
            f"{path}: is larger than {1e-6 * most_bytes:g} MB; allowed: up to that size"
        )
    return data


def is_file(path: str | Path) -> bool:
    """Return whether there is such a file; no file has a name longer than its system allows."""
    try:
        return Path(path).is_file()
    except OSError:
        return False


def excess_of(document: object) -> str:
    """Return why a document of TOML, JSON or YAML is out of bounds, "" if it is not."""
    left = [(document, 0)]
    while left:
        value, level = left.pop()
        inner: list[Any] = []
        if isinstance(value, dict):
            inner = list(cast(dict[Any, Any], value).values())
        elif isinstance(value, list):
            inner = cast(list[Any], value)
        elif isinstance(value, int) and not INTEGERS[0] <= value <= INTEGERS[1]:
            return "has an integer of more than 64 bits"
        if inner and level >= MOST_LEVELS:
            return f"is nested too deeply; allowed: {MOST_LEVELS} levels"
        left += [(each, level + 1) for each in inner]
    return ""
