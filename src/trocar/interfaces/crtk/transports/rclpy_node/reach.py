"""How far a node speaks: on this machine only, unless somebody has said anything else.

Left alone, a node of ROS 2 speaks with the whole network, and whoever it meets can move the arms.
Source: ROS 2, "Improved Dynamic Discovery"; a node that keeps to its machine meets those on the
machine that do not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from contextlib import contextmanager

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
#: Who sets one of these has said how far ROS 2 is to speak.
SAID = (
    RANGE,
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "CYCLONEDDS_URI",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
)


@contextmanager
def kept_near(environment: MutableMapping[str, str]) -> Iterator[None]:
    """Let what rclpy reads while the block runs keep it on this machine, unless somebody chose."""
    chosen = any(environment.get(name) for name in SAID)
    before = environment.get(RANGE)
    if not chosen:
        environment[RANGE] = "LOCALHOST"
    try:
        yield
    finally:
        if not chosen:
            environment.pop(RANGE)
            if before is not None:
                environment[RANGE] = before


def reach(environment: Mapping[str, str]) -> str:
    """Tell in words with whom a node speaks."""
    said = {name: environment[name] for name in SAID if environment.get(name)}
    if not said:
        return "with programs on this machine"
    if said.get("ROS_LOCALHOST_ONLY") == "0":
        del said["ROS_LOCALHOST_ONLY"]
    if "ROS_LOCALHOST_ONLY" in said or said.get(RANGE, "").upper() == "LOCALHOST":
        return "with programs on this machine"
    if not said or said == {RANGE: "SUBNET"}:
        return "with the whole network, without any password"
    return f"without any password, where {' and '.join(said)} {'say' if len(said) > 1 else 'says'}"
