"""A core on ROS 2 in this process, and programs that meet it in processes of their own."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path

from tests.ros.served import running
from trocar.ros import Core
from trocar.ros.transports.ros2 import Network, Ros2Transport, network

PEER = Path(__file__).parent / "peer.py"


DOMAINS = count(1)


def private_network() -> Network:
    """Return the loopback: a domain new to this process, with a tag that no other process has."""
    where = network({})
    assert where.config is not None
    tag = f"<Tag>trocar-{uuid.uuid4().hex}</Tag></Discovery>"
    return replace(where, domain=next(DOMAINS), config=where.config.replace("</Discovery>", tag))


class Program:
    """A peer that runs; `tell` waits for its next line."""

    def __init__(self, action: str, where: Network) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(PEER), action, str(where.domain), str(where.config)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.tell() == {"ready": True}

    def tell(self) -> dict:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, "the program ended without a word"
        return json.loads(line)

    def waiting(self) -> bool:
        """Whether it has said something that nobody read yet."""
        assert self.process.stdout is not None
        return bool(select.select([self.process.stdout], [], [], 0)[0])

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


@contextmanager
def program(action: str, where: Network) -> Iterator[Program]:
    """Run a peer for as long as the block."""
    peer = Program(action, where)
    try:
        yield peer
    finally:
        peer.end()


def served(
    rig: str = "psm", where: Network | None = None
) -> AbstractContextManager[tuple[Core, Ros2Transport]]:
    """Run a rig on ROS 2 for as long as the block."""
    return running(Ros2Transport(where or private_network()), rig)
