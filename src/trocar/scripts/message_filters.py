"""Messages of several topics that belong together, with the names of message_filters.

Source of names and behaviour: the public documentation of message_filters (ROS 1 Noetic, ROS 2
Humble). Sets of approximate times are chosen as soon as they are complete, not the best of all.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from trocar.messages.types import SECOND


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message of either edition [ns]."""
    stamp = message.header.stamp
    return stamp.sec * SECOND + stamp.nanosec


class SimpleFilter:
    """Hands messages to functions."""

    def __init__(self) -> None:
        self._callbacks: list[tuple[Callable[..., Any], tuple[Any, ...]]] = []

    def registerCallback(self, cb: Callable[..., Any], *args: Any) -> int:
        """Have a function called with each message, or set of messages; return its number."""
        self._callbacks.append((cb, args))
        return len(self._callbacks) - 1

    def signalMessage(self, *messages: Any) -> None:
        """Call the functions."""
        for callback, arguments in self._callbacks:
            callback(*messages, *arguments)


class TopicFilter(SimpleFilter):
    """Messages of a topic of ROS 1; the arguments are those of rospy.Subscriber."""

    subscriber: ClassVar[Any]

    def __init__(self, name: str, data_class: Any, *given: Any, **named: Any) -> None:
        super().__init__()
        make: Any = type(self).subscriber
        self.sub = make(name, data_class, self.signalMessage, *given, **named)

    def unregister(self) -> None:
        """Unsubscribe."""
        self.sub.unregister()


class NodeTopicFilter(SimpleFilter):
    """Messages of a topic of ROS 2."""

    def __init__(
        self, node: Any, msg_type: Any, topic: str, qos_profile: Any = 10, **named: Any
    ) -> None:
        super().__init__()
        self.node, self.topic = node, topic
        self.sub = node.create_subscription(
            msg_type, topic, self.signalMessage, qos_profile, **named
        )


class TimeSynchronizer(SimpleFilter):
    """Sets of messages with the same stamp, one of each filter.

    Args:
        fs: the filters
        queue_size: messages of each that wait
    """

    def __init__(self, fs: Sequence[SimpleFilter], queue_size: int) -> None:
        super().__init__()
        self.slop_ns = 0
        self._waiting: list[deque[tuple[int, Any]]] = [deque(maxlen=queue_size) for _ in fs]
        for which, each in enumerate(fs):
            each.registerCallback(self._heard, which)

    def _time_ns(self, message: Any) -> int:
        return stamp_ns(message)

    def _heard(self, message: Any, which: int) -> None:
        self._waiting[which].append((self._time_ns(message), message))
        time, _ = self._waiting[which][-1]
        chosen: list[tuple[int, Any]] = []
        for queue in self._waiting:
            near = min(queue, key=lambda one: abs(one[0] - time), default=None)
            if near is None:
                return
            chosen.append(near)
        times = [one[0] for one in chosen]
        if max(times) - min(times) > self.slop_ns:
            return
        for queue, (until, _) in zip(self._waiting, chosen, strict=True):
            while queue and queue[0][0] <= until:
                queue.popleft()
        self.signalMessage(*(message for _, message in chosen))


class ApproximateTimeSynchronizer(TimeSynchronizer):
    """Sets of messages whose stamps differ by little.

    Args:
        fs, queue_size: as of a `TimeSynchronizer`
        slop: the most that stamps of a set differ [s]
        allow_headerless: messages without a header count from when they come
    """

    now_ns: ClassVar[Any]

    def __init__(
        self,
        fs: Sequence[SimpleFilter],
        queue_size: int,
        slop: float,
        allow_headerless: bool = False,
        **_: Any,
    ) -> None:
        super().__init__(fs, queue_size)
        self.slop_ns = round(slop * SECOND)
        self._headerless = allow_headerless

    def _time_ns(self, message: Any) -> int:
        if self._headerless and not hasattr(message, "header"):
            return type(self).now_ns()
        return stamp_ns(message)
