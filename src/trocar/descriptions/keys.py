"""Keys of TOML tables, declared on the fields of the records that are read from them.

A record is a frozen dataclass. A field with `field(metadata=key(...))` is read from a key of the
table: its type is the value's, `key` adds unit, bounds and choices, and the entry of the field in
the class's docstring is the help of the key. `Table.record` reads a record; `make docs` writes
docs/descriptions.md and the JSON schemas from the same fields.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

#: Key suffixes of each dimension and their factors to SI.
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "area": {"m2": 1.0, "mm2": 1e-6},
    "volume": {"m3": 1.0, "mm3": 1e-9},
    "mass": {"kg": 1.0, "g": 1e-3},
    "density": {"kg_per_m3": 1.0, "g_per_cm3": 1e3},
    "inertia": {"kgm2": 1.0},
    "torque": {"nm": 1.0},
    "force": {"n": 1.0},
    "pressure": {"pa": 1.0, "kpa": 1e3, "gpa": 1e9},
    "angular damping": {"nms": 1.0},
    "linear damping": {"ns_per_m": 1.0},
    "linear stiffness": {"n_per_m": 1.0},
    "angular stiffness": {"nm_per_rad": 1.0},
    "angular velocity": {"rad_s": 1.0, "deg_s": math.pi / 180.0},
    "linear velocity": {"m_s": 1.0},
    "angular acceleration": {"rad_s2": 1.0, "deg_s2": math.pi / 180.0},
    "linear acceleration": {"m_s2": 1.0},
    "position": {"rad_m": 1.0},
    "angular compliance": {"rad_per_nm": 1.0},
    "linear compliance": {"m_per_n": 1.0},
    "time": {"s": 1.0, "ms": 1e-3},
    "frequency": {"hz": 1.0},
}

#: Forms of values: a "name" is a text that is not empty, a "direction" a vector of any length,
#: "weights" are a table of numbers; the reader of the record checks "any".
Form = Literal[
    "text", "name", "texts", "flag", "number", "whole", "numbers", "direction", "weights", "any"
]
#: Forms of values by the type of their field; a Literal is a text of few choices.
FORMS: dict[object, Form] = {
    str: "text",
    bool: "flag",
    float: "number",
    int: "whole",
    np.ndarray: "numbers",
    tuple[str, ...]: "texts",
    tuple[float, ...]: "numbers",
    Mapping[str, float]: "weights",
}


@dataclass(frozen=True)
class Key:
    """A key of a table.

    Attributes:
        name: in the file, without the unit
        field: of the record
        form: of the value
        dimensions: whose units the key may end in, () for a number without a unit. With two of
            them, joints that turn have the first and those that slide the second
        choices: allowed texts, () for any
        size: of a list of numbers, None for any
        above, least, most: bounds of a number, or of each of a list, in SI; None: none
        shown: unit in which messages give a number and its bounds, "" for SI without a unit
        of: kinds of the table that have the key, () for all
        optional: whether the value is None without the key
        default: the value without the key; ...: the key must be there
        like: field whose value is the default, "" for none
        see: link to a page that has more, for the documentation
    """

    name: str
    field: str = ""
    form: Form = "text"
    dimensions: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()
    size: int | None = None
    above: float | None = None
    least: float | None = None
    most: float | None = None
    shown: str = ""
    of: tuple[str, ...] = ()
    optional: bool = False
    default: Any = ...
    like: str = ""
    see: str = ""

    @property
    def needed(self) -> bool:
        """Whether a table without the key is an error."""
        return not (self.optional or self.like) and self.default is ...

    @property
    def bounded(self) -> bool:
        """Whether a number has bounds."""
        return not (self.above is None and self.least is None and self.most is None)

    @property
    def allowed(self) -> str:
        """The bounds in words, as messages give them."""
        scale = self.scale
        low = self.above if self.least is None else self.least
        word = "" if low is None else f"{'' if self.above is None else 'above '}{low / scale:g}"
        if low is None and self.most is None:
            return "a whole number"
        if low is None and self.most is not None:
            return f"up to {self.most / scale:g}{self._unit}"
        if self.most is None and self.form == "whole" and self.least is not None:
            return f"{self.least:g}, {self.least + 1:g}, {self.least + 2:g} and so on"
        if self.most is None:
            return word if self.above is not None else f"{word} or more"
        return f"{word} to {self.most / scale:g}{self._unit}".strip()

    @property
    def scale(self) -> float:
        """SI value of the unit that messages show."""
        found = (f for units in UNITS.values() for s, f in units.items() if s == self.shown.lower())
        return next(found, 1.0)

    @property
    def _unit(self) -> str:
        return f" {self.shown}" if self.shown else ""

    def text_of(self, value: float) -> str:
        """Return a number as messages show it."""
        return f"{value / self.scale:g}{self._unit}"

    def spelled(self, turns: bool | None = None) -> tuple[str, ...]:
        """Return the dimensions of the key in a table of a kind.

        Args:
            turns: whether its joint turns; None: one or the other
        """
        if turns is None or len(self.dimensions) < 2:
            return self.dimensions
        return self.dimensions[:1] if turns else self.dimensions[1:]

    def fits(self, value: float) -> bool:
        """Return whether a number is within the bounds."""
        return not (
            (self.above is not None and value <= self.above)
            or (self.least is not None and value < self.least)
            or (self.most is not None and value > self.most)
        )


def key(*dimensions: str, **options: Any) -> Mapping[str, Any]:
    """Return the metadata of a field that is read from a key.

    Args:
        dimensions: whose units the key may end in
        options: attributes of `Key` that do not follow from the field
    """
    return {"key": {"dimensions": dimensions, **options}}


@lru_cache(maxsize=256)
def keys_of(record: type) -> tuple[Key, ...]:
    """Return the keys that a record is read from, in the order of its fields."""
    hints = get_type_hints(record)
    fields: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(record)
    return tuple(_key(one, hints[one.name]) for one in fields if "key" in one.metadata)


def _key(one: dataclasses.Field[Any], hint: Any) -> Key:
    options: dict[str, Any] = {"name": one.name, **one.metadata["key"]}
    optional = False
    if get_origin(hint) in (Union, UnionType):
        optional = NoneType in get_args(hint)
        hint = next(arg for arg in get_args(hint) if arg is not NoneType)
    if get_origin(hint) is Literal:
        options.setdefault("choices", get_args(hint))
        hint = str
    form = FORMS.get(hint) or FORMS.get(get_origin(hint), "any")
    default = ... if one.default is dataclasses.MISSING else one.default
    if one.default_factory is not dataclasses.MISSING:
        default = one.default_factory
    options = {"form": form, "default": default, **options}
    return Key(field=one.name, optional=optional and options["default"] is None, **options)


class KeySlot(NamedTuple):
    """A key of a kind of table, with the reader's data for every table."""

    key: Key
    field: str
    form: Form
    dimensions: tuple[str, ...]
    bounded: bool


