"""Entry points of installed packages: arms, tools, props, controllers and others.

A package registers a name in the group `trocar.KIND`, see docs/extending.md.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Literal

from trocar.errors import DescriptionError, InputError, UnknownNameError

Kind = Literal["arms", "tools", "rigs", "props", "scenes", "tasks", "controllers"]


@lru_cache
def registered(kind: Kind) -> dict[str, EntryPoint]:
    """Return the entry points that installed packages register, by name; import nothing.

    Raises:
        InputError: two packages register one name
    """
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=f"trocar.{kind}"):
        other = found.setdefault(entry.name, entry)
        if other.value != entry.value:
            raise InputError(
                f"entry points trocar.{kind}: got {entry.name!r} from {_package(other)} and from"
                f" {_package(entry)}; allowed: one of them installed"
            )
    return found


def load_registered(kind: Kind, name: str) -> Any:
    """Return the object that an installed package registers under a name.

    Raises:
        UnknownNameError: no package does; the known names are listed
        InputError: its package cannot be imported
    """
    known = registered(kind)
    if name not in known:
        raise UnknownNameError(kind[:-1], name, known)
    entry = known[name]
    try:
        return entry.load()
    except Exception as problem:
        raise InputError(
            f"entry point trocar.{kind} {name!r} of {_package(entry)}: cannot be loaded from"
            f" {entry.value}: {type(problem).__name__}: {problem}"
        ) from problem


def registered_file(kind: Kind, name: str, where: DescriptionError | None = None) -> Path:
    """Return the file that an installed package registers under a name.

    Args:
        kind: of the description
        name: as registered
        where: an error whose file and key name the place that asks, if it is in a file

    Raises:
        UnknownNameError, DescriptionError: no package does; the known names are listed
        InputError: its package cannot be imported, or what it registers is no path of a file
    """
    if where is not None and name not in registered(kind):
        known = ", ".join(registered(kind)) or "none is installed"
        raise DescriptionError(
            where.file,
            where.key,
            f"got {name!r}; allowed: the path of a TOML file, or a registered name: {known}",
        )
    found = load_registered(kind, name)
    if not isinstance(found, str | Path) or not Path(found).is_file():
        raise InputError(
            f"entry point trocar.{kind} {name!r} of {_package(registered(kind)[name])}: got"
            f" {found!r}; allowed: the path of a TOML file"
        )
    return Path(found)


def _package(entry: EntryPoint) -> str:
    return "an unnamed package" if entry.dist is None else f"the package {entry.dist.name}"
