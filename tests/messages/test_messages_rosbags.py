"""Bytes of every type, compared with those of an implementation that none of us wrote."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

from tests.messages.content import ALL, each_type, plain, random_message
from trocar.messages import (
    MessageType,
    cdr_decode,
    cdr_encode,
    message_type,
    ros1_decode,
    ros1_encode,
)

# Packages whose definitions rosbags carries.
DISTRIBUTED = ("std_msgs", "sensor_msgs", "geometry_msgs", "rosgraph_msgs", "tf2_msgs")

typesys = pytest.importorskip("rosbags.typesys")


@pytest.fixture(scope="module")
def stores() -> dict[str, Any]:
    """ROS's own definitions; what ROS does not have comes from our texts."""
    names = typesys.Stores
    return {
        "ros1": typesys.get_typestore(names.ROS1_NOETIC),
        "humble": typesys.get_typestore(names.ROS2_HUMBLE),
        "jazzy": typesys.get_typestore(names.ROS2_JAZZY),
    }


def known(store: Any, kind: MessageType, ros1: bool) -> str:
    """The name under which a store has a type."""
    name = kind.ros2_name.replace("/srv/", "/msg/")
    if name not in store.fielddefs:
        text = kind.text_ros1 if ros1 else kind.text_ros2
        found = typesys.get_types_from_msg(text, name)
        store.register({key: value for key, value in found.items() if key not in store.fielddefs})
    return name


def theirs(store: Any, name: str, message: dict[str, Any], kind: MessageType, ros1: bool) -> Any:
    """The message as an object of rosbags."""
    values: dict[str, Any] = {}
    if not store.fielddefs[name][1]:
        return store.types[name]()
    for field in kind.fields:
        value = 0 if field.only_ros1 else message[field.name]
        if field.only_ros1 and not ros1:
            continue
        values[field.ros1_name if ros1 else field.name] = their_value(store, field, value, ros1)
    if not values:
        values = {"structure_needs_at_least_one_member": 0}
    return store.types[name](**values)


def their_value(store: Any, field: Any, value: Any, ros1: bool) -> Any:
    if field.is_message:
        kind = message_type(field.type)
        name = known(store, kind, ros1)
        if field.length is None:
            return theirs(store, name, value, kind, ros1)
        return [theirs(store, name, entry, kind, ros1) for entry in value]
    if field.type in ("time", "duration"):
        name = f"builtin_interfaces/msg/{field.type.capitalize()}"
        return store.types[name](*value)
    if field.length is None or field.type == "string":
        return value
    return np.array(list(value), dtype=field.type)


@each_type()
@pytest.mark.parametrize("edition", ["humble", "jazzy"])
def test_ros_2_reads_and_writes_the_same_bytes(
    kind: MessageType, edition: str, stores: dict[str, Any]
) -> None:
    store, rng = stores[edition], random.Random(kind.name)
    name = known(store, kind, ros1=False)
    for _ in range(30):
        message = random_message(kind, rng)
        data = bytes(store.serialize_cdr(theirs(store, name, message, kind, False), name))
        assert cdr_encode(kind, message) == data
        assert plain(cdr_decode(kind, data)) == plain(message)


@each_type()
def test_ros_1_reads_and_writes_the_same_bytes(kind: MessageType, stores: dict[str, Any]) -> None:
    store, rng = stores["ros1"], random.Random(kind.name)
    name = known(store, kind, ros1=True)
    for _ in range(30):
        message = random_message(kind, rng)
        data = bytes(store.serialize_ros1(theirs(store, name, message, kind, True), name))
        assert ros1_encode(kind, message) == data
        assert plain(ros1_decode(kind, data)) == plain(message)


@each_type([kind for kind in ALL if kind.name.split("/")[0] in DISTRIBUTED])
@pytest.mark.parametrize("edition", ["ros1", "humble", "jazzy"])
def test_fields_stand_as_the_distributions_have_them(
    kind: MessageType, edition: str, stores: dict[str, Any]
) -> None:
    store, ros1 = stores[edition], edition == "ros1"
    if kind.ros2_name not in store.fielddefs:
        return  # the edition has no such type of its own
    fields = [f for f in kind.fields if ros1 or not f.only_ros1]
    names = [f.ros1_name if ros1 else f.name for f in fields]
    their_names = [name for name, _ in store.fielddefs[kind.ros2_name][1]]
    # rosbags gives a message without fields ROS 2's one byte in both editions.
    assert (names or ["structure_needs_at_least_one_member"]) == their_names
    if ros1:
        assert store.generate_msgdef(kind.ros2_name)[1] == kind.md5
