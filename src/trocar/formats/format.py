"""The formats: a module each, found by its `FORMAT`.

The command line reads the records from the sources and imports a module when its format is used.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from textwrap import dedent
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.formats.links import SourceModel

PACKAGE = "trocar.formats"


@dataclass(frozen=True)
class Format:
    """A format; all fields but `write` and `read` are literals.

    Attributes:
        title: "URDF: ROS, RViz, ..."
        order: place among the formats
        options: options of its export, a table for `cli.arguments.options`
        suffixes: endings of its files, lower-case
        root: root element, of a format in XML
        write: fills the folder of an `ExportTask` and returns warnings; keyword arguments are the
            options, with their defaults; None: it is not written
        read: returns the model of a file, with the folders to search for package://; None: it is
            not read
    """

    title: str
    order: int
    options: str = ""
    suffixes: tuple[str, ...] = ()
    root: str = ""
    write: Callable[..., tuple[str, ...]] | None = None
    read: Callable[[Path, tuple[Path, ...]], SourceModel] | None = None

    @property
    def option_names(self) -> tuple[str, ...]:
        """Names of the options, as keyword arguments: "sdf_version"."""
        found = re.findall(r"^(?:-\w,)?--([\w-]+)", dedent(self.options), re.MULTILINE)
        return tuple(name.replace("-", "_") for name in found)


def formats() -> dict[str, Format]:
    """Return the formats in their order, {name of the module: format}; no module is imported.

    `write` and `read` import their module when they are called.
    """
    folders = sys.modules[PACKAGE].__path__
    texts = {
        path.stem: path.read_text(encoding="utf-8")
        for folder in folders
        for path in Path(folder).glob("*.py")
    }
    found = {n: _format(n, text) for n, text in texts.items() if "\nFORMAT = Format(" in text}
    return dict(sorted(found.items(), key=lambda item: item[1].order))


def _format(name: str, source: str) -> Format:
    fields: dict[str, Any] = {}
    for statement in ast.parse(source).body:
        match statement:
            case ast.Assign(targets=[ast.Name(id="FORMAT")], value=ast.Call(keywords=keywords)):
                for keyword in keywords:
                    key = str(keyword.arg)
                    function = key in ("write", "read")
                    fields[key] = (
                        _deferred(name, key) if function else ast.literal_eval(keyword.value)
                    )
            case _:
                pass
    return Format(**fields)


def _deferred(name: str, function: str) -> Callable[..., Any]:
    def call(*arguments: Any, **options: Any) -> Any:
        found = import_module(f"{PACKAGE}.{name}").FORMAT
        return getattr(found, function)(*arguments, **options)

    return call