class KeyLayout(NamedTuple):
    """The keys of a kind of table.

    Attributes:
        entries: {key with its unit: (slot, factor to SI)}
        defaults: {field: value without the key}
        factories: {field: makes the value without the key}
        alike: {field: field whose value it has without the key}
        needed: (slot, keys with its units) of which one must be there
    """

    entries: Mapping[str, tuple[KeySlot, float]]
    defaults: Mapping[str, Any]
    factories: Mapping[str, Callable[[], Any]]
    alike: Mapping[str, str]
    needed: tuple[tuple[KeySlot, tuple[str, ...]], ...]


@lru_cache(maxsize=1024)
def layout_of(record: type, of: str, turns: bool | None) -> KeyLayout:
    """Return the keys that a record is read from in a kind of table.

    Args:
        record: its class
        of: the kind
        turns: whether the table's joint turns; None: it has none, or either
    """
    entries, defaults, factories, alike = (dict[str, Any]() for _ in range(4))
    needed: list[tuple[KeySlot, tuple[str, ...]]] = []
    for one in keys_of(record):
        if one.of and of not in one.of:
            continue
        slot = KeySlot(one, one.field, one.form, one.spelled(turns), one.bounded)
        spelled = spellings(one.name, slot.dimensions) if slot.dimensions else ((one.name, 1.0),)
        entries |= {name: (slot, factor) for name, factor in spelled}
        if one.like:
            alike[one.field] = one.like
        elif one.default is ...:
            needed.append((slot, tuple(name for name, _ in spelled)))
        elif callable(one.default):
            factories[one.field] = one.default
        else:
            defaults[one.field] = one.default
    return KeyLayout(entries, defaults, factories, alike, tuple(needed))


@lru_cache(maxsize=4096)
def spellings(name: str, dimensions: tuple[str, ...]) -> tuple[tuple[str, float], ...]:
    """Return the keys that a quantity may have, and their factors to SI."""
    return tuple((f"{name}_{s}", f) for d in dimensions for s, f in UNITS[d].items())
