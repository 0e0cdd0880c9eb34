"""Names as clients spell them: a leading slash or none, types as in ROS 1 or in ROS 2."""

from __future__ import annotations


def plain(name: str) -> str:
    """Return a name of a topic or service as the core has it: "/PSM1/hold" is "PSM1/hold"."""
    return name.removeprefix("/")


def same_type(wanted: str, have: str) -> bool:
    """Whether a client's name of a type means ours: "a/msg/B" and "a/B" are one."""
    short = wanted.replace("/msg/", "/", 1).replace("/srv/", "/", 1)
    return short == have
