"""The keys that records declare are those that readers take, and the JSON schemas have them."""

from __future__ import annotations

import json
import re
import runpy
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions.arms import read_arm, read_tool
from trocar.descriptions.cameras import load_camera
from trocar.descriptions.catalogue import DATA, load_rig, load_scene
from trocar.descriptions.fixtures import read_fixtures
from trocar.descriptions.keys import key
from trocar.descriptions.table import Table, parse_table, read_table
from trocar.errors import DescriptionError

ROOT = Path(__file__).parents[2]
TOOL = runpy.run_path(str(ROOT / "tools" / "docs" / "descriptions.py"))
FOLDERS = {"arm": "arms", "tool": "tools", "rig": "rigs", "scene": "scenes", "camera": "cameras"}
FILES = [
    *((kind, path) for kind, name in FOLDERS.items() for path in (DATA / name).glob("*.toml")),
    ("rig", ROOT / "examples" / "props" / "play.toml"),
    ("fixtures", ROOT / "examples" / "assistance" / "line.toml"),
    ("fixtures", ROOT / "examples" / "assistance" / "needle_arc.toml"),
]


@dataclass(frozen=True)
class Spool:
    """A spool.

    Attributes:
        length: of the thread [m]
        turns: on it
    """

    length: float = field(metadata=key("length", above=0.0, most=10.0))
    turns: int = field(default=1, metadata=key(least=1))
    axis: NDArray[np.float64] | None = field(default=None, metadata=key(size=3))
    width: float = field(default=0.0, metadata=key("length", of=("wide",)))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "length: is missing; allowed keys: length_m, length_mm"),
        ("length_mm = 1\nlength_m = 1", "length_mm: contradicts length_m; give one of them"),
        ("length_mm = 0", "length: got 0; allowed: above 0 to 10"),
        ("length_m = 1\nturns = 1.5", "turns: got 1.5; allowed: 1, 2, 3 and so on"),
        ("length_m = 1\naxis = [1, 2]", r"axis: got \[1, 2\]; allowed: a list of 3 numbers"),
        ("length_m = 1\nwidth_m = 1", r"width_m: unknown key; this table knows: axis, "),
        ("length_m = 1\nlenght_mm = 1", r"lenght_mm: unknown .*\(did you mean 'length_mm'\?\)"),
    ],
)
def test_a_record_s_keys_are_checked(text: str, problem: str) -> None:
    with pytest.raises(DescriptionError, match=rf"spool.toml: {problem}"):
        read_spool(text)


def read_spool(text: str, kind: str = "") -> Spool:
    table = parse_table(text, "spool.toml")
    spool = table.record(Spool, kind)
    table.done()
    return spool


def test_a_record_is_read_in_si_with_defaults() -> None:
    spool = read_spool("length_mm = 250\nwidth_mm = 4", "wide")
    assert (spool.length, spool.turns, spool.axis, spool.width) == (0.25, 1, None, 0.004)


@pytest.mark.parametrize("file", TOOL["FILES"])
def test_the_json_schemas_are_those_of_the_records(file: str) -> None:
    text = (TOOL["SCHEMAS"] / f"{file}.json").read_text(encoding="utf-8")
    assert text == TOOL["schema_text"](file), "make docs"


@pytest.mark.parametrize(("kind", "path"), FILES, ids=lambda value: getattr(value, "stem", value))
def test_a_file_of_the_package_is_valid_by_its_schema(kind: str, path: Path) -> None:
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    assert list(faults(document, schema(kind), "")) == []


def test_a_file_that_the_reader_rejects_is_not_valid_by_its_schema() -> None:
    text = (DATA / "rigs" / "pegs.toml").read_text(encoding="utf-8")
    for old, new in [("movable = true", "movabel = true"), ("mass_g = ", "mass_oz = ")]:
        assert list(faults(tomllib.loads(text.replace(old, new, 1)), schema("rig"), ""))


#: Keys that readers look for before they ask for them.
ASKED_WHERE_THEY_ARE = {"base", "rotation"}
#: Blocks of kinds that no file of the package has.
MORE_BLOCKS = """
[[prop]]
name = "more_shapes"
xyz_mm = [0, 200, 0]
shape = [
    { kind = "ring", radius_mm = 8, wire_radius_mm = 1, sides = 8 },
    { kind = "cup", radius_mm = 8, wall_mm = 1, height_mm = 10, floor_mm = 1 },
    { kind = "mesh", file = "a.obj" },
]
[[sensor]]
kind = "joint_effort"
name = "a"
arm = "PSM1"
joint = "yaw"
[[sensor]]
kind = "joint_effort"
name = "b"
arm = "PSM1"
joint = "insertion"
[[sensor]]
kind = "tip_wrench"
name = "c"
arm = "PSM1"
rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
[[sensor]]
kind = "contacts"
name = "d"
arm = "PSM1"
frame = "yaw"
[[sensor]]
kind = "proximity"
name = "e"
arm = "PSM1"
xyz_mm = [0, -8, 0]
[[sensor]]
kind = "imu"
name = "f"
arm = "PSM1"
frame = "yaw"
[[sensor]]
kind = "twist"
name = "g"
arm = "PSM1"
frame = "yaw"
"""
MORE_FIXTURES = """
schema = 1
[[fixture]]
kind = "plane"
arm = "PSM1"
mode = "filter"
point_mm = [0, 0, 0]
normal = [0, 0, 1]
[[fixture]]
kind = "cone"
arm = "PSM1"
mode = "filter"
apex_mm = [0, 0, 0]
axis = [0, 0, 1]
half_angle_deg = 30
"""


