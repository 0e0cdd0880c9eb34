"""A Griffe extension: `q, qd: joint positions and velocities` documents two names, not one."""

from __future__ import annotations

import re
from typing import Any

import griffe

GROUP = re.compile(r"^( +)(\w+(?:, \w+)+): ((?:.*)(?:\n\1 +\S.*)*)", re.MULTILINE)


class GroupedNames(griffe.Extension):
    """Repeat the text of a group of names for each of them."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite an object's docstring before it is parsed."""
        if obj.docstring is not None:
            obj.docstring.value = GROUP.sub(_apart, obj.docstring.value)


def _apart(found: re.Match[str]) -> str:
    indent, names, text = found.groups()
    return "\n".join(f"{indent}{name}: {text}" for name in names.split(", "))
