"""TOML tables, read strictly and written: units from the key's suffix, unknown keys are errors."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import tomli_w
from numpy.typing import NDArray

from trocar.descriptions.keys import Key, layout_of, spellings
from trocar.errors import DescriptionError, InputError
from trocar.inputs import MOST_LEVELS, excess_of, got, read_input

Array = NDArray[np.float64]
Row = TypeVar("Row")
Record = TypeVar("Record")

#: The version of all files. Source: our own choice.
SCHEMA = 1
#: Source: our own choice, 70 times the largest of ours; tomllib reads 1 MB within about 2 s.
MOST_BYTES = 1_000_000
#: A dotted key of too many parts, for which tomllib takes time that grows with their square.
LONG_KEY = re.compile(
    r"""(?:(?:(?<![\w-])[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+)"""
    f"{{{MOST_LEVELS + 1}}}"
)
#: A list of numbers as tomli_w writes it, one on each line.
NUMBERS = re.compile(r"\[\n((?: *[-+.\w]+,\n)+) *\]")


class Entries(dict[str, Any]):
    """The entries of a table of a file that has a base, or of the base.

    Attributes:
        file, path: where the table stands
        inherited: {key: (file, path) of the table of the base that it stands in}
    """

    def __init__(self, data: Mapping[str, Any], file: str, path: str) -> None:
        super().__init__(data)
        self.file, self.path = file, path
        self.inherited: dict[str, tuple[str, str]] = {}


class Table:
    """A TOML table that remembers which keys were read, and where it stands in the file."""

    def __init__(self, data: Mapping[str, Any], file: str, path: str = "") -> None:
        self.file = file
        self.path = path
        self._inherited: Mapping[str, tuple[str, str]] = {}
        if isinstance(data, Entries):
            self.file, self.path, self._inherited = data.file, data.path, data.inherited
        self._data = data
        self._read: set[str] = set()

    def on(self, base: Table) -> Table:
        """Return this table on a base: every entry that it lacks is the base's.

        Tables are merged key by key, arrays of tables by the name of each, else by its frame; other
        values, and arrays in which two have the same name, are replaced. `drop = ["key"]` in a
        table takes entries of the base's away first. Errors name the file that an entry stands in.

        Raises:
            DescriptionError: `drop` lists a key that the base does not have
        """
        return Table(_merged(base._entries(), self._entries()), self.file, self.path)

    def document(self) -> dict[str, Any]:
        """Return all entries as TOML has them."""
        return dict(self._data)

    def fail(self, key: str, problem: str) -> DescriptionError:
        """Return the error that names the file, the place and what is wrong there.

        Args:
            key: of an entry; a quantity may be without its unit
            problem: what was got and what is allowed
        """
        found = key.partition(".")[0]
        if found not in self._data:
            found = next((k for k in self._data if k.startswith(f"{found}_")), found)
        file, path = self._inherited.get(found, (self.file, self.path))
        return DescriptionError(file, f"{path}.{key}".strip("."), problem)

    @property
    def asked(self) -> frozenset[str]:
        """The keys that were asked for, whether they are there or not."""
        return frozenset(self._read)

    def __contains__(self, key: str) -> bool:
        return key in self._data

    def without(self, *keys: str) -> Table:
        """Return this table as if these entries were not there."""
        rest = copy(self)
        rest._data = {k: v for k, v in self._data.items() if k not in keys}
        rest._read = set(self._read)
        return rest

    def raw(self, key: str, default: Any = None) -> Any:
        """Return an entry as TOML has it."""
        self._read.add(key)
        return self._data.get(key, default)

    def record(
        self,
        kind: type[Record],
        of: str = "",
        /,
        *,
        turns: bool | None = None,
        defaults: Mapping[str, Any] | None = None,
        choices: Mapping[str, Iterable[str]] | None = None,
        **given: Any,
    ) -> Record:
        """Return a record of the keys that its fields declare; see `values`."""
        return kind(
            **given,
            **self.values(kind, of, turns=turns, defaults=defaults, choices=choices, but=given),
        )

    def values(
        self,
        kind: type[Any],
        of: str = "",
        *,
        turns: bool | None = None,
        defaults: Mapping[str, Any] | None = None,
        choices: Mapping[str, Iterable[str]] | None = None,
        but: Iterable[str] = (),
    ) -> dict[str, Any]:
        """Return the values of the keys that the fields of a record declare, {field: value}.

        Args:
            kind: class of the record
            of: kind of the table; keys of other kinds are not read
            turns: whether the table's joint turns, for keys whose units depend on it
            defaults: {field: value without its key}, in place of the declared one
            choices: {field: allowed texts} that depend on other tables
            but: fields that are not read

        Raises:
            DescriptionError: a key is missing or wrong
        """
        layout = layout_of(kind, of, turns)
        values = {**layout.defaults, **(defaults or {})}
        seen: set[str] = set(but)
        for (key, field, _, dimensions, _), names in layout.needed:
            if field not in seen and field not in values and self._data.keys().isdisjoint(names):
                self._value(key, dimensions, ())  # raises: is missing
        for entry, value in self._data.items():
            if entry not in layout.entries:
                continue
            (key, field, form, dimensions, bounded), factor = layout.entries[entry]
            if field in seen:
                if field not in but:
                    self._one(key.name, dimensions, True)  # raises: given in two units
                continue
            seen.add(field)
            allowed = tuple(choices[field]) if choices and field in choices else key.choices
            # The usual values, without the calls that find what is wrong with others.
            if form == "text" and type(value) is str and (value in allowed or not allowed):
                values[field] = value.strip()
            elif form == "number" and type(value) in (float, int) and not bounded:
                values[field] = factor * self._finite(entry, value)
            else:
                values[field] = self._value(key, dimensions, allowed)
        for field, make in layout.factories.items():
            if field not in seen and field not in values:
                values[field] = make()
        for field, like in layout.alike.items():
            if field not in seen and field not in values:
                values[field] = values[like]
        if not but:
            self._read.update(layout.entries)
            return values
        entries = layout.entries.items()
        self._read.update(name for name, (slot, _) in entries if slot.field not in but)
        return {field: value for field, value in values.items() if field not in but}

    def _value(self, key: Key, dimensions: tuple[str, ...], choices: tuple[str, ...]) -> Any:
        """Return the value of a key in SI, within its bounds."""
        name = key.name
        if key.form == "text":
            return self.text(name, allowed=choices)
        if key.form in ("number", "whole"):
            value = self.quantity(name, *dimensions) if dimensions else self.number(name)
            if not key.fits(value) or (key.form == "whole" and value != int(value)):
                raise self.fail(name, f"got {key.text_of(value)}; allowed: {key.allowed}")
            return int(value) if key.form == "whole" else value
        if key.form == "numbers":
            found = self._one(name, dimensions, True) if dimensions else (name, 1.0)
            entry, factor = cast(tuple[str, float], found)
            numbers = factor * self.numbers(entry, key.size)
            if key.bounded and not all(map(key.fits, numbers.tolist())):
                raise self.fail(name, got(numbers.tolist(), key.allowed))
            return numbers
        if key.form == "weights":
            row = self.table(name)
            return {entry: row.number(entry) for entry in row.entries()}
        return READERS[key.form](self, name)

    def text(self, key: str, default: str | None = None, allowed: tuple[str, ...] = ()) -> str:
        """Return a string; without a default the key must be there."""
        value = self.raw(key, default)
        if value is None:
            raise self.fail(key, "is missing; a text is needed")
        if not isinstance(value, str):
            raise self.fail(key, got(value, "a text"))
        if allowed and value not in allowed:
            raise self.fail(key, got(value, ", ".join(allowed)))
        return value.strip()

    def name(self, key: str = "name") -> str:
        """Return a text that is not empty."""
        found = self.text(key)
        if not found:
            raise self.fail(key, "got an empty text; allowed: a name")
        return found

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of strings, empty when absent."""
        value = self.raw(key, [])
        if not isinstance(value, list) or not all(
            isinstance(v, str) for v in cast(list[Any], value)
        ):
            raise self.fail(key, got(cast(object, value), "a list of texts"))
        return tuple(cast(list[str], value))

    def flag(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self.raw(key, default)
        if not isinstance(value, bool):
            raise self.fail(key, got(value, "true, false"))
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """Return a finite number without a unit."""
        value = self.raw(key, default)
        if value is None:
            raise self.fail(key, "is missing; a number is needed")
        return self._finite(key, value)

    def has(self, name: str, *dimensions: str) -> bool:
        """Return whether `name` is given in any unit of these dimensions."""
        return bool(self._keys(name, dimensions))

    def quantity(self, name: str, *dimensions: str, default: float | None = None) -> float:
        """Return `name` in SI, whatever unit its key carries."""
        found = self._one(name, dimensions, default is None)
        if found is None:
            return cast(float, default)
        key, factor = found
        return factor * self._finite(key, self.raw(key))

    def positive(self, name: str, *dimensions: str, default: float | None = None) -> float:
        """Return `name` in SI, which must be above 0."""
        value = self.quantity(name, *dimensions, default=default)
        if value <= 0.0:
            raise self.fail(name, f"got {value:g}; allowed: above 0")
        return value

    def not_negative(self, name: str, *dimensions: str, default: float = 0.0) -> float:
        """Return `name` in SI, which must be 0 or more."""
        value = self.quantity(name, *dimensions, default=default)
        if value < 0.0:
            raise self.fail(name, f"got {value:g}; allowed: 0 or more")
        return value

    def vector(self, name: str, size: int, *dimensions: str, default: Array | None = None) -> Array:
        """Return a list of `size` numbers in SI, (size,)."""
        found = self._one(name, dimensions, default is None)
        if found is None:
            return cast(Array, default)
        key, factor = found
        return factor * self.numbers(key, size)

    def numbers(
        self, key: str, size: int | None = None, default: Sequence[float] | None = None
    ) -> Array:
        """Return a list of finite numbers, (size,)."""
        return self._numbers(key, self.raw(key, default), size)

    def direction(self, key: str, default: Array | None = None) -> Array:
        """Return a unit vector along three numbers, (3,)."""
        value = self.raw(key)
        if value is None and default is not None:
            return default
        given = self._numbers(key, value, 3)
        length = float(np.linalg.norm(given))
        if length < 1e-6:
            raise self.fail(key, got(given.tolist(), "a direction"))
        return given / length

    def within(self, key: str, lower: Array, upper: Array) -> Array:
        """Return joint positions inside limits, (n,) [rad or m]."""
        q = self.numbers(key, len(lower))
        if (q < lower).any() or (q > upper).any():
            raise self.fail(key, got(q.tolist(), f"{lower.tolist()} to {upper.tolist()}"))
        return q

    def known(self, key: str, name: str, known: Iterable[str], why: str = "") -> str:
        """Return a name that an entry has, which must be one of those known."""
        names = tuple(known)
        if name not in names:
            reason = f"; {why}" if why else ""
            raise self.fail(key, f"got {name!r}{reason}; allowed: {', '.join(names) or 'none'}")
        return name

    def _numbers(self, key: str, value: Any, size: int | None) -> Array:
        expected = "numbers" if size is None else f"{size} numbers"
        if not isinstance(value, list) or (
            size is not None and len(cast(list[Any], value)) != size
        ):
            raise self.fail(key, got(cast(object, value), f"a list of {expected}"))
        return np.array([self._finite(key, v) for v in cast(list[Any], value)], dtype=np.float64)

    def matrix(self, key: str, rows: int, columns: int) -> Array:
        """Return a list of rows as an array, (rows, columns)."""
        value = self.raw(key)
        if not isinstance(value, list) or len(cast(list[Any], value)) != rows:
            raise self.fail(key, got(cast(object, value), f"{rows} rows of {columns} numbers"))
        return np.stack([self._numbers(key, row, columns) for row in cast(list[Any], value)])

    def table(self, key: str) -> Table:
        """Return a sub-table that must be there."""
        value = self.raw(key)
        if value is None:
            raise self.fail(key, "is missing; a table is needed")
        if not isinstance(value, dict):
            raise self.fail(key, got(value, "a table"))
        return Table(cast(dict[str, Any], value), self.file, f"{self.path}.{key}".strip("."))

    def optional_table(self, key: str) -> Table:
        """Return a sub-table, an empty one when absent."""
        if key in self:
            return self.table(key)
        self.raw(key)
        return Table({}, self.file, f"{self.path}.{key}".strip("."))

    def tables(self, key: str) -> list[Table]:
        """Return a list of sub-tables, empty when absent."""
        value = self.raw(key, [])
        rows: list[Any] = cast(list[Any], value) if isinstance(value, list) else [None]
        if not all(isinstance(row, dict) for row in rows):
            raise self.fail(key, got(cast(object, value), f"[[{key}]] tables"))
        where = f"{self.path}.{key}".strip(".")
        return [Table(row, self.file, f"{where}[{i}]") for i, row in enumerate(rows)]

    def each(self, key: str, read: Callable[[Table], Row], again: str = "") -> tuple[Row, ...]:
        """Return the result of `read` for each of a list of sub-tables; it need not call `done`.

        Args:
            key: of the list, which may be absent
            read: reads one
            again: an attribute of the results that no two may have alike
        """
        found: list[Row] = []
        for row in self.tables(key):
            made = read(row)
            row.done()
            if again and getattr(made, again) in [getattr(other, again) for other in found]:
                raise row.fail(again, f"got {getattr(made, again)!r} a second time")
            found.append(made)
        return tuple(found)

    def named(self, key: str, read: Callable[[Table], Row]) -> dict[str, Row]:
        """Return {name: result of `read`} of the tables in a sub-table, as `each` does."""
        rows = self.optional_table(key)
        found: dict[str, Row] = {}
        for name in rows.entries():
            row = rows.table(name)
            found[name] = read(row)
            row.done()
        rows.done()
        return found

    def entries(self) -> list[str]:
        """Return the keys that were not read yet, `source` apart."""
        return [key for key in self._data if key not in self._read and key != "source"]

    def check_schema(self, of: str = "") -> None:
        """Reject a file of another version, or of another kind than `of`."""
        if self.raw("schema") != SCHEMA:
            raise self.fail("schema", got(self.raw("schema"), f"{SCHEMA}{of}"))

    def done(self) -> None:
        """Reject unknown keys; every table may have a `source`.

        Raises:
            DescriptionError: naming the unknown key and those that this table knows
        """
        if "source" not in self._read:
            self.text("source", "")
        if self._data.keys() <= self._read:
            return
        for key in self.entries():
            near = get_close_matches(key[:200], self._read, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            known = ", ".join(sorted(self._read))
            raise self.fail(key, f"unknown key; this table knows: {known}{hint}")

    def _entries(self) -> Entries:
        made = Entries(_placed(dict(self._data), self.file, self.path), self.file, self.path)
        made.inherited = dict(self._inherited)
        return made

    def _keys(self, name: str, dimensions: tuple[str, ...]) -> list[tuple[str, float]]:
        spelled = spellings(name, dimensions)
        self._read.update(key for key, _ in spelled)
        return [pair for pair in spelled if pair[0] in self._data]

    def _one(
        self, name: str, dimensions: tuple[str, ...], needed: bool
    ) -> tuple[str, float] | None:
        found = self._keys(name, dimensions)
        if needed and not found:
            spelled = ", ".join(key for key, _ in spellings(name, dimensions))
            raise self.fail(name, f"is missing; allowed keys: {spelled}")
        if len(found) > 1:
            raise self.fail(found[1][0], f"contradicts {found[0][0]}; give one of them")
        return found[0] if found else None

    def _finite(self, key: str, value: Any) -> float:
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not math.isfinite(value)
        ):
            raise self.fail(key, got(value, "a finite number"))
        return float(value)


READERS: Mapping[str, Callable[[Table, str], Any]] = {
    "name": Table.name,
    "texts": Table.texts,
    "flag": lambda table, key: table.flag(key, False),
    "direction": Table.direction,
    "any": Table.raw,
}


def read_table(path: Path) -> Table:
    """Return the root table of a TOML file.

    Raises:
        DescriptionError: the file is not there, or is not TOML; line and column are named
        InputError: it is larger than MOST_BYTES
    """
    try:
        text = read_input(path, MOST_BYTES).decode()
    except (OSError, UnicodeDecodeError) as problem:
        raise DescriptionError(str(path), "", f"cannot be read: {problem}") from problem
    return parse_table(text, str(path))


def parse_table(text: str, file: str) -> Table:
    """Return the root table of the text of a TOML file.

    Raises:
        DescriptionError: it is not TOML; line and column are named
    """
    # The expression takes as long as a fifth of reading the file: only lines of many dots need it.
    if any(line.count(".") > MOST_LEVELS and LONG_KEY.search(line) for line in text.splitlines()):
        raise DescriptionError(file, "", f"is nested too deeply; allowed: {MOST_LEVELS} levels")
    try:
        document = tomllib.loads(text)
    except RecursionError as problem:
        raise DescriptionError(file, "", "is not TOML: is nested too deeply") from problem
    except ValueError as problem:  # also an integer of thousands of digits
        raise DescriptionError(file, "", f"is not TOML: {problem}") from problem
    if excess := excess_of(document):
        raise DescriptionError(file, "", excess)
    return Table(document, file)


def _placed(value: Any, file: str, path: str) -> Any:
    """Return a value in which each table has its place in the file."""
    if isinstance(value, Entries):
        return value
    if isinstance(value, Mapping):
        entries = cast(Mapping[str, Any], value).items()
        inner = {k: _placed(v, file, f"{path}.{k}".strip(".")) for k, v in entries}
        return Entries(inner, file, path)
    if isinstance(value, list):
        rows = cast(list[Any], value)
        return [_placed(row, file, f"{path}[{i}]") for i, row in enumerate(rows)]
    return value


def _merged(base: Any, own: Any) -> Any:
    """Return a value on that of the base."""
    if isinstance(base, Entries) and isinstance(own, Entries):
        left = _without_dropped(base, own)
        merged = {k: _merged(left.get(k), v) for k, v in own.items() if k != "drop"}
        made = Entries({**left, **merged}, own.file, own.path)
        places = {k: base.inherited.get(k, (base.file, base.path)) for k in left}
        made.inherited = {k: place for k, place in places.items() if k not in merged}
        return made
    old, new = _by_name(base), _by_name(own)
    if old is None or new is None:
        return own
    return list({**old, **{k: _merged(old.get(k), row) for k, row in new.items()}}.values())


def _without_dropped(base: Entries, own: Entries) -> dict[str, Any]:
    """Return the entries of the base that a table does not drop."""
    if "drop" not in own:
        return dict(base)
    table = Table(own, own.file, own.path)
    gone = table.texts("drop")
    for key in gone:
        if key not in base:
            raise table.fail("drop", f"got {key!r}; allowed: {', '.join(base)}")
    return {k: v for k, v in base.items() if k not in gone}


def _by_name(rows: Any) -> dict[str, Entries] | None:
    """Return an array of tables by their names, else their frames; None when these do not do."""
    if not isinstance(rows, list):
        return None
    found = {
        str(row.get("name", row.get("frame"))): row
        for row in cast(list[Any], rows)
        if isinstance(row, Entries) and ("name" in row or "frame" in row)
    }
    return found if len(found) == len(cast(list[Any], rows)) else None


def toml_text(document: Mapping[str, Any]) -> str:
    """Return a document as TOML, vectors on one line; numbers come back to the last bit.

    Args:
        document: texts, numbers, true or false, lists, arrays and tables of these; entries that are
            None are left out

    Raises:
        InputError: a number that is not finite, or a value that TOML does not have; names the key
    """
    text = tomli_w.dumps(_plain(document, ""))
    return NUMBERS.sub(lambda found: f"[{', '.join(found[1].replace(',', ' ').split())}]", text)


def _plain(value: Any, where: str) -> Any:
    """Return a value without arrays and Nones."""
    if isinstance(value, np.ndarray | np.generic):
        value = cast(Any, value).tolist()
    if isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError(f"{where}: got {value}; allowed: a finite number")
        return value
    if isinstance(value, Mapping):
        entries = cast(Mapping[str, Any], value).items()
        return {k: _plain(v, f"{where}.{k}".strip(".")) for k, v in entries if v is not None}
    if isinstance(value, Sequence):
        return [_plain(v, where) for v in cast(Sequence[Any], value)]
    raise InputError(f"{where}: got {value!r}; allowed: texts, numbers, lists and tables")
