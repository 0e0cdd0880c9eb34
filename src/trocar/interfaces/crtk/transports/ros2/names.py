"""What topics, services and their owners are called in DDS, so that ROS 2 knows them.

Source: ROS 2 design, "Topic and Service name mapping to DDS"; USER_DATA as rmw_dds_common and
rmw_cyclonedds_cpp write it (Jazzy).
"""

from __future__ import annotations


def topic_name(name: str) -> str:
    """Return the DDS name of the topic `name`, which has no leading slash."""
    return f"rt/{name}"


def request_name(service: str) -> str:
    """Return the DDS topic on which a service listens."""
    return f"rq/{service}Request"


def reply_name(service: str) -> str:
    """Return the DDS topic on which a service answers."""
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
