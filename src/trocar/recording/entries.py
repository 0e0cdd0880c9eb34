"""Commands and events as JSON, and back without losing a digit."""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.sensor_records import Contact
from trocar.descriptions.sensors import KINDS, ContactsReading
from trocar.errors import InputError
from trocar.simulation import State
from trocar.simulation.arm import ArmState, Expiry
from trocar.simulation.control import ControlState
from trocar.simulation.controllers import CartesianForce, CartesianImpedance, HalfPlaneGains
from trocar.simulation.grasps import Grasp, GraspState, Hold
from trocar.simulation.journal import Entry
from trocar.simulation.masters import GimbalLimits, OrientationLock, PlatformEffort
from trocar.simulation.moves import Drift, Profile
from trocar.simulation.tissue.contact import Held
from trocar.simulation.tissue.tissues import TissueState

#: Arrays with more numbers are written as the bytes of their numbers. Source: our own choice.
MOST_NUMBERS = 64
#: Keys that mark values without a form of their own in JSON.
ARRAY, NUMBER, RECORD, UNKNOWN = "$array", "$number", "$record", "$unknown"
TUPLE, SET, SLICE, BYTES = "$tuple", "$set", "$slice", "$bytes"
#: Records that commands take, and those in a saved state.
_CLASSES: set[type[Any]] = {
    *(CartesianForce, CartesianImpedance, HalfPlaneGains),
    *(GimbalLimits, OrientationLock, PlatformEffort),
    *(State, ArmState, ControlState, Drift, Expiry, Grasp, GraspState, Held, Hold, TissueState),
    *(Contact, ContactsReading, *(kind.reading for kind in KINDS.values())),
}
RECORDS: dict[str, type[Any]] = {kind.__name__: kind for kind in _CLASSES}


def entry_json(entry: Entry) -> bytes:
    """Return an entry as JSON."""
    values = {
        "period": entry.period,
        "time": entry.time,
        "kind": entry.kind,
        "source": entry.source,
        "name": entry.name,
        "values": {key: plain(value) for key, value in entry.values.items()},
    }
    return json.dumps(values, allow_nan=False).encode()


def entry_from_json(data: bytes) -> Entry:
    """Return the entry that `entry_json` wrote.

    Raises:
        InputError: the data are damaged
    """
    try:
        v: Mapping[str, Any] = json.loads(data)
        return Entry(
            int(v["period"]),
            float(v["time"]),
            v["kind"],
            str(v["source"]),
            str(v["name"]),
            {str(key): restored(value) for key, value in v["values"].items()},
        )
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"a command or event is damaged: {error}") from error


def plain(value: object) -> Any:
    """Return a value for JSON; arrays, records and numbers that are not finite are marked.

    What a record holds comes back with its type, other tuples come back as lists.
    """
    if isinstance(value, np.ndarray):
        return _array(cast(NDArray[Any], value))
    if isinstance(value, np.generic):
        return plain(cast(Any, value).item())
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {NUMBER: repr(value)}
    if isinstance(value, Path):
        return str(value)
    if type(value) in _CLASSES:
        try:
            return _record(value)
        except TypeError as error:
            return {UNKNOWN: f"a {type(value).__name__} with {error}"}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in cast(Mapping[object, object], value).items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in cast(list[object], value)]
    return {UNKNOWN: repr(value)[:200]}


def _record(value: object) -> Any:
    """Return a record, or a part of one, for JSON, with its type, on which motion may depend.

    Raises:
        TypeError: a file cannot hold it; the message is what it is
    """
    if isinstance(value, Profile):
        return {RECORD: Profile.__name__, "inputs": _record(value.__reduce__()[1])}
    if type(value) in _CLASSES:
        kind = type(value).__name__
        fields: dict[str, Any] = (
            cast(Any, value)._asdict() if isinstance(value, tuple) else vars(value)
        )
        return {RECORD: kind, **{k: _record(part) for k, part in fields.items()}}
    if isinstance(value, tuple | list | frozenset):
        parts = [_record(part) for part in cast(list[object], value)]
        mark = TUPLE if isinstance(value, tuple) else SET
        return parts if isinstance(value, list) else {mark: parts}
    if isinstance(value, slice):
        cut = cast(Any, value)
        return {SLICE: [_record(part) for part in (cut.start, cut.stop, cut.step)]}
    if isinstance(value, bytes):
        return {BYTES: base64.b64encode(value).decode()}
    if isinstance(value, Mapping):
        items = cast(Mapping[object, object], value).items()
        return {str(key): _record(part) for key, part in items}
    found = plain(value)
    marked: object = found
    if isinstance(marked, dict) and UNKNOWN in marked:
        raise TypeError(repr(value)[:200])
    return found


def restored(value: Any) -> Any:
    """Return a value from the result of `plain`.

    Raises:
        InputError: an array is damaged
        TypeError, ValueError, KeyError: a record or another marked value is
    """
    if isinstance(value, list):
        return [restored(v) for v in cast(list[Any], value)]
    if not isinstance(value, dict):
        return value
    known = cast(dict[str, Any], value)
    if len(known) == 1:
        ((mark, content),) = known.items()
        if mark in (TUPLE, SET, SLICE):
            kind: Any = {TUPLE: tuple, SET: frozenset}.get(mark)
            parts = restored(content)
            return slice(*parts) if kind is None else kind(parts)
        if mark == BYTES:
            return base64.b64decode(content, validate=True)
    if UNKNOWN in known:
        return Unknown(known[UNKNOWN])
    if NUMBER in known:
        return float(known[NUMBER])
    if ARRAY in known:
        return _restored_array(known)
    if known.get(RECORD) == Profile.__name__:
        return Profile(*restored(known["inputs"]))
    if known.get(RECORD) in RECORDS:
        fields = {key: restored(v) for key, v in known.items() if key != RECORD}
        return RECORDS[known[RECORD]](**fields)
    return {key: restored(v) for key, v in known.items()}


class Unknown:
    """Stands for an argument that a file cannot hold."""

    def __init__(self, what: str) -> None:
        self.what = what

    def __repr__(self) -> str:
        return self.what


def _array(value: np.ndarray[Any, Any]) -> Any:
    if value.dtype.kind not in "fiub":
        return {UNKNOWN: repr(value)[:200]}
    kind = value.dtype.newbyteorder("<").str if value.dtype.itemsize > 1 else value.dtype.str
    if value.size <= MOST_NUMBERS and np.isfinite(value).all():
        return {ARRAY: kind, "shape": list(value.shape), "values": value.ravel().tolist()}
    raw = np.ascontiguousarray(value, kind).tobytes()
    return {ARRAY: kind, "shape": list(value.shape), "base64": base64.b64encode(raw).decode()}


def _restored_array(known: Mapping[str, Any]) -> np.ndarray[Any, Any]:
    kind, shape = np.dtype(str(known[ARRAY])), [int(n) for n in known["shape"]]
    if kind.kind not in "fiub":
        raise InputError(f"an array of kind {kind}; allowed: numbers")
    if "values" in known:
        return np.array(known["values"], kind).reshape(shape)
    try:
        raw = base64.b64decode(known["base64"], validate=True)
    except binascii.Error as error:
        raise InputError(f"an array is damaged: {error}") from error
    return np.frombuffer(raw, kind).reshape(shape).copy()
