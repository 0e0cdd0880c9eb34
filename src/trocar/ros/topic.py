"""Topics and services, one row each: from these rows every transport is made.

Names are those of the dVRK's ROS bridge, without a leading slash. Source: SAW
ros/dvrk_robot/src/system_ROS.cpp and CISST mts_ros_crtk_bridge_provided.cpp (version 2.4).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from trocar.descriptions.records import ArmDescription
from trocar.live.inbox import Command
from trocar.ros.clock import Stamp
from trocar.ros.sample import SampleReadings
from trocar.simulation.records import ArmStatus

#: A message in memory: its fields by their names in ROS 2, nested; times are (s, ns).
Message = dict[str, Any]
Direction = Literal["pub", "sub"]
Rate = Literal["state", "event", "tf", "camera", "clock", "statistics"]
#: Makes a message from a sample; None without data, as for the jaw of a tool that has no jaw.
Make = Callable[[SampleReadings, Stamp], "Message | None"]
#: Checks a message, for an arm as it is now or for none, and returns the commands that it is.
Read = Callable[[Mapping[str, Any], Any], "Command | Sequence[Command]"]
#: Publishes an event: a topic and the fields of its message, the header left out.
Emit = Callable[[str, Mapping[str, Any]], None]
#: Returns the fields of an event from the state of an arm, the header left out.
Content = Callable[[ArmStatus], Message]

#: Queue length of a subscriber to ordered commands. Source: as the loop's inbox.
ORDERED = 64
#: Images are few and large: who lags gets the newest. Source: our own choice.
IMAGES = 2
#: Messages without a header, of those that rows name; std_msgs have none either.
BARE = {"geometry_msgs/Quaternion", "tf2_msgs/TFMessage", "rosgraph_msgs/Clock"}

JOINTS = "sensor_msgs/JointState"
JOY = "sensor_msgs/Joy"
POSE = "geometry_msgs/PoseStamped"
TWIST = "geometry_msgs/TwistStamped"
WRENCH = "geometry_msgs/WrenchStamped"
MATRIX = "std_msgs/Float64MultiArray"
STRING, BOOL, FLOAT, EMPTY = (f"std_msgs/{name}" for name in ("String", "Bool", "Float64", "Empty"))
STATE = "crtk_msgs/OperatingState"
COMMAND = "crtk_msgs/StringStamped"
SI = "rad, m, N m, N"
PLACE = "m, quaternion xyzw"
SPEED = "m/s, rad/s"
FORCE = "N, N m"


@dataclass(frozen=True)
class Topic:
    """A topic.

    Attributes:
        name: "PSM1/measured_js"; no leading slash
        type: "sensor_msgs/JointState"
        direction: "pub": the simulator publishes it; "sub": it listens
        rate: of what is published: periodically ("state", "tf", "camera", "clock", "statistics"),
            or when something happens ("event")
        latched: whether a late subscriber gets the last message
        depth: how many messages wait: 1 where only the newest counts
        unit: of the numbers
        help: content or effect of a message
        arm: the arm of the rig that it belongs to, "" for none
        key: the name without the arm: "measured_js"
        later: the row stands for a component that is not there yet: it is not advertised
        make: makes the message of every period; None for events
        read: reads a message into commands; None for what is published
        content: of a latched event that follows from the state of its arm: published on change
        first: of a latched event: published before anything happens
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
    make: Make | None = field(default=None, repr=False, compare=False)
    read: Read | None = field(default=None, repr=False, compare=False)
    content: Content | None = field(default=None, repr=False, compare=False)
    first: Content | None = field(default=None, repr=False, compare=False)
    stamped: bool = field(default=False, repr=False)

    def __post_init__(self) -> None:
        """Set `key` where none is given, and whether messages begin with a header."""
        if not self.key:
            object.__setattr__(self, "key", self.name)
        bare = self.type.startswith("std_msgs/") or self.type in BARE
        object.__setattr__(self, "stamped", not bare)

    def under(self, prefix: str, arm: str = "") -> Topic:
        """Return the row with a prefix to its name, of an arm."""
        return replace(self, name=f"{prefix}/{self.name}", arm=arm)


@dataclass(frozen=True)
class Service:
    """A service; `arm` and `key` as of a `Topic`; `answer` takes the arm and the request."""

    name: str
    type: str
    help: str = ""
    arm: str = ""
    key: str = ""
    answer: Callable[[Any, Mapping[str, Any]], Message] | None = field(
        default=None, repr=False, compare=False
    )


def state(
    name: str, kind: str, unit: str, text: str, make: Any = None, rate: Rate = "state"
) -> Topic:
    """Return the row of a topic that is published every period."""
    return Topic(name, kind, "pub", rate, unit=unit, help=text, make=make)


def event(name: str, kind: str, text: str, unit: str = "", latched: bool = False) -> Topic:
    """Return the row of a topic of which late subscribers get nothing: commands to others."""
    return Topic(name, kind, "pub", latched=latched, unit=unit, help=text)


def latched(
    name: str,
    kind: str,
    text: str,
    unit: str = "",
    content: Content | None = None,
    first: Content | None = None,
) -> Topic:
    """Return the row of an event whose last message late subscribers get.

    The dVRK latches every event. Source: cisst-ros 73aca61, mtsROSBridge.h:828 and :845.
    """
    return replace(event(name, kind, text, unit, latched=True), content=content, first=first)


def command(
    name: str, kind: str, unit: str, text: str, read: Any = None, newest: bool = False
) -> Topic:
    """Return the row of a topic that is listened to; `newest`: only the newest message counts."""
    depth = 1 if newest else ORDERED
    return Topic(name, kind, "sub", depth=depth, unit=unit, help=text, read=read)


def by_name(topics: Iterable[Topic]) -> dict[str, Topic]:
    """Return topics by their names."""
    return {topic.name: topic for topic in topics}


def served(
    topics: Iterable[Topic],
    reads: Mapping[str, Read] | None = None,
    makes: Mapping[str, Make] | None = None,
) -> dict[str, Topic]:
    """Return rows by name as a component serves them: not `later`, with what reads and makes."""
    return {
        topic.name: replace(
            topic,
            later=False,
            read=(reads or {}).get(topic.name, topic.read),
            make=(makes or {}).get(topic.name, topic.make),
        )
        for topic in topics
    }


def prefix(name: str, arm: ArmDescription) -> str:
    """Return the prefix of an arm's topics: "PSM1", and "SUJ/PSM1" for SUJ_PSM1."""
    return f"SUJ/{name.removeprefix('SUJ_')}" if arm.type == "SUJ" else name
