"""Write docs/descriptions.md and the JSON schemas of TOML files, from the fields of the records.

The text of the page is in a template, whose lines `<!-- keys rig.arm -->` become tables of keys.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from trocar.descriptions import frames, needles, props, records, rigs, scenes, shapes, tissues
from trocar.descriptions.arms import (
    ArmKeys,
    ArmPoseKeys,
    BeltKeys,
    CouplingKeys,
    RotorKeys,
    ToolKeys,
)
from trocar.descriptions.calibration_plan import CalibrationPlan
from trocar.descriptions.cameras import CameraFileKeys, CameraKeys, EyeKeys
from trocar.descriptions.catalogue import DATA
from trocar.descriptions.fixtures import Cone, Fixture, NeedleArc, Plane, Tube
from trocar.descriptions.keys import UNITS, Key, keys_of
from trocar.descriptions.meshes import MeshKeys
from trocar.descriptions.paper import Erratum
from trocar.descriptions.robot_errors import JointErrors, JointRow, RobotErrorKeys
from trocar.descriptions.sensor_records import SensorDescription
from trocar.descriptions.sensors import KINDS, PlacedSensor, Proximity
from trocar.descriptions.table import SCHEMA
from trocar.descriptions.teleops import TeleopDescription, TeleopMasters
from trocar.descriptions.threads import ThreadKeys, ThreadSize

ROOT = Path(__file__).parents[2]
TEMPLATE = Path(__file__).with_name("descriptions.in.md")
PAGE = ROOT / "docs" / "descriptions.md"
SCHEMAS = DATA / "schema"
DIALECT = "https://json-schema.org/draft/2020-12/schema"
#: Texts of more choices are not listed in a table of the page.
MOST_CHOICES = 6
#: Units in which the page gives defaults and bounds.
PAGE_UNITS = {"length": "mm", "angle": "deg", "angular velocity": "deg_s", "pressure": "kpa"}


@dataclass(frozen=True)
class Block:
    """A table of a file.

    Attributes:
        records: classes whose fields declare its keys
        kinds: {kind: further ones of a table of that kind}
        rows, tables, named: {key: block} of arrays of tables, of tables, and of tables of tables
            with names of one's own
        either: those among the records that a table may lack as a whole
        inner: {kind: keys among these blocks that only a table of that kind has}
        extra: keys that no field declares, with their help
        free: whether a table may be given as a text instead
    """

    records: tuple[type, ...] = ()
    kinds: Mapping[str, tuple[type, ...]] = field(default_factory=dict)
    rows: Mapping[str, Block] = field(default_factory=dict)
    tables: Mapping[str, Block] = field(default_factory=dict)
    named: Mapping[str, Block] = field(default_factory=dict)
    either: tuple[type, ...] = ()
    inner: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    extra: tuple[tuple[Key, str], ...] = ()
    free: bool = False

    @property
    def blocks(self) -> dict[str, Block]:
        """All inner blocks."""
        return {**self.rows, **self.tables, **self.named}


POSE = (frames.PoseKeys,)
SHAPE = Block((shapes.ShapeKeys, shapes.MaterialKeys), {"mesh": (MeshKeys,)})
BODY = Block((shapes.BodyKeys,), rows={"shape": SHAPE})
PARTS: dict[str, Block] = {
    "joint": Block((records.JointDescription,), tables={"spring": Block((records.Spring,))}),
    "frame": Block((frames.FrameKeys, frames.DhKeys, *POSE), either=(frames.DhKeys,)),
    "closure": Block((frames.ClosureKeys,)),
    "body": BODY,
    "pose": Block((ArmPoseKeys,)),
}
PART_TABLES = {
    "friction": Block(named={"": Block(named={"": Block((records.Friction,))})}),
    "rotor": Block(named={"": Block((RotorKeys,))}),
    "belts": Block(named={"": Block((BeltKeys,))}),
    "control": Block(named={"": Block((records.Control,))}),
}
NOISE = Key(
    "noise",
    form="number",
    dimensions=(
        "torque",
        "force",
        "angular velocity",
        "linear acceleration",
        "linear velocity",
        "length",
    ),
    least=0.0,
    default=0.0,
)
SENSOR = Block(
    (SensorDescription,),
    {
        name: (kind, *(POSE if issubclass(kind, PlacedSensor) and kind is not Proximity else ()))
        for name, kind in KINDS.items()
    },
    extra=(
        (Key("kind", choices=tuple(KINDS)), "of the sensor"),
        (NOISE, "standard deviations, such as `noise_n` and `noise_nm` of a wrench"),
        (
            Key("xyz", form="numbers", dimensions=("length",), size=3, of=("proximity",)),
            "start of the ray",
        ),
    ),
)
PROP = Block(
    (props.PropKeys, *POSE, shapes.MassKeys),
    {
        "shapes": (shapes.DrawnKeys,),
        "needle": (needles.NeedleSize, needles.NeedleKeys, needles.NeedleLook),
        "tissue": (tissues.Tissue,),
        "thread": (ThreadSize, ThreadKeys),
    },
    rows={"shape": SHAPE, "layer": Block((tissues.Layer,))},
    tables={"joint": Block((records.PropJoint,)), "thread": Block((tissues.Thread,))},
    inner={"tissue": ("layer", "thread")},
    either=(needles.NeedleSize, needles.NeedleKeys, ThreadSize),
)
BAND = Block((records.Band,), rows={"point": Block((records.BandPoint,))})
SCENERY = {"prop": PROP, "band": BAND, "sensor": SENSOR}
FREE = Block(extra=((Key("*", form="any"), ""),))
FILES: dict[str, Block] = {
    "arm": Block(
        (ArmKeys,),
        rows={
            **PARTS,
            "gravity_link": Block((records.GravityLink,)),
            "missing": Block((records.Missing,)),
            "erratum": Block((Erratum,)),
        },
        tables={
            **PART_TABLES,
            "counterweight": Block((records.Counterweight,)),
            "calibration": Block((CalibrationPlan,)),
        },
    ),
    "tool": Block(
        (ToolKeys,), rows=PARTS, tables={**PART_TABLES, "coupling": Block((CouplingKeys,))}
    ),
    "rig": Block(
        (rigs.RigKeys,),
        rows={
            "arm": Block(
                (rigs.RigArmKeys, *POSE), tables={"base_frame": Block((records.BaseFrame, *POSE))}
            ),
            "pose": Block((rigs.RigPoseKeys,)),
            **SCENERY,
            "teleop": Block((TeleopMasters, TeleopDescription)),
            "camera": Block((CameraKeys,), {"view": (*POSE, EyeKeys)}),
        },
        tables={
            "display": Block(POSE),
            "test_sine": Block((rigs.TestSineKeys,)),
            "errors": Block(
                (RobotErrorKeys,), rows={"joint": Block((JointRow, JointErrors))}, free=True
            ),
        },
    ),
    "scene": Block(
        (scenes.SceneKeys,),
        rows={**SCENERY, "place": Block((scenes.Placement,)), "goal": Block((scenes.Goal,))},
        tables={"start_q_rad_m": FREE},
    ),
    "prop": Block((props.PropFileKeys,), rows={"body": BODY}),
    "camera": Block((CameraFileKeys, EyeKeys)),
    "fixtures": Block(
        rows={
            "fixture": Block(
                (Fixture,),
                {"plane": (Plane,), "cone": (Cone,), "tube": (Tube,), "needle_arc": (NeedleArc,)},
                extra=(
                    (Key("kind", choices=("plane", "cone", "tube", "needle_arc")), "of the region"),
                ),
            )
        }
    ),
}
#: The end of an attribute's entry in a docstring: "(3,) [m], [rad]".
SHAPE_AND_UNIT = re.compile(r"(,? ?\(\w+,( \d)?\))?( ?\[[^\]`]*\](, \[[^\]`]*\])?)?$")
#: Files whose tables may lack what a table of their base has.
BASED = ("arm", "tool")


# ------------------------------------------------------------------ keys and their help


@dataclass(frozen=True)
class Entry:
    """A key of a block.

    Attributes:
        key: the key
        names: fields that share its help
        text: the help
        kinds: of table that have it, all if empty
        needed: whether these must have it
    """

    key: Key
    names: tuple[str, ...]
    text: str
    kinds: tuple[str, ...]
    needed: bool


def help_of(record: type) -> dict[str, tuple[tuple[str, ...], str]]:
    """Return the help of a record's fields, {field: (fields that share it, text)}.

    It is the entry in the docstring of the class, or of the base that has the field.
    """
    found: dict[str, tuple[tuple[str, ...], str]] = {}
    for kind in reversed(record.__mro__):
        text = (kind.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
        entries = re.findall(r"^ {8}(\w[\w, ]*): ?(.*(?:\n {12}.*)*)", text, re.MULTILINE)
        for names, said in entries:
            fields = tuple(name.strip() for name in names.split(","))
            plain = SHAPE_AND_UNIT.sub("", " ".join(said.split()))
            found |= {name: (fields, plain.strip(" ,")) for name in fields}
    return found


def entries_of(block: Block, kinds: tuple[str, ...] | None = None) -> list[Entry]:
    """Return the keys of a block.

    Args:
        block: the table
        kinds: whose own keys alone are returned; None: of the block and all its kinds
    """
    found: dict[tuple[str, str, str], Entry] = {}

    def add(record: type, of: tuple[str, ...], but: frozenset[str] = frozenset()) -> None:
        help_ = help_of(record)
        for one in keys_of(record):
            if one.field in but or (one.field == "source" and one.default is not ...):
                continue
            names, text = help_[one.field]
            own = of
            if one.of == ("on props",):
                own = tuple(name for name, kind in KINDS.items() if kind.on_props)
            elif one.of and one.of[0] not in ("rpy", "rotation"):
                own = one.of
            place = one.name, one.field, text
            if place in found:
                own = (*found[place].kinds, *own)
            needed = one.needed and record not in block.either
            found[place] = Entry(one, names, text, own, needed)

    if kinds is None:
        for one, text in block.extra:
            found[one.name, "", text] = Entry(one, (one.name,), text, one.of, one.needed)
        for record in block.records:
            add(record, ())
    for kind, more in block.kinds.items():
        for record in more if kinds is None or kind in kinds else ():
            bases = [base for base in block.records if issubclass(record, base)]
            heads = frozenset(one.field for base in bases for one in keys_of(base))
            add(record, () if kinds else (kind,), heads)
    return list(found.values())


# ------------------------------------------------------------------ the page


def page() -> str:
    """Return the page as Markdown."""
    text = TEMPLATE.read_text(encoding="utf-8")
    marks = re.findall(r"^<!-- keys (\S+) -->$", text, re.MULTILINE)
    for mark in marks:
        path, _, kinds = mark.partition(":")
        block, shown = block_at(path), (kinds,) if kinds else None
        others = [other.partition(":") for other in marks]
        apart = {kind for there, _, kind in others if there == path and kind}
        rows = [*rows_of(block, shown, apart), *inner_rows(path, block, shown)]
        table = ["| key | value | |", "|---|---|---|", *rows]
        text = text.replace(f"<!-- keys {mark} -->", "\n".join(table))
    return text


def block_at(path: str) -> Block:
    """Return the block at a path such as "arm.joint.spring"."""
    name, *inner = path.split(".")
    block = FILES[name]
    for step in inner:
        block = block.blocks["" if step == "*" else step]
    return block


def rows_of(block: Block, kinds: tuple[str, ...] | None, apart: set[str]) -> Iterator[str]:
    """Yield the rows of a table of keys, those with a common help as one."""
    entries = [e for e in entries_of(block, kinds) if not e.kinds or not set(e.kinds) <= apart]
    groups: list[list[Entry]] = []
    for entry in entries:
        last = groups[-1][-1] if groups else None
        if last and len(entry.names) > 1 and (last.names, last.kinds) == (entry.names, entry.kinds):
            groups[-1].append(entry)
        else:
            groups.append([entry])
    for group in groups:
        names = ", ".join(dict.fromkeys(shown_name(e) for e in group))
        values = " / ".join(dict.fromkeys(shown_value(e.key) for e in group))
        first = group[0]
        said = [first.text] if first.text else []
        if bound := next((bounds_text(e.key) for e in group if e.key.bounded), ""):
            said.append(bound)
        if not any("default" in part for part in said):
            defaults = dict.fromkeys(text for e in group if (text := default_text(e.key)))
            said += [f"default: {', '.join(defaults)}"] if defaults else []
        see = next((f"[more]({e.key.see})" for e in group if e.key.see), "")
        text = "; ".join(filter(None, [*said, see]))
        of = ", ".join(f"`{kind}`" for kind in dict.fromkeys(first.kinds))
        yield f"| {names} | {values} | {f'{of}: ' if of else ''}{text} |"


def inner_rows(path: str, block: Block, kinds: tuple[str, ...] | None) -> Iterator[str]:
    """Yield a row for each table inside a block, which has a table of its own."""
    if "." not in path:
        return
    only = {name: kind for kind, names in block.inner.items() for name in names}
    for name in block.blocks:
        if name and only.get(name) in (kinds or (None,)):
            value = "tables" if name in block.rows else "table"
            yield f"| `{name}` | {value} | below |"


def shown_name(entry: Entry) -> str:
    """Return a key as the page has it, in bold where it must be there."""
    name = f"`{entry.key.name}{'_*' if entry.key.dimensions else ''}`"
    return f"**{name}**" if entry.needed else name


def shown_value(key: Key) -> str:
    """Return the units or the choices of a key."""
    units = [unit for dimension in key.dimensions for unit in UNITS[dimension]]
    count = f"{key.size} numbers" if key.size else "numbers"
    words = {
        "text": "text",
        "name": "text",
        "texts": "texts",
        "flag": "`true`, `false`",
        "number": "" if units else "number",
        "whole": "whole number",
        "numbers": count,
        "direction": "3 numbers",
        "weights": "table",
        "any": "",
    }
    if key.choices and len(key.choices) <= MOST_CHOICES:
        return ", ".join(f"`{choice}`" for choice in key.choices if choice)
    return " ".join(filter(None, [words[key.form], ", ".join(units)]))


def quantity(key: Key, value: float) -> str:
    """Return a number in a unit that people use."""
    for dimension in key.dimensions[:1]:
        if not value:
            break
        unit = PAGE_UNITS.get(dimension, next(iter(UNITS[dimension])))
        if unit == "kpa" and value >= UNITS[dimension]["gpa"]:
            unit = "gpa"
        words = {"deg_s": "deg/s", "kpa": "kPa", "gpa": "GPa", "n": "N", "nm": "N m"}
        return f"{value / UNITS[dimension][unit]:g} {words.get(unit, unit)}"
    return f"{value:g}"


def bounds_text(key: Key) -> str:
    """Return the bounds of a number in words."""
    low = key.above if key.least is None else key.least
    word = "" if low is None else f"{'' if key.above is None else 'above '}{quantity(key, low)}"
    if key.most is None:
        return word if key.above is not None else f"{word} or more"
    return f"{word} to {quantity(key, key.most)}".strip()


def default_text(key: Key) -> str:
    """Return the default of a key in words, "" of one that says nothing."""
    if key.like:
        return f"`{key.like}`"
    value = key.default() if callable(key.default) else key.default
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, int | float):
        return f"{quantity(key, value)}" if math.isfinite(value) else ""
    if isinstance(value, np.ndarray) and value.size:
        return f"{' '.join(f'{number:g}' for number in value.tolist())}"
    return f"`{value}`" if isinstance(value, str) and value else ""


# ------------------------------------------------------------------ the schemas


def schema(file: str) -> dict[str, Any]:
    """Return the JSON schema of a kind of file."""
    found = _schema(FILES[file], file not in BASED)
    first = {"schema": {"const": SCHEMA, "description": "version of the files"}}
    if file in BASED:
        first["base"] = {"type": "string", "description": f"{file} that this one is based on"}
    found["properties"] = {**first, **found["properties"]}
    found["required"] = ["schema", *found.get("required", [])]
    return {"$schema": DIALECT, "title": f"{file} of trocar", **found}


def _schema(block: Block, complete: bool) -> dict[str, Any]:
    properties: dict[str, Any] = {"source": {"type": "string", "description": "of the numbers"}}
    if not complete:
        properties["drop"] = {"type": "array", "items": {"type": "string"}}
    required: list[str] = []
    either: list[dict[str, Any]] = []
    if block.blocks.get(""):
        return {
            "type": "object",
            "properties": properties,
            "additionalProperties": _schema(block.blocks[""], complete),
        }
    for entry in entries_of(block):
        one = entry.key
        if one.name == "*":
            return {"type": "object"}
        spelled = [(unit, f) for d in one.dimensions for unit, f in UNITS[d].items()]
        names = [f"{one.name}_{unit}" for unit, _ in spelled] or [one.name]
        for name, (_, factor) in zip(names, spelled or [("", 1.0)], strict=True):
            value = _value(one, factor)
            old = properties.get(name)
            if old and {**old, "description": ""} != {**value, "description": ""}:
                value = {k: v for k, v in value.items() if old.get(k) == v}
            texts = [old["description"]] if old and name != "source" else []
            properties[name] = {**value, "description": "; ".join([*texts, entry.text])}
        if complete and entry.needed and not entry.kinds:
            if len(names) == 1:
                required += names
            else:
                either.append({"anyOf": [{"required": [name]} for name in names]})
    for name, inner in block.rows.items():
        properties[name] = {"type": "array", "items": _schema(inner, complete)}
    for name, inner in block.tables.items():
        made = _schema(inner, complete)
        properties[name] = {"anyOf": [{"type": "string"}, made]} if inner.free else made
    found = {"type": "object", "properties": properties, "additionalProperties": False}
    if required:
        found["required"] = required
    if either:
        found["allOf"] = either
    return found


def _value(key: Key, factor: float) -> dict[str, Any]:
    """Return the schema of a key's value."""
    bounds: dict[str, Any] = {}
    for name, bound in (
        ("exclusiveMinimum", key.above),
        ("minimum", key.least),
        ("maximum", key.most),
    ):
        if bound is not None:
            bounds[name] = float(f"{bound / factor:.12g}")
    if key.form in ("text", "name"):
        if key.choices:
            return {"enum": list(key.choices)}
        return {"type": "string", **({"minLength": 1} if key.form == "name" else {})}
    if key.form == "texts":
        return {"type": "array", "items": {"type": "string"}}
    if key.form == "flag":
        return {"type": "boolean"}
    if key.form in ("number", "whole"):
        return {"type": "number" if key.form == "number" else "integer", **bounds}
    if key.form in ("numbers", "direction"):
        size = 3 if key.form == "direction" else key.size
        sizes = {"minItems": size, "maxItems": size} if size else {}
        return {"type": "array", "items": {"type": "number", **bounds}, **sizes}
    if key.form == "weights":
        return {"type": "object", "additionalProperties": {"type": "number"}}
    return {}


def schema_text(file: str) -> str:
    """Return the JSON schema of a kind of file as text."""
    return json.dumps(schema(file), indent=1) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    SCHEMAS.mkdir(exist_ok=True)
    for each in FILES:
        (SCHEMAS / f"{each}.json").write_text(schema_text(each), encoding="utf-8")
