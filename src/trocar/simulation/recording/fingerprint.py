"""Whether two rigs are the same to the last digit, whichever file they were read from."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from trocar.descriptions.records import RigDescription

#: Fields that count only where they say something: rigs are older than these.
YOUNGER = {"movable"}
#: Fields that say where something was read or why, not what it is, and what only looks.
REMARKS = {"file", "source", "title", "calibration", "overlay", "cameras"}


def rig_fingerprint(rig: RigDescription) -> str:
    """Return a fingerprint of everything in a rig that motion depends on."""
    digest = hashlib.sha256()
    for piece in _pieces(rig):
        digest.update(piece)
    return digest.hexdigest()


def _pieces(value: object) -> list[bytes]:
    """Return what a value is made of, in an order that does not depend on the run."""
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value) if f.name not in REMARKS]
        found = [type(value).__name__.encode()]
        for name in fields:
            if name in YOUNGER and getattr(value, name) is None:
                continue
            found += [name.encode(), *_pieces(getattr(value, name))]
        return found
    if isinstance(value, np.ndarray):
        array = cast("np.ndarray[Any, Any]", value)
        return [str(array.shape).encode(), array.tobytes()]
    if isinstance(value, Mapping):
        items = cast(Mapping[object, object], value).items()
        ordered = sorted(((str(k), v) for k, v in items), key=lambda pair: pair[0])
        return [p for key, item in ordered for p in (key.encode(), b":", *_pieces(item))]
    if isinstance(value, list | tuple):
        return [b"[", *(p for v in cast(list[object], value) for p in _pieces(v)), b"]"]
    return [repr(value).encode(), b";"]
