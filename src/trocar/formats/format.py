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
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from trocar.formats.links import SourceModel
    from trocar.formats.meshes import ReadOptions

PACKAGE = "trocar.formats"
#: First line of a format's record in its source.
START = "\nFORMAT = Format("


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
        read: returns the model of a file, with `meshes.ReadOptions`; None: it is not read
    """

    title: str
    order: int
    options: str = ""
    suffixes: tuple[str, ...] = ()
    root: str = ""
    write: Callable[..., tuple[str, ...]] | None = None
    read: Callable[[Path, ReadOptions], SourceModel] | None = None

    @property
    def option_names(self) -> tuple[str, ...]:
        """Names of the options, as keyword arguments: "sdf_version"."""
        found = re.findall(r"^(?:-\w,)?--([\w-]+)", dedent(self.options), re.MULTILINE)
        return tuple(name.replace("-", "_") for name in found)


def formats() -> dict[str, Format]:
    """Return the formats in their order, {name of the module: format}; no module is imported.

    `write` and `read` import their module when they are called.
    """
    found: dict[str, Format] = {}
    for folder in sys.modules[PACKAGE].__path__:
        for path in Path(folder).glob("*.py"):
            _, start, record = path.read_text(encoding="utf-8").partition(START)
            if start:
                found[path.stem] = _format(path.stem, start + record)
    return dict(sorted(found.items(), key=lambda item: item[1].order))


def _format(name: str, source: str) -> Format:
    call = cast(ast.Call, cast(ast.Assign, ast.parse(source).body[0]).value)
    fields: dict[str, Any] = {}
    for keyword in call.keywords:
        key = str(keyword.arg)
        function = key in ("write", "read")
        fields[key] = _deferred(name, key) if function else ast.literal_eval(keyword.value)
    return Format(**fields)


def _deferred(name: str, function: str) -> Callable[..., Any]:
    def call(*arguments: Any, **options: Any) -> Any:
        record: Format = import_module(f"{PACKAGE}.{name}").FORMAT
        return getattr(record, function)(*arguments, **options)

    return call
