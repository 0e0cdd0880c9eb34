"""Queues between the core and transports: of images, and of commands that come out of order."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from trocar.rendering.latest_only import LatestOnly
from trocar.ros.core import Core
from trocar.ros.topic import Message, Topic

#: Time from one large message to the next: two at once may be more than a subscriber's socket
#: holds, and what is lost there comes late. Source: our own choice, by the images that
#: `trocar bench interface --transport ros2` counts. [s]
APART_S = 0.002

MOMENT_S = 0.002
"""How long a command is kept [s]. Source: our own choice, some times what a connection is ahead of
another on one machine; set-points (servo_*) are not kept at all."""

WAITING = 512
"""How many may wait. Source: our own choice; the loop itself takes 64."""


class ImageQueue(LatestOnly[Any]):
    """Deliver the newest image of each name in a thread of its own, so that states do not wait.

    Args:
        deliver: called with each image
    """

    def __init__(self, deliver: Callable[[Any], None]) -> None:
        def spaced(image: Any) -> None:
            deliver(image)
            time.sleep(APART_S)

        super().__init__(spaced, "trocar-images")


@dataclass(frozen=True)
class Sent:
    """A command.

    Attributes:
        peer: who sent it
        stamp: (s, ns); (0, 0) or None without one
        state: whether it is of the operating state
        obey: does what it says
    """

    peer: str
    stamp: tuple[int, int] | None
    state: bool
    obey: Callable[[], Any]


def in_order(commands: Sequence[Sent]) -> list[Sent]:
    """Return commands that came at about the same time in the order in which to obey them."""
    unstamped = {c.peer for c in commands if not c.stamp or c.stamp == (0, 0)}
    peers = list(dict.fromkeys(command.peer for command in commands))
    found: list[Sent] = []
    for peer in peers:
        own = [command for command in commands if command.peer == peer]
        if peer in unstamped:
            found += sorted(own, key=lambda command: not command.state)
        else:
            found += sorted(own, key=lambda command: command.stamp or (0, 0))
    return found


class ReorderBuffer:
    """Keep commands for a moment, then apply them in the order of sending, in a thread of its own.

    ROS 1 has a connection for each topic, and rclpy takes one message of each topic in turn, so
    `enable`, `home` and a move that are sent in one go arrive in any order. Commands that all count
    are therefore kept for a moment: those with stamps are then applied by their stamps; of the
    others, those of the operating state come first.

    Args:
        moment_s: how long [s]
    """

    def __init__(self, moment_s: float = MOMENT_S) -> None:
        self._moment_s = moment_s
        self._waiting: queue.Queue[Sent | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._run, name="trocar-order", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def take(
        self,
        core: Core,
        topic: Topic,
        message: Message,
        peer: str,
        stamp: tuple[int, int] | None,
    ) -> None:
        """Hand a command to the core: set-points at once, the rest in order by their stamps."""
        if topic.depth == 1:
            core.receive(topic.name, message, peer)
            return
        state = topic.key == "state_command"
        sent = Sent(peer, stamp, state, lambda: core.receive(topic.name, message, peer))
        if not self.put(sent):
            core.refuse(topic, topic.name, f"{WAITING} commands are already pending", peer)

    def put(self, command: Sent) -> bool:
        """Let a command be obeyed soon; return False when too many wait."""
        try:
            self._waiting.put_nowait(command)
        except queue.Full:
            return False
        return True

    def close(self) -> None:
        """End after what waits."""
        if self._thread.is_alive():
            self._waiting.put(None)
            self._thread.join()

    def _run(self) -> None:
        while (first := self._waiting.get()) is not None:
            time.sleep(self._moment_s)
            commands, over = [first], False
            while not self._waiting.empty():
                command = self._waiting.get()
                over = over or command is None
                commands += [command] if command is not None else []
            for command in in_order(commands):
                command.obey()
            if over:
                return
