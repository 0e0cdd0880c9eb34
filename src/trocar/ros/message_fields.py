"""Values out of messages, checked: the only place where a field of a message is looked at.

Messages are nested dicts of plain values, however they came. Whatever is in them, a function here
returns the checked value or raises `RefusedError`.
"""

# Fields of messages are of any type, and casts would cost time on the way of set-points.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError
from trocar.simulation.control import LARGEST

Array = NDArray[np.float64]
Message = Mapping[str, Any]

#: A vector that is longer is not looked at. Source: our own choice.
LONGEST = 256
#: Reject quaternions that are shorter: their direction is unknown. Source: our own choice; the
#: dVRK ignores one of zeros without a message.
SHORTEST_QUATERNION = 1e-6
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


class DoubtfulError(InputError):
    """A message that is taken as the robot's own software takes it, with a warning.

    Attributes:
        message: the message as it is taken
    """

    def __init__(self, message: Message, reason: str) -> None:
        self.message = message
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
        RefusedError: another type, or not finite
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
        RefusedError: not text, or too long
    """
    value = field(message, path)
    if not isinstance(value, str):
        raise RefusedError("type", f"got {path} {shown(value)}; allowed: a string")
    if len(value) > LONGEST_TEXT:
        raise RefusedError(
            "length",
            f"got {path} of {len(value)} characters; allowed: up to {LONGEST_TEXT}",
        )
    return value


def vector(message: Any, name: str) -> Array:
    """Return a list of finite numbers, (n,).

    Raises:
        RefusedError: no list of finite numbers, or too long
    """
    try:
        value = message[name]
    except (KeyError, TypeError, IndexError):
        raise RefusedError("field", f"{name} is missing") from None
    array = type(value) is np.ndarray and value.ndim == 1
    items = value.tolist() if array else value
    if not isinstance(items, (list, tuple)):
        raise RefusedError("type", f"got {name} {shown(value)}; allowed: a list of numbers")
    numbers: Sequence[object] = items
    if len(numbers) > LONGEST:
        got = f"got {len(numbers)} numbers in {name}"
        raise RefusedError("shape", f"{got}; allowed: up to {LONGEST}")
    for item in numbers:
        if type(item) is not float or not -LARGEST <= item <= LARGEST:  # the usual case, quickly
            break
    else:
        return value if array and value.dtype == np.float64 else np.array(numbers, dtype=np.float64)
    for i, item in enumerate(numbers):
        _finite(item, f"{name}[{i}]")
    return np.array(numbers, dtype=np.float64)


def joints(message: Any, field: str, names: Sequence[str]) -> Array:
    """Return one number per joint in the arm's order, (n,).

    Numbers count by their position; names do not, as programs of cisst write "0", "1", ...
    Source: cisst-ros 73aca61, mtsCISSTToROS.cpp:436 and mtsROSToCISST.cpp:290; that a longer list
    is cut: recorded answers of the dVRK's software, move_jp and servo_jp with 7 values.

    Raises:
        RefusedError: too few numbers
        DoubtfulError: too many numbers, or the arm's own names in another order
    """
    values, count = vector(message, field), len(names)
    if len(values) < count:
        raise RefusedError(
            "shape",
            f"got {len(values)} numbers in {field}; allowed: {count}, for {', '.join(names)}",
        )
    given = message.get("name")
    if len(values) > count:
        raise DoubtfulError(
            {**message, field: values[:count], "name": ()},
            f"got {len(values)} numbers in {field}; used: the first {count},"
            f" for {', '.join(names)}",
        )
    if given is None or (type(given) is list and not given):
        return values
    order = _names(given)
    if order != list(names) and sorted(order) == sorted(names):
        raise DoubtfulError(
            {**message, "name": ()},
            f"got joints {shown(order)}; names are ignored, numbers are for {', '.join(names)}",
        )
    return values


def joints_or_none(message: Any, field: str, names: Sequence[str]) -> Array | None:
    """Return as `joints` does, None where the list is empty or missing."""
    mapping = type(message) is dict or isinstance(message, Mapping)
    value: Any = message.get(field) if mapping else None
    if value is None or (hasattr(value, "__len__") and len(value) == 0):
        return None
    return joints(message, field, names)


def point(message: object, path: str) -> Array:
    """Return x, y, z, (3,).

    Raises:
        RefusedError: one of them is no number
    """
    inner = field(message, path)
    return np.array([number(inner, axis, path) for axis in "xyz"])


def rotation(message: object, path: str) -> Array:
    """Return the matrix of a quaternion, which is normalised, (3, 3).

    Args:
        message: has x, y, z, w under `path`; "" for the message itself

    Raises:
        RefusedError: its norm is 0
    """
    turn = field(message, path) if path else message
    return np.array(_rows(turn, path))


def pose(message: object, path: str) -> Array:
    """Return a pose, (4, 4) [m]; its quaternion is normalised.

    Raises:
        RefusedError: another type, not finite, or a quaternion of norm 0
    """
    turned, moved = f"{path}.orientation", f"{path}.position"
    turn, move = field(message, turned), field(message, moved)
    rows = _rows(turn, turned)
    T = [[*row, number(move, axis, moved)] for row, axis in zip(rows, "xyz", strict=True)]
    return np.array([*T, [0.0, 0.0, 0.0, 1.0]])


def wrench(message: object, path: str) -> Array:
    """Return (force; torque), (6,) [N, N m].

    Raises:
        RefusedError: one of them is no number
    """
    return np.concatenate([point(message, f"{path}.force"), point(message, f"{path}.torque")])


def button(message: object) -> int:
    """Return the first button of a Joy: 0 released, 1 pressed, 2 tapped.

    Raises:
        RefusedError: no button, or another value
    """
    value = field(message, "buttons")
    if isinstance(value, np.ndarray):
        value = cast(object, value.tolist())
    first = cast(Sequence[object], value)[0] if isinstance(value, (list, tuple)) and value else None
    if isinstance(first, int) and not isinstance(first, bool) and 0 <= first <= 2:
        return first
    raise RefusedError(
        "button",
        f"got buttons {shown(cast(object, value))}; allowed: [0] released, [1] pressed, [2] tapped",
    )


def stamp(message: Any) -> tuple[int, int] | None:
    """Return the stamp of a message, (s, ns); None without a header or with a stamp of zero.

    Raises:
        RefusedError: it is no time
    """
    try:
        value = message["header"]["stamp"]
    except (KeyError, TypeError, IndexError):
        return None
    if value is None:
        return None
    pair: Sequence[object] = value if isinstance(value, (tuple, list)) else ()
    if len(pair) == 2:
        sec, nanosec = pair
        if type(sec) is int and type(nanosec) is int and sec >= 0 and nanosec >= 0:
            return (sec, nanosec) if sec or nanosec else None
    raise RefusedError(
        "stamp", f"got a stamp {shown(cast(object, value))}; allowed: (seconds, nanoseconds)"
    )


def shown(value: object) -> str:
    """Return a value as text that is never long."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {cast('NDArray[Any]', value).shape}"
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
        raise RefusedError("type", f"got {path} {shown(cast(object, value))}; allowed: a number")
    number: Any = value
    if not abs(number) <= LARGEST:  # NaN is not either
        raise RefusedError(
            "number", f"got {path} {shown(number)}; allowed: finite, magnitude up to {LARGEST:g}"
        )
    return float(number)


def _names(given: Any) -> list[str]:
    if isinstance(given, (list, tuple)):
        held: Sequence[object] = given
        names = [name for name in held if isinstance(name, str)]
        if len(names) == len(held) <= LONGEST:
            return names
    raise RefusedError("names", f"got name {shown(cast(object, given))}; allowed: joint names")


def _rows(turn: object, path: str) -> list[list[float]]:
    """Return the rows of the matrix of a quaternion, which the robot normalises, too.

    In plain numbers: this is done for every message of a stream, and arrays of four are slow.
    """
    x, y, z, w = (number(turn, axis, path) for axis in "xyzw")
    length = sqrt(x * x + y * y + z * z + w * w)
    if length < SHORTEST_QUATERNION:
        raise RefusedError(
            "quaternion",
            f"got {path or 'a quaternion'} of norm {length:.4g}; allowed: above 0, preferably 1",
        )
    x, y, z, w = x / length, y / length, z / length, w / length
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
