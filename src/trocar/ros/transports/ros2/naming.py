"""Names, type hashes and the description of the node: what ROS 2's tools read of DDS.

Source: ROS 2 design, "Topic and Service name mapping to DDS"; USER_DATA as rmw_dds_common and
rmw_cyclonedds_cpp write it (Jazzy).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from trocar.errors import MissingExtraError
from trocar.messages import MessageType

GRAPH_TOPIC = "ros_discovery_info"
GRAPH_TYPE = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
#: Distributions whose Gid has 24 octets; since Iron it has 16, and endpoints carry type hashes.
#: Source: rmw, RMW_GID_STORAGE_SIZE.
OLDER_DISTRIBUTIONS = frozenset({"dashing", "eloquent", "foxy", "galactic", "humble"})


def topic_name(name: str) -> str:
    """Return the DDS name of the topic `name`, which has no leading slash."""
    return f"rt/{name}"


def request_name(service: str) -> str:
    """Return the DDS topic of a service's requests."""
    return f"rq/{service}Request"


def reply_name(service: str) -> str:
    """Return the DDS topic of a service's replies."""
    return f"rr/{service}Reply"


def user_data(**values: str) -> bytes:
    """Return USER_DATA, such as `typehash=RIHS01_...;`."""
    return "".join(f"{key}={value};" for key, value in values.items()).encode()


def read_user_data(data: bytes, key: str) -> str | None:
    """Return the value of `key` in USER_DATA, None without one."""
    for entry in data.decode(errors="replace").split(";"):
        name, sign, value = entry.partition("=")
        if sign and name == key:
            return value
    return None


def endpoint_id(participant: bytes, number: int) -> str:
    """Return the text by which a service's reader and writer are known to belong together.

    Args:
        participant: the participant's GUID, 16 bytes
        number: of the service, from 1
    """
    octets = participant[:12] + number.to_bytes(4, "big")
    return ".".join([f"{octets[0]:2x}", *(f"{octet:x}" for octet in octets[1:])])


@cache
def typestore(distribution: str) -> Any:
    """Return rosbags' types of a distribution, such as "ROS2_JAZZY" or "EMPTY".

    Raises:
        MissingExtraError: the extra `ros2` is not installed
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("rosbags", "ros2", "ROS 2") from None
    return get_typestore(Stores[distribution])


@cache
def type_hash(kind: MessageType) -> str:
    """Return "RIHS01_..." of a message, or of one half of a service. Source: REP-2016."""
    store = typestore("EMPTY")
    from rosbags.typesys import get_types_from_msg

    types = get_types_from_msg(kind.text_ros2, kind.ros2_name)
    store.register({name.replace("/srv/msg/", "/srv/"): found for name, found in types.items()})
    return store.hash_rihs01(kind.ros2_name)


def entities_info(
    participant: bytes,
    node: str,
    readers: Sequence[bytes],
    writers: Sequence[bytes],
    *,
    older: bool = False,
) -> bytes:
    """Return the CDR bytes that describe one node in the root namespace.

    Args:
        participant: GUID, 16 bytes
        node: its name, without a slash
        readers: GUIDs of its subscriptions and of its services' requests
        writers: GUIDs of its publications and of its services' replies
        older: in the form of ROS 2 Humble and before
    """
    store, package = typestore("ROS2_HUMBLE" if older else "ROS2_JAZZY"), "rmw_dds_common/msg/"
    kinds, size = store.types, 24 if older else 16

    def gid(guid: bytes) -> Any:
        data = np.frombuffer(guid.ljust(size, b"\0"), np.uint8)
        return kinds[f"{package}Gid"](data=data)

    described = kinds[f"{package}NodeEntitiesInfo"](
        "/", node, [gid(guid) for guid in readers], [gid(guid) for guid in writers]
    )
    info = kinds[f"{package}ParticipantEntitiesInfo"](gid(participant), [described])
    return bytes(store.serialize_cdr(info, f"{package}ParticipantEntitiesInfo"))
