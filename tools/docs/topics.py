"""Write docs/topic-list.md: every topic and service, from the rows that transports are made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from trocar.descriptions import load_rig, sensors
from trocar.descriptions.sensor_records import SensorDescription
from trocar.ros.core import service_table, topic_table
from trocar.ros.images import camera_topics
from trocar.ros.scene import sensor_row
from trocar.ros.topic import Service, Topic

Row = TypeVar("Row", Topic, Service)
PAGE = Path(__file__).parents[2] / "docs" / "topic-list.md"
TEXT = """\
# Every topic and service

[Topics](topics.md) explains frames, order and time-outs. Names of an arm's topics begin with the
arm (`/PSM1/measured_js`, `/SUJ/PSM1/measured_js`), those of a teleoperation component with it
(`/MTMR_PSM1/following`). Late subscribers get the last message of a *latched* topic.

<!-- Written by make docs. -->"""
KINDS = ("PSM", "ECM", "MTM", "SUJ")
SENT = {"state": "`--rate`", "tf": "50 Hz", "statistics": "5 Hz", "clock": "each tick"}


def page() -> str:
    """Return the page as Markdown."""
    rig = load_rig("full_cart_mtm")
    kind_of = {arm.name: arm.arm.type for arm in rig.arms}
    topics = topic_table(rig)
    scene = [t for t in topic_table(load_rig("pegs")) if t.name.startswith(("scene", "PSM1/grasp"))]
    parts = [
        TEXT,
        "## Arms",
        _arms("published by", (t for t in topics if t.arm and t.direction == "pub"), kind_of),
        _arms("command of", (t for t in topics if t.arm and t.direction == "sub"), kind_of),
        "## Teleoperation",
        _others(t for t in topics if t.later),
        "## The rig",
        _others(t for t in topics if not t.arm and not t.later and not t.name.startswith("scene")),
        "## Objects",
        _others(
            t for t in scene if t.name.count("/") == 1 or t.name.startswith(("scene/ring1", "P"))
        ),
        "## Sensors",
        _table(("kind", "type", "unit"), map(_sensor, sensors.KINDS.values())),
        "## Images",
        _others(t for t, of in camera_topics(rig, overlaid=True) if of.eye != "right"),
        "## Services",
        _table(
            ("service", "type", "of"),
            (
                (s.key, s.type, _kinds(kinds), s.help)
                for s, kinds in _merged(service_table(rig), kind_of)
            ),
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _sensor(kind: type[SensorDescription]) -> tuple[str, str, str, str]:
    row = sensor_row(kind)
    return kind.kind, row.type, row.unit, row.help


def _arms(who: str, topics: Iterable[Topic], kind_of: Mapping[str, str]) -> str:
    rows = _merged(topics, kind_of)
    return _table(
        ("topic", "type", who, "unit", "sent"),
        ((t.key, t.type, _kinds(kinds), t.unit, _sent(t), t.help) for t, kinds in rows),
    )


def _others(topics: Iterable[Topic]) -> str:
    rows = {(t.name if "/teleop/" in t.name or not t.later else t.key): t for t in topics}
    return _table(
        ("topic", "type", "", "unit", "sent"),
        (
            (
                name,
                t.type,
                {"pub": "published", "sub": "command"}[t.direction],
                t.unit,
                _sent(t),
                t.help,
            )
            for name, t in rows.items()
        ),
    )


def _merged(rows: Iterable[Row], kind_of: Mapping[str, str]) -> list[tuple[Row, set[str]]]:
    """Return one row of each key, with the kinds of arms that have it."""
    found: dict[str, tuple[Row, set[str]]] = {}
    for row in rows:
        found.setdefault(row.key, (row, set()))[1].add(kind_of[row.arm])
    return list(found.values())


def _sent(topic: Topic) -> str:
    return "latched" if topic.latched else SENT.get(topic.rate, "")


def _kinds(kinds: set[str]) -> str:
    return "all" if kinds == set(KINDS) else ", ".join(kind for kind in KINDS if kind in kinds)


def _table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = [*columns, ""]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name, *cells in rows:
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
