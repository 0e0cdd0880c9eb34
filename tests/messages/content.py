"""Random messages of any type, and ROS's own bytes for them, as `rosbags` writes them."""

from __future__ import annotations

import inspect
import random
import string
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

from trocar.messages import (
    Field,
    MessageType,
    message_names,
    message_type,
    service_names,
    service_type,
)
from trocar.messages.types import RANGES

ALL = [
    *map(message_type, message_names()),
    *(
        half
        for n in service_names()
        for half in (service_type(n).request, service_type(n).response)
    ),
]
# Every length modulo eight, so that each alignment occurs.
LETTERS = string.ascii_letters + "äß漢🦾"


def each_type(kinds: list[MessageType] = ALL) -> Callable[[Callable[..., None]], Callable]:
    """Call a test with every kind of message; the first failure names its kind."""

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @wraps(test)
        def every(**fixtures: Any) -> None:
            for kind in kinds:
                try:
                    test(kind=kind, **fixtures)
                except Exception as problem:
                    problem.add_note(f"kind: {kind.name}")
                    raise

        given = inspect.signature(test)
        others = [one for name, one in given.parameters.items() if name != "kind"]
        every.__signature__ = given.replace(parameters=others)  # type: ignore[attr-defined]
        return every

    return decorate


def random_message(kind: str | MessageType, rng: random.Random) -> dict[str, Any]:
    fields = [field for field in message_type(kind).fields if not field.only_ros1]
    return {field.name: random_field(field, rng) for field in fields}


def random_field(field: Field, rng: random.Random) -> Any:
    if field.length is None:
        return random_value(field.type, rng)
    length = field.length or rng.choice([0, 0, 1, 2, 3, 7, 70])
    values = [random_value(field.type, rng) for _ in range(length)]
    if field.type == "float64" and rng.random() < 0.7:
        return np.array(values)
    return bytes(values) if field.type == "uint8" else values


def random_value(kind: str, rng: random.Random) -> Any:
    if "/" in kind:
        return random_message(kind, rng)
    if kind == "string":
        return "".join(rng.choices(LETTERS, k=rng.randrange(12)))
    if kind == "bool":
        return rng.random() < 0.5
    if kind in ("time", "duration"):
        return (rng.randrange(2**31), rng.randrange(10**9))
    if kind == "float32":
        return float(np.float32(rng.gauss(0, 1)))
    if kind == "float64":
        return rng.choice([rng.gauss(0, 1), 0.0, float("inf"), 1e-310])
    return rng.randint(*RANGES[kind])


def plain(value: Any) -> Any:
    """The same message with lists for arrays, so that `==` compares it."""
    if isinstance(value, dict):
        return {name: plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(entry) for entry in value] if isinstance(value, list) else value
