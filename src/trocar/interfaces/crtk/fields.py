"""Values out of messages, checked: the only place where a field of a message is looked at.

Messages are nested dicts of plain values, however they came. Whatever is in them, a function here
returns what was asked for or raises `RefusedError`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError

Array = NDArray[np.float64]
Message = Mapping[str, Any]

#: A number farther from zero is a mistake. Source: our own choice, far beyond every joint, pose,
#: effort and gain of the robot, and far below what arithmetic cannot hold.
LARGEST = 1e6
#: A vector that is longer is not looked at. Source: our own choice.
LONGEST = 256
#: Text that is kept or repeated is at most this long. Source: our own choice.
LONGEST_TEXT = 256
SHOWN = 80


class RefusedError(InputError):
    """A message that cannot be used.

    Attributes:
        kind: what is wrong with it in a word, the same for all that are wrong in that way
    """

    def __init__(self, kind: str, reason: str) -> None:
        self.kind = kind
        super().__init__(reason)


def field(message: object, path: str) -> Any:
    """Return a field, `path` such as "pose.position.x".

    Raises:
        RefusedError: it is not there
    """
    value = message
    for name in path.split("."):
        if (type(value) is not dict and not isinstance(value, Mapping)) or name not in value:
            raise RefusedError("field", f"{path} is missing")
        value = cast(Mapping[str, Any], value)[name]
    return value


def number(message: object, name: str, path: str = "") -> float:
    """Return a finite number; `path` leads to the message it is in, for the reason.

    Raises:
        RefusedError: it is none
    """
    where = f"{path}.{name}" if path else name
    if not isinstance(message, Mapping) or name not in message:
        raise RefusedError("field", f"{where} is missing")
    value = cast(Mapping[str, Any], message)[name]
    if type(value) is float and -LARGEST <= value <= LARGEST:  # the usual case, quickly
        return value
    return _finite(value, where)


def flag(message: object, path: str) -> bool:
    """Return whether a field is true.

    Raises:
        RefusedError: it is neither true nor false
    """
    value = field(message, path)
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    raise RefusedError("type", f"got {path} {shown(value)}; allowed: true or false")


def text(message: object, path: str) -> str:
    """Return a short text.

    Raises:
        RefusedError: it is none, or too long
    """
    value = field(message, path)
    if not isinstance(value, str):
        raise RefusedError("type", f"got {path} {shown(value)}; allowed: text")
    if len(value) > LONGEST_TEXT:
        raise RefusedError(
            "length",
            f"got {path} of {len(value)} characters; allowed: at most {LONGEST_TEXT}",
        )
    return value


def vector(message: object, path: str) -> Array:
    """Return a list of finite numbers, (n,).

    Raises:
        RefusedError: it is none, or too long
    """
    value = field(message, path)
    given = value.tolist() if isinstance(value, np.ndarray) and value.ndim == 1 else value
    if not isinstance(given, (list, tuple)):
        raise RefusedError("type", f"got {path} {shown(value)}; allowed: a list of numbers")
    items = cast(Sequence[Any], given)
    if len(items) > LONGEST:
        raise RefusedError(
            "shape", f"got {len(items)} numbers in {path}; allowed: at most {LONGEST}"
        )
    for i, value in enumerate(items):
        if type(value) is not float or not -LARGEST <= value <= LARGEST:  # the usual case, quickly
            _finite(value, f"{path}[{i}]")
    return np.array(items, dtype=np.float64)


def joints(message: object, path: str, names: Sequence[str]) -> Array:
    """Return one number per joint in the arm's order, (n,).

    Numbers come in the arm's order, or in that of the message's `name` where it has some.

    Raises:
        RefusedError: another count, or names of other joints
    """
    values = vector(message, path)
    if len(values) != len(names):
        raise RefusedError(
            "shape",
            f"got {len(values)} numbers in {path}; allowed: {len(names)}, for {', '.join(names)}",
        )
    told = _names(message)
    if not told or told == list(names):
        return values
    if sorted(told) != sorted(names):
        raise RefusedError(
            "names", f"got joints {shown(told)}; allowed: {', '.join(names)}, or none"
        )
    return values[[told.index(name) for name in names]]


def joints_or_none(message: object, path: str, names: Sequence[str]) -> Array | None:
    """Return as `joints` does, None where the list is empty or missing."""
    value = message.get(path) if isinstance(message, Mapping) else None  # pyright: ignore
    if value is None or (hasattr(value, "__len__") and len(value) == 0):
        return None
    return joints(message, path, names)


def button(message: object) -> int:
    """Return what the first button of a Joy does: 0 released, 1 pressed, 2 tapped.

    Raises:
        RefusedError: there is none, or it does something else
    """
    value = field(message, "buttons")
    if isinstance(value, np.ndarray):
        value = cast(object, value.tolist())
    first = cast(Sequence[object], value)[0] if isinstance(value, (list, tuple)) and value else None
    if isinstance(first, int) and not isinstance(first, bool) and 0 <= first <= 2:
        return first
    raise RefusedError(
        "button",
        f"got buttons {shown(value)}; allowed: [0] released, [1] pressed, [2] a quick tap",
    )


def stamp(message: object) -> tuple[int, int] | None:
    """Return when a message with a header was sent, (s, ns); None where it does not say.

    Raises:
        RefusedError: it is no time
    """
    header = message.get("header") if isinstance(message, Mapping) else None  # pyright: ignore
    value = header.get("stamp") if isinstance(header, Mapping) else None  # pyright: ignore
    if value is None:
        return None
    if (
        not isinstance(value, (tuple, list))
        or len(cast(Sequence[object], value)) != 2
        or not all(type(v) is int and v >= 0 for v in cast(Sequence[object], value))
    ):
        raise RefusedError("stamp", f"got a stamp {shown(value)}; allowed: (seconds, nanoseconds)")
    sec, nanosec = cast(Sequence[int], value)
    return (sec, nanosec) if sec or nanosec else None


def shown(value: object) -> str:
    """Return a value as text that is never long."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, (str, bytes, bytearray)):
        whole = repr(value[:SHOWN])
    elif isinstance(value, (list, tuple, dict, set)):
        held = cast(Sequence[object], value)
        whole = "[...]" if len(held) > 8 else f"[{', '.join(shown(v) for v in held)}]"
    elif isinstance(value, int) and abs(value) > LARGEST:
        whole = "a huge number"  # which may have more digits than Python likes to write
    else:
        whole = repr(value)
    return whole if len(whole) <= SHOWN else whole[:SHOWN] + "..."


def _finite(value: object, path: str) -> float:
    if isinstance(value, (bool, np.bool_)) or not isinstance(
        value, (int, float, np.integer, np.floating)
    ):
        raise RefusedError("type", f"got {path} {shown(value)}; allowed: a number")
    if not abs(value) <= LARGEST:  # NaN is not either
        raise RefusedError(
            "number", f"got {path} {shown(value)}; allowed: finite, at most {LARGEST:g} from 0"
        )
    return float(value)


def _names(message: object) -> list[str]:
    given = message.get("name") if isinstance(message, Mapping) else None  # pyright: ignore
    if given is None:
        return []
    if isinstance(given, (list, tuple)) and len(cast(Sequence[object], given)) <= LONGEST:
        names = list(cast(Sequence[object], given))
        if all(isinstance(name, str) for name in names):
            return cast(list[str], names)
    raise RefusedError("names", f"got name {shown(cast(object, given))}; allowed: names of joints")
