"""What the core asks of a transport."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.messages.forms import Packing
    from trocar.interfaces.crtk.topics import Topic

#: A message in memory: its fields by their names in ROS 2, nested; times are (s, ns).
Message = dict[str, Any]
#: Topics with their messages, or the bytes of these.
Batch = Sequence[tuple["Topic", Any]]


class Transport(Protocol):
    """Carries messages between the core and programs; each has threads of its own."""

    #: "websocket", "ros1", ...
    name: str

    @property
    def packing(self) -> Packing | None:
        """How it writes messages, so that it is given bytes of states; None: it takes messages."""
        ...

    def start(self, core: Core) -> None:
        """Begin; `core` takes messages and calls from any thread from now on."""
        ...

    def wanted(self) -> frozenset[str]:
        """Return the names of the topics that somebody listens to now; asked every period."""
        ...

    def send(self, batch: Batch) -> None:
        """Hand on messages of one period, without waiting; nobody may change them.

        They are those that were wanted, and every event, wanted or not: a transport leaves out
        what it does not serve.
        """
        ...

    def close(self) -> None:
        """End, and let go of sockets and threads."""
        ...
