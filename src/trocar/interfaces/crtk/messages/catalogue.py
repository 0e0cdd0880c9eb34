"""Every type of message and service that trocar speaks, with ROS 1's md5 sums and both texts.

Source of the fields: ROS's common messages as ROS 1 Noetic and ROS 2 Humble and Jazzy have them;
crtk_msgs 1.3.0 (github.com/collaborative-robotics/crtk_msgs); cisst_msgs
(github.com/jhu-cisst/cisst-ros). Ours are trocar_msgs.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from trocar.errors import UnknownNameError
from trocar.interfaces.crtk.messages.definition import (
    Constant,
    Field,
    read_constants,
    read_fields,
)

FOLDER = Path(__file__).parent / "definitions"
# Between the parts of a text with all that it depends on. Source: genmsg, `compute_full_text`.
RULE = "=" * 80


@dataclass(frozen=True, eq=False)
class MessageType:
    """One type of message.

    Args:
        name: such as "sensor_msgs/JointState"; a service's halves end in Request and Response
        fields: in order, those that only ROS 1 has included
        constants: in order
        text_ros1: definition in ROS 1's words, followed by those of all that it depends on
        text_ros2: the same in ROS 2's words
        md5: ROS 1's checksum
        ros2_name: such as "sensor_msgs/msg/JointState"
        dds_name: such as "sensor_msgs::msg::dds_::JointState_"
    """

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...]
    text_ros1: str
    text_ros2: str
    md5: str
    ros2_name: str
    dds_name: str


@dataclass(frozen=True, eq=False)
class ServiceType:
    """One type of service: its two messages and ROS 1's checksum of both."""

    name: str
    request: MessageType
    response: MessageType
    md5: str
    ros2_name: str


def message_type(name: str | MessageType) -> MessageType:
    """The type of a message, by ROS 1's or by ROS 2's name.

    Raises:
        UnknownNameError: there is none of that name
    """
    if isinstance(name, MessageType):
        return name
    short = name.replace("/msg/", "/", 1)
    if short not in _texts():
        raise UnknownNameError("message type", name, message_names())
    return _message(short)


def service_type(name: str | ServiceType) -> ServiceType:
    """The type of a service, by ROS 1's or by ROS 2's name.

    Raises:
        UnknownNameError: there is none of that name
    """
    if isinstance(name, ServiceType):
        return name
    short = name.replace("/srv/", "/", 1)
    if short not in service_names():
        raise UnknownNameError("service type", name, service_names())
    return _service(short)


@cache
def message_names() -> tuple[str, ...]:
    """Every message that is no half of a service, sorted."""
    return tuple(sorted(_name(path) for path in FOLDER.rglob("*.msg")))


@cache
def service_names() -> tuple[str, ...]:
    """Every service, sorted."""
    return tuple(sorted(_name(path) for path in FOLDER.rglob("*.srv")))


def _name(path: Path) -> str:
    return f"{path.parent.name}/{path.stem}"


@cache
def _texts() -> dict[str, str]:
    """The text of every definition, both halves of a service under their own names."""
    texts = {_name(path): path.read_text(encoding="utf-8") for path in FOLDER.rglob("*.msg")}
    for path in FOLDER.rglob("*.srv"):
        request, response = f"\n{path.read_text(encoding='utf-8')}".split("\n---", 1)
        texts[f"{_name(path)}Request"] = request
        texts[f"{_name(path)}Response"] = response
    return texts


@cache
def _fields(name: str) -> tuple[Field, ...]:
    return read_fields(_texts()[name], name)


@cache
def _constants(name: str) -> tuple[Constant, ...]:
    return read_constants(_texts()[name])


def _md5_text(name: str) -> str:
    """What ROS 1 hashes: constants, then fields, with a message's own sum for its type."""
    fields = [
        f"{_md5(field.type)} {field.ros1_name}" if field.is_message else field.text(ros1=True)
        for field in _fields(name)
    ]
    return "\n".join([*(constant.text() for constant in _constants(name)), *fields])


@cache
def _md5(*names: str) -> str:
    text = "".join(map(_md5_text, names))
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


def _depends(name: str) -> list[str]:
    """Every message inside a message, at any depth, each once, in the order of first mention."""
    found: list[str] = []
    for field in _fields(name):
        if field.is_message:
            found += [field.type, *_depends(field.type)]
    return list(dict.fromkeys(found))


def _full_text(name: str, *, ros1: bool) -> str:
    def lines(of: str) -> str:
        fields = [f.text(ros1) for f in _fields(of) if ros1 or not f.only_ros1]
        constants = [constant.text() for constant in _constants(of)]
        return "".join(f"{line}\n" for line in [*constants, *fields])

    parts = [f"{RULE}\nMSG: {other}\n{lines(other)}" for other in _depends(name)]
    return "\n".join([lines(name), *parts])


@cache
def _message(name: str) -> MessageType:
    package, own = name.split("/")
    folder, ros2 = "msg", own
    if name not in message_names():
        half = "Request" if own.endswith("Request") else "Response"
        folder, ros2 = "srv", f"{own.removesuffix(half)}_{half}"
    return MessageType(
        name=name,
        fields=_fields(name),
        constants=_constants(name),
        text_ros1=_full_text(name, ros1=True),
        text_ros2=_full_text(name, ros1=False),
        md5=_md5(name),
        ros2_name=f"{package}/{folder}/{ros2}",
        dds_name=f"{package}::{folder}::dds_::{ros2}_",
    )


@cache
def _service(name: str) -> ServiceType:
    package, own = name.split("/")
    halves = f"{name}Request", f"{name}Response"
    request, response = map(_message, halves)
    return ServiceType(name, request, response, _md5(*halves), f"{package}/srv/{own}")
