"""Checks of input: files bounded in size, nesting and numbers, and arguments of public calls."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import EllipsisType
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError

Kind = TypeVar("Kind")

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


def shown(value: object) -> str:
    """Return a value as messages show it: in one line, and not long."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        text = "a very large number"
    text = " ".join(text.split())
    return text if len(text) <= 200 else f"{text[:160]}...{text[-37:]}"


def got(value: object, allowed: str) -> str:
    """Return the message about a value that is not allowed."""
    return f"got {shown(value)}; allowed: {allowed}"


def excess_of(document: object) -> str:
    """Return the excess of a document of TOML, JSON or YAML, "" within bounds."""
    left: list[tuple[Iterable[object], int]] = [((document,), -1)]
    while left:
        values, level = left.pop()
        for value in values:
            if isinstance(value, str | float):
                continue
            if isinstance(value, int):
                if not INTEGERS[0] <= value <= INTEGERS[1]:
                    return "has an integer of more than 64 bits"
            elif isinstance(value, dict | list) and value:
                if level + 1 >= MOST_LEVELS:
                    return f"is nested too deeply; allowed: {MOST_LEVELS} levels"
                inner = cast(Any, value)
                left.append((inner.values() if isinstance(value, dict) else inner, level + 1))
    return ""


def check_numbers(
    value: object,
    shape: tuple[int | EllipsisType, ...],
    name: str,
    low: float = -np.inf,
    high: float = np.inf,
) -> NDArray[np.float64]:
    """Return finite numbers of a shape as float64.

    Args:
        value: anything
        shape: (4, 4); () of a single number; -1 of any length but 0; ... of any axes before
        name: of the value, for the message
        low, high: what each number may be

    Raises:
        InputError: something else; what was got and what is allowed
    """
    try:
        given = np.asarray(value)
        found = given.astype(np.float64) if given.dtype.kind in "iuf" else np.full((), np.nan)
    except (TypeError, ValueError, OverflowError):
        found = np.full((), np.nan)
    open_ = shape[:1] == (...,)
    own = shape[1:] if open_ else shape
    sizes = found.shape[len(found.shape) - len(own) :] if open_ else found.shape
    fits = len(sizes) == len(own) and all(
        size == one or (one == -1 and size) for size, one in zip(sizes, own, strict=True)
    )
    if fits and np.isfinite(found).all() and (found >= low).all() and (found <= high).all():
        return found
    words = ["..." if one is ... else "n" if one == -1 else str(one) for one in shape]
    what = f"{' x '.join(words)} finite numbers" if shape else "a finite number"
    least = f" from {low:g}" if low > -np.inf else ""
    most = f" up to {high:g}" if high < np.inf else ""
    raise InputError(f"{name}: {got(value, f'{what}{least}{most}')}")


def check_whole(value: object, name: str, low: int = 0, high: int = 2**31 - 1) -> int:
    """Return a whole number within bounds.

    Raises:
        InputError: something else
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise InputError(f"{name}: {got(value, 'a whole number')}")
    whole = int(cast(int, value))
    if not low <= whole <= high:
        raise InputError(f"{name}: {got(cast(object, value), f'{low} to {high}')}")
    return whole


def check_type(value: object, kind: type[Kind], name: str) -> Kind:
    """Return a value of a type.

    Raises:
        InputError: one of another type
    """
    if not isinstance(value, kind):
        raise InputError(f"{name}: {got(value, f'of type {kind.__name__}')}")
    return value
