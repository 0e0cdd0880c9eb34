"""Settings: values in place of those of a description's file, by the dotted paths of keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any, cast

from trocar.descriptions.table import Table, parse_table
from trocar.errors import DescriptionError, InputError

#: Keys by whose values a row of a list of tables is found, the first by which there is one row.
ROW_KEYS = ("name", "object", "arm", "kind")
#: The list whose rows a path may begin with.
PROPS = "prop"


def read_settings(texts: Iterable[str]) -> dict[str, Any]:
    """Return the values of texts KEY=VALUE, {path: value}.

    A value is TOML's (4, true, [1, 2], "text"); one that is not is a text.

    Raises:
        InputError: a text without a key, or a key twice
    """
    found: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not all(key.strip().split(".")):
            raise InputError(f"got {text!r}; allowed: KEY=VALUE, as pad.stitches=4")
        if key.strip() in found:
            raise InputError(f"got {key.strip()} a second time")
        try:
            found[key.strip()] = parse_table(f"value = {value}", key).raw("value")
        except DescriptionError:
            found[key.strip()] = value.strip()
    return found


def changed(table: Table, settings: Mapping[str, Any]) -> Table:
    """Return a file's root table with other values; its reader checks them as those of the file.

    A path has keys and, for rows of lists of tables, their names, else their kinds or numbers:
    "time_limit_s", "prop.pad.stitches", "place.needle.turn_deg", "goal.0.radius_mm". It may leave
    "prop" out: "pad.stitches", "tissue.stitches".

    Raises:
        InputError: a path that leads nowhere; the known parts are listed
    """
    document = deepcopy(table.document())
    for path, value in settings.items():
        *parents, last = path.split(".")
        place: Any = document
        for part in parents:
            ways = _ways(place, root=place is document)
            if part not in ways:
                raise InputError(f"{path}: got {part!r}; allowed: {', '.join(ways) or 'no more'}")
            place = ways[part]
        if not isinstance(place, dict):
            raise InputError(f"{path}: got {last!r}; allowed: {', '.join(_ways(place))}")
        place[last] = value
    return Table(document, table.file)


def _ways(place: Any, *, root: bool = False) -> dict[str, Any]:
    """Return the tables and lists of tables inside one of these, by the parts of paths to them."""
    found: dict[str, Any] = {}
    if isinstance(place, dict):
        entries = cast(dict[str, Any], place)
        if root and _leads_on(props := entries.get(PROPS, [])):
            found = _ways(props)
        return found | {key: value for key, value in entries.items() if _leads_on(value)}
    rows = cast(list[dict[str, Any]], place)
    for key in ROW_KEYS:
        named = [row.get(key) for row in rows]
        pairs = zip(named, rows, strict=True)
        found = {str(name): row for name, row in pairs if name and named.count(name) == 1} | found
    return found | {str(number): row for number, row in enumerate(rows)}


def _leads_on(value: Any) -> bool:
    """Return whether a value is a table or a list of tables."""
    rows = cast(list[Any], value) if isinstance(value, list) else [value]
    return all(isinstance(row, dict) for row in rows)
