"""The message by which `ros2 node list` knows a node, and `ros2 node info` what it owns.

Source: rmw_dds_common/msg/{ParticipantEntitiesInfo,NodeEntitiesInfo,Gid}.msg.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

TOPIC = "ros_discovery_info"
TYPE = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
# Octets of a Gid: 16 since Iron, 24 before. Source: rmw, RMW_GID_STORAGE_SIZE; the two cannot be
# told apart on the wire, so the participants of a domain must agree.
GID_SIZE = 16
OLD_GID_SIZE = 24
OLD_DISTRIBUTIONS = frozenset({"dashing", "eloquent", "foxy", "galactic", "humble"})
ENCAPSULATION = b"\x00\x01\x00\x00"


def gid_size(distribution: str | None) -> int:
    """Return how many octets a Gid has in a distribution of ROS 2; None: in the newer ones."""
    return OLD_GID_SIZE if distribution in OLD_DISTRIBUTIONS else GID_SIZE


def entities_info(
    participant: bytes,
    node: str,
    readers: Sequence[bytes],
    writers: Sequence[bytes],
    *,
    size: int = GID_SIZE,
) -> bytes:
    """Return the CDR bytes that tell of one node in the root namespace.

    Args:
        participant: GUID, 16 bytes
        node: its name, without a slash
        readers: GUIDs of its subscriptions and of its services' requests
        writers: GUIDs of its publications and of its services' replies
        size: of a Gid
    """
    data = bytearray(participant.ljust(size, b"\0"))
    data += struct.pack("<I", 1)
    _string(data, "/")
    _string(data, node)
    for guids in (readers, writers):
        data += bytes(-len(data) % 4) + struct.pack("<I", len(guids))
        data += b"".join(guid.ljust(size, b"\0") for guid in guids)
    return ENCAPSULATION + bytes(data)


def _string(data: bytearray, text: str) -> None:
    octets = text.encode() + b"\0"
    data += bytes(-len(data) % 4) + struct.pack("<I", len(octets)) + octets