def test_readers_ask_for_the_keys_of_the_schemas(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    play = ROOT / "examples" / "props" / "play.toml"
    (tmp_path / "shake.py").write_bytes((play.parent / "shake.py").read_bytes())
    rig, guides = tmp_path / "rig.toml", tmp_path / "guides.toml"
    text = play.read_text(encoding="utf-8") + MORE_BLOCKS
    text = text.replace('name = "PSM1"\n', 'name = "PSM1"\nbase_frame = { name = "ECM" }\n', 1)
    rig.write_text(text, encoding="utf-8")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    guides.write_text(MORE_FIXTURES, encoding="utf-8")
    files = [*FILES, ("rig", rig), ("fixtures", guides)]
    asked: dict[tuple[str, str], set[str]] = defaultdict(set)
    kind, own = "", ""
    done = Table.done

    def noting(table: Table) -> None:
        done(table)
        if table.file == own:
            place = re.sub(r"\[\d+\]", "", table.path)
            asked[kind, place] |= table.asked

    monkeypatch.setattr(Table, "done", noting)
    readers = {
        "arm": lambda path: read_arm(read_table(path), None),
        "tool": lambda path: read_tool(read_table(path)),
        "rig": load_rig,
        "scene": load_scene,
        "camera": load_camera,
        "fixtures": read_fixtures,
    }
    for kind, path in files:
        own = str(path)
        if not (kind in ("arm", "tool") and "base" in read_table(path)):
            readers[kind](path)
    readers_keys: dict[str, set[str]] = defaultdict(set)
    schemas_keys: dict[str, set[str]] = defaultdict(set)
    for (kind, place), keys in asked.items():
        known = properties(kind, place)
        if known is not None:  # what arms and tools have in common, rigs and scenes, all shapes
            files = {"tool": "arm", "scene": "rig"}.get(kind, kind) if place else kind
            block = "shape" if place.endswith("shape") else f"{files} {place}"
            readers_keys[block] |= keys
            schemas_keys[block] |= known
    for block, keys in readers_keys.items():
        assert keys - schemas_keys[block] <= {"coupling", "drop"}, block
        assert schemas_keys[block] - keys <= ASKED_WHERE_THEY_ARE, block


def schema(kind: str) -> dict[str, Any]:
    return json.loads((DATA / "schema" / f"{kind}.json").read_text(encoding="utf-8"))


def properties(kind: str, place: str) -> set[str] | None:
    """Return the keys that a schema has at a place, None where names are one's own."""
    found = schema(kind)
    for step in filter(None, place.split(".")):
        inner = found.get("properties", {}).get(step) or found.get("additionalProperties")
        if not isinstance(inner, dict):
            return None
        found = inner.get("items", inner)
    if isinstance(found.get("additionalProperties"), dict):
        return None
    return set(found["properties"]) - {"drop"} if "properties" in found else None


def faults(value: Any, rules: dict[str, Any], where: str) -> Iterator[str]:
    """Yield what of a value is not valid by a JSON schema, of what our schemas use of it."""
    types = {"object": dict, "array": list, "string": str, "boolean": bool, "number": int | float}
    types["integer"] = int
    if "type" in rules and not isinstance(value, types[rules["type"]]):
        yield f"{where}: {value!r} is no {rules['type']}"
        return
    if "enum" in rules and value not in rules["enum"]:
        yield f"{where}: {value!r} is none of {rules['enum']}"
    if "const" in rules and value != rules["const"]:
        yield f"{where}: {value!r} is not {rules['const']}"
    if "anyOf" in rules and all(list(faults(value, one, where)) for one in rules["anyOf"]):
        yield f"{where}: {value!r} fits none of the forms"
    for one in rules.get("allOf", ()):
        yield from faults(value, one, where)
    if isinstance(value, dict):
        yield from (f"{where}: lacks {k}" for k in rules.get("required", ()) if k not in value)
        for name, inner in value.items():
            rule = rules.get("properties", {}).get(name, rules.get("additionalProperties", {}))
            if rule is False:
                yield f"{where}: unknown key {name}"
            elif rule:
                yield from faults(inner, rule, f"{where}.{name}")
    if isinstance(value, list):
        if not rules.get("minItems", 0) <= len(value) <= rules.get("maxItems", len(value)):
            yield f"{where}: {len(value)} items"
        for inner in value:
            yield from faults(inner, rules.get("items", {}), where)
    if isinstance(value, int | float):
        low, above, most = (rules.get(k) for k in ("minimum", "exclusiveMinimum", "maximum"))
        if (low is not None and value < low) or (above is not None and value <= above):
            yield f"{where}: {value} is too small"
        if most is not None and value > most:
            yield f"{where}: {value} is too large"
