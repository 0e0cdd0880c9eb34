"""A simulator and programs that talk to it, each in a process of its own, over one transport."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trocar.apps.benchmarks.arrivals import LATE_S, Arrivals, arrivals, together
from trocar.apps.benchmarks.served import Served, served
from trocar.errors import TrocarError

MODULE = "trocar.apps.benchmarks.listening"

#: What a subscriber saw, and when a process woke that had nothing to do at the same time.
Heard = tuple[Arrivals, Arrivals]


@dataclass(frozen=True)
class Way:
    """How a transport is switched on.

    Attributes:
        words: options of `trocar sim`
        images: what stands behind the name of a topic of images
        address: a regular expression of what the simulator prints when it is there
        module: what has to be importable, and what to do where it is not
        environment: of both processes
    """

    words: tuple[str, ...]
    address: str
    module: tuple[str, str] = ("", "")
    environment: Mapping[str, str] = field(default_factory=dict[str, str])
    images: str = ""


WAYS = {
    "websocket": Way(("--websocket-port", "0"), r"ws://\S+", images="/compressed"),
    "ros1": Way(
        ("--no-websocket", "--ros1"),
        r"https?://\S+",
        ("rospy", "start a rosmaster and use the Python of `make ros1-venv` (docs/ros.md)"),
    ),
    "ros2": Way(
        ("--no-websocket", "--ros2", "dds"),
        r"ROS 2.*",
        ("cyclonedds", "install the extra: pip install 'trocar[ros2]'"),
        {
            "CYCLONEDDS_URI": "<General><Interfaces><NetworkInterface address='127.0.0.1'"
            " multicast='true'/></Interfaces></General>"
        },
    ),
}


def serving(transport: str, *words: str) -> AbstractContextManager[Served]:
    """Run a simulator that serves a transport, with some options, until the block ends."""
    way = WAYS[transport]
    return served(["--no-page", *way.words, *words], way.address, way.environment)


def started(what: str, transport: str, *words: str) -> subprocess.Popen[str]:
    """Start a program of `listening`."""
    return subprocess.Popen(
        [sys.executable, "-m", MODULE, what, transport, *words],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **WAYS[transport].environment},
    )


def told(what: str, transport: str, *words: str) -> Any:
    """Run a program of `listening` and return what it printed."""
    return read(started(what, transport, *words))


def read(process: subprocess.Popen[str]) -> Any:
    """Return what a program printed when it is done.

    Raises:
        TrocarError: it failed
    """
    out, _ = process.communicate()
    if process.returncode != 0:
        raise TrocarError(f"the subscriber ended with exit code {process.returncode}")
    return json.loads(out)


def arrived(
    heard: Mapping[str, Sequence[Sequence[int]]], rate_hz: float, late_s: float = LATE_S
) -> Arrivals:
    """Judge streams, {topic: (stamp, arrival) of each message [ns]}, together."""
    streams = [np.array(pairs, dtype=np.int64).reshape(-1, 2).T for pairs in heard.values()]
    return together([arrivals(stamps, came, rate_hz, late_s) for stamps, came in streams])


def listened(
    transport: str, server: Served, rate_hz: float, topics: Sequence[str], duration_s: float
) -> Heard:
    """Let a subscriber listen, and another process sleep beside it."""
    sleeper = started("sleep", transport, f"{rate_hz:g}", f"{duration_s:g}")
    heard = told("listen", transport, server.address, f"{duration_s:g}", *topics)
    return arrived(heard, rate_hz), arrived(read(sleeper), rate_hz)


def observed(
    transport: str, rig: str, rate_hz: float, topics: Sequence[str], duration_s: float
) -> Arrivals:
    """Run a simulator and a subscriber, and return what the latter saw.

    Raises:
        TrocarError: either failed
    """
    with serving(transport, "--rig", rig, "--rate", f"{rate_hz:g}") as server:
        return listened(transport, server, rate_hz, topics, duration_s)[0]
