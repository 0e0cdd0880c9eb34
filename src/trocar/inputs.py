"""Input files, bounded in size, nesting and numbers: none takes all memory or minutes to read."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.errors import InputError

Array = NDArray[np.float64]

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


def numbers(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Return finite numbers of a shape as float64; one alone stands for a row of one.

    Raises:
        InputError: something else
    """
    try:
        found = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        found = np.full((), np.nan)
    if shape == (1,):
        found = np.atleast_1d(found)
    if found.shape != shape or not np.isfinite(found).all():
        what = f"{' x '.join(map(str, shape))} finite numbers" if shape else "a finite number"
        got = " ".join(repr(value).split())
        raise InputError(f"{name}: got {got:.200}; allowed: {what}")
    return found
