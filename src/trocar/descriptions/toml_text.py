"""Write TOML: the few kinds of values that trocar's own files have."""

from __future__ import annotations

import math
import os
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from trocar.errors import InputError

BARE = re.compile(r"[A-Za-z0-9_-]+")
ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r", "\t": "\\t"}


def value_text(value: Any, where: str) -> str:
    """Return a value as TOML has it; numbers come back to the last bit.

    Args:
        value: a text, number, true or false, or lists, arrays and tables of these
        where: its place in the file, for messages

    Raises:
        InputError: a number that is not finite, or a value that TOML has no word for
    """
    if isinstance(value, np.ndarray | np.generic):
        value = cast(Any, value).tolist()
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError(f"{where}: got {value}; allowed: a finite number")
        return repr(value)
    if isinstance(value, Mapping):
        entries = cast(Mapping[str, Any], value).items()
        inside = ", ".join(f"{key_text(k)} = {value_text(v, f'{where}.{k}')}" for k, v in entries)
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, Sequence):
        return f"[{', '.join(value_text(v, where) for v in cast(Sequence[Any], value))}]"
    raise InputError(f"{where}: got {value!r}; allowed: texts, numbers, lists and tables")


def key_text(key: str) -> str:
    """Return a key as TOML has it."""
    return key if BARE.fullmatch(key) else _quoted(key)


def write_whole(path: Path, text: str) -> None:
    """Write a file all at once: until it is whole, what was there before stays.

    Raises:
        InputError: the file cannot be written
    """
    beside = ""
    try:
        handle, beside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(beside, 0o666 & ~umask)
        os.replace(beside, path)
    except OSError as problem:
        if beside:
            Path(beside).unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem


def _quoted(text: str) -> str:
    inside = "".join(ESCAPES.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text)
    return f'"{inside}"'
