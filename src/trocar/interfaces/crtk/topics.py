"""Every topic and service, once: from these rows each transport is made.

Names are those of the dVRK's ROS bridge, without a leading slash. Source: SAW
ros/dvrk_robot/src/system_ROS.cpp and CISST mts_ros_crtk_bridge_provided.cpp (version 2.4).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.interfaces.crtk import arm_rows, other_rows, scene_rows, teleop_rows

Direction = Literal["pub", "sub"]
Rate = Literal["state", "event", "tf", "camera", "clock"]

#: How many commands that all count may wait at a subscriber. Source: as the loop's inbox.
ORDERED = 64
#: Images are few and large: who lags gets the newest. Source: our own choice.
IMAGES = 2
#: Messages without a header, of those that rows name; std_msgs have none either.
BARE = {"geometry_msgs/Quaternion", "tf2_msgs/TFMessage", "rosgraph_msgs/Clock"}


@dataclass(frozen=True)
class Topic:
    """A topic.

    Attributes:
        name: "PSM1/measured_js"; no leading slash
        type: "sensor_msgs/JointState"
        direction: "pub": the simulator publishes it; "sub": it listens
        rate: of what is published: every period ("state", "tf", "camera", "clock"), or when
            something happens ("event")
        latched: whether a late subscriber gets the last message
        depth: how many messages wait: 1 where only the newest counts
        unit: of the numbers
        help: what it tells or does
        arm: the arm of the rig that it belongs to, "" for none
        key: the name without the arm: "measured_js"
        later: the row stands for a component that is not there yet: nobody advertises it
    """

    name: str
    type: str
    direction: Direction
    rate: Rate = "event"
    latched: bool = False
    depth: int = ORDERED
    unit: str = ""
    help: str = ""
    arm: str = ""
    key: str = ""
    later: bool = False

    @property
    def stamped(self) -> bool:
        """Whether its messages begin with a header."""
        return not self.type.startswith("std_msgs/") and self.type not in BARE


@dataclass(frozen=True)
class Service:
    """A service; `arm` and `key` as of a `Topic`."""

    name: str
    type: str
    help: str = ""
    arm: str = ""
    key: str = ""


def prefix(name: str, arm: ArmDescription) -> str:
    """Return what stands before the topics of an arm: "PSM1", and "SUJ/PSM1" for SUJ_PSM1."""
    return f"SUJ/{name.removeprefix('SUJ_')}" if arm.type == "SUJ" else name


def topic_table(rig: RigDescription) -> tuple[Topic, ...]:
    """Return every topic of a rig, those that come later included."""
    found: list[Topic] = []
    for arm in rig.arms:
        rows = arm_rows.topics_of(arm.arm)
        found += [_owned(_topic(row), prefix(arm.name, arm.arm), arm.name) for row in rows]
    rows = (*other_rows.topics_of(rig), *scene_rows.topics_of(rig))
    found += topics_from((*rows, *teleop_rows.topics_of(rig.teleops)))
    return _unique(found)


def topics_from(rows: Iterable[Sequence[str]]) -> list[Topic]:
    """Return topics that belong to no arm, from rows as those of `arm_rows`."""
    return [_topic(row) for row in rows]


def service_table(rig: RigDescription) -> tuple[Service, ...]:
    """Return every service of a rig."""
    return tuple(
        Service(f"{prefix(arm.name, arm.arm)}/{key}", kind, text, arm.name, key)
        for arm in rig.arms
        for key, kind, text in arm_rows.services_of(arm.arm)
    )


def _topic(row: Sequence[str]) -> Topic:
    """Read a row: (direction and marks, name, type, unit, help).

    Marks: "state", "tf", "clock": the rate; "latched"; "1": only the newest counts; "later".
    """
    marks, name, kind, unit, text = row
    words = marks.split()
    rate = next((w for w in words if w in ("state", "tf", "camera", "clock")), "event")
    return Topic(
        name,
        kind,
        "sub" if words[0] == "sub" else "pub",
        rate,  # type: ignore[arg-type]  one of the words above
        "latched" in words,
        1 if "1" in words else ORDERED,
        unit,
        text,
        "",
        name,
        "later" in words,
    )


def _owned(topic: Topic, before: str, arm: str) -> Topic:
    return replace(topic, name=f"{before}/{topic.name}", arm=arm)


def _unique(topics: Iterable[Topic]) -> tuple[Topic, ...]:
    """Return the topics in their order, each name once (arms of a kind share some)."""
    return tuple({topic.name: topic for topic in topics}.values())
