"""Which network and which domain: ROS 2's own environment variables decide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trocar.errors import InputError
from trocar.interfaces.crtk.transports.ros2 import graph

# Highest that leaves room for its ports. Source: ROS 2, "The ROS_DOMAIN_ID".
LAST_DOMAIN = 232
LOOPBACK = '<Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces>'
# What a reader may get, and fragments as large as the loopback takes: images cost less.
LOOPBACK_GENERAL = (
    f"<General>{LOOPBACK}<MaxMessageSize>65500B</MaxMessageSize>"
    "<FragmentSize>63000B</FragmentSize></General>"
)
# As many processes may take part on this machine as ports allow.
DISCOVERY = (
    "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>{most}</MaxAutoParticipantIndex>{peers}</Discovery>"
)
# A subscriber that died must not stop the others, whatever waits for it; nobody may send 100 MB.
INTERNAL = (
    "<Internal><Watermarks><WhcHigh>256MB</WhcHigh><WhcAdaptive>false</WhcAdaptive></Watermarks>"
    "<MaxSampleSize>32MB</MaxSampleSize></Internal>"
)
NO_MULTICAST = "<General><AllowMulticast>false</AllowMulticast></General>"
#: What a ROS 2 program needs to stay on the loopback beside the simulator.
CLIENT_URI = f"<General>{LOOPBACK}</General>"


@dataclass(frozen=True)
class Network:
    """Where to speak.

    Args:
        domain: ROS_DOMAIN_ID
        config: Cyclone DDS's XML; None: as the environment's CYCLONEDDS_URI says
        reach: in words, for the start line
        set: what a ROS 2 terminal must set to meet us, beside the domain and the RMW
        gid_size: octets of a Gid in the distribution of ROS 2
    """

    domain: int = 0
    config: str | None = None
    reach: str = ""
    set: str = ""
    gid_size: int = graph.GID_SIZE


def network(environment: Mapping[str, str]) -> Network:
    """Read ROS_DOMAIN_ID, CYCLONEDDS_URI, ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_LOCALHOST_ONLY.

    Without any of them: domain 0, on the loopback only.

    Raises:
        InputError: a value that none of them can have
    """
    domain = _domain(environment.get("ROS_DOMAIN_ID", ""))
    size = graph.gid_size(environment.get("ROS_DISTRO"))
    if environment.get("CYCLONEDDS_URI"):
        return Network(domain, None, "where CYCLONEDDS_URI says", "CYCLONEDDS_URI=...", size)
    chosen = _range(environment)
    if chosen == "SUBNET":
        config = DISCOVERY.format(most=32, peers="") + INTERNAL
        return Network(domain, config, "the whole network, without any password", "", size)
    peers = '<Peers><Peer address="{}"/></Peers>'
    if chosen == "LOCALHOST":
        config = NO_MULTICAST + DISCOVERY.format(most=32, peers=peers.format("localhost"))
        same = "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        return Network(domain, config + INTERNAL, "programs on this machine", same, size)
    config = LOOPBACK_GENERAL + DISCOVERY.format(most=120, peers=peers.format("127.0.0.1"))
    return Network(
        domain, config + INTERNAL, "the loopback only", f"CYCLONEDDS_URI='{CLIENT_URI}'", size
    )


def _domain(text: str) -> int:
    if not text:
        return 0
    if not text.isascii() or not text.isdigit() or int(text) > LAST_DOMAIN:
        raise InputError(f"ROS_DOMAIN_ID: got {text!r}; allowed: 0 to {LAST_DOMAIN}")
    return int(text)


def _range(environment: Mapping[str, str]) -> str:
    only = environment.get("ROS_LOCALHOST_ONLY", "")
    if only not in ("", "0", "1"):
        raise InputError(f"ROS_LOCALHOST_ONLY: got {only!r}; allowed: 0, 1")
    if only == "1":
        return "LOOPBACK"
    chosen = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if chosen == "SYSTEM_DEFAULT":
        return "SUBNET"
    if chosen not in ("", "SUBNET", "LOCALHOST"):
        raise InputError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE: got {chosen!r}; "
            "allowed: LOCALHOST, SUBNET, SYSTEM_DEFAULT"
        )
    return chosen or ("SUBNET" if only == "0" else "LOOPBACK")
