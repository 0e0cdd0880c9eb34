"""Numbers and matrices out of a calibration file, by any of the names that tools give them."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.errors import DescriptionError

Array = NDArray[np.float64]


class Entries:
    """The map that a calibration file holds.

    Args:
        data: as `parse_yaml` returns it
        file: for messages
    """

    def __init__(self, data: dict[str, Any], file: str) -> None:
        self.file = file
        self.data = data

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def fail(self, key: str, problem: str) -> DescriptionError:
        """Return the error that names this file, the entry and what is wrong with it."""
        return DescriptionError(self.file, key, problem)

    def has(self, *keys: str) -> bool:
        """Tell whether there is an entry by one of these names."""
        return any(key in self.data for key in keys)

    def text(self, key: str, default: str) -> str:
        """Return a text."""
        value = self.data.get(key, default)
        return default if value is None else str(value)

    def whole(self, *keys: str) -> int:
        """Return a whole number above 0."""
        key, value = self._one(keys)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or value != round(value):
            raise self.fail(key, f"got {value!r}; allowed: a whole number")
        return int(value)

    def matrix(self, rows: int, columns: int, *keys: str) -> Array:
        """Return a matrix that is written as `rows, cols, data`, as rows, or as one list."""
        key, value = self._one(keys)
        found = self._numbers(key, value)
        if found.size != rows * columns:
            raise self.fail(key, f"got {found.size} numbers; allowed: {rows} x {columns}")
        return found.reshape(rows, columns)

    def numbers(self, *keys: str) -> Array:
        """Return a list or matrix of any size as (n,)."""
        key, value = self._one(keys)
        return self._numbers(key, value)

    def _one(self, keys: tuple[str, ...]) -> tuple[str, Any]:
        first, *others = keys
        for key in keys:
            if key in self.data:
                return key, self.data[key]
        told = ", ".join(str(key) for key in self.data) or "nothing"
        other = f" (or {', '.join(others)})" if others else ""
        raise self.fail(first, f"is missing{other}; the file has {told}")

    def _numbers(self, key: str, value: Any) -> Array:
        if isinstance(value, dict):
            table = cast(dict[str, Any], value)
            found = self._numbers(key, table.get("data"))
            rows, columns = table.get("rows", found.size), table.get("cols", 1)
            if not all(isinstance(n, int) for n in (rows, columns)):
                raise self.fail(key, f"got {rows!r} x {columns!r}; allowed: whole numbers")
            if "cols" in table and (rows, columns) != (0, 0) and rows * columns != found.size:
                raise self.fail(key, f"has {found.size} numbers, but says {rows} x {columns}")
            return found
        if not isinstance(value, list):
            raise self.fail(key, f"got {value!r}; allowed: a list or matrix of numbers")
        flat: list[Any] = []
        for item in cast(list[Any], value):
            flat.extend(cast(list[Any], item) if isinstance(item, list) else [item])
        for item in flat:
            wrong = isinstance(item, bool) or not isinstance(item, int | float)
            if wrong or not math.isfinite(item):
                raise self.fail(key, f"got {item!r}; allowed: finite numbers")
        return np.array(flat, dtype=np.float64)
