"""`crtk.ral`: what a CRTK client has of ROS, in this process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from trocar.interfaces.crtk.scripts.message_classes import message_class, service_class
from trocar.interfaces.crtk.scripts.node import Node
from trocar.interfaces.crtk.scripts.times import Duration, Rate, Time

#: How often connections are looked at [s]. Source: crtk_python_client, 100 Hz.
CHECK_S = 0.01


def own_arguments(argv: Sequence[str]) -> list[str]:
    """Return a command line without what is ROS's: `a:=b`, and what stands after --ros-args."""
    left: list[str] = []
    ros = False
    for word in argv:
        if word == "--ros-args":
            ros = True
        elif word == "--" and ros:
            ros = False
        elif not ros and ":=" not in word:
            left.append(word)
    return left


class ral:  # noqa: N801  as scripts call it
    """The layer between a script and ROS.

    Args:
        node_name: of the script
        namespace: what stands before its topics
        node: the one it shares; made by `create_child`
    """

    #: The node beneath every layer of a run; set where the modules of a script are made.
    _node_of_run: ClassVar[Node]

    def __init__(self, node_name: str, namespace: str = "", node: Any = None) -> None:  # noqa: ARG002
        self._node_name, self._namespace = node_name, namespace.strip("/")
        self._node = self._node_of_run
        self._children: dict[str, ral] = {}
        self._publishers: list[Any] = []
        self._subscribers: list[Any] = []

    @staticmethod
    def ros_version() -> int:
        """Return 1: services are called as in ROS 1."""
        return 1

    @staticmethod
    def parse_argv(argv: Sequence[str]) -> list[str]:
        """Return a command line without ROS's own words."""
        return own_arguments(argv)

    def node_name(self) -> str:
        """Return the script's name."""
        return self._node_name

    def namespace(self) -> str:
        """Return what stands before its topics."""
        return self._namespace

    def create_child(self, child_namespace: str) -> ral:
        """Return a layer of a namespace inside this one.

        Raises:
            RuntimeError: there is one of that name
        """
        if child_namespace in self._children:
            raise RuntimeError(f'ral object already has child "{child_namespace}"!')
        child = type(self)(self._node_name, self._named(child_namespace), self._node)
        self._children[child_namespace] = child
        return child

    # ------------------------------------------------------------------ time

    def now(self) -> Time:
        """Return the time that stamps tell."""
        return self._node.now()

    def get_timestamp(self, t: Any) -> Any:
        """Return the stamp of a message, of a header, or what is one."""
        found = getattr(t, "header", t)
        return getattr(found, "stamp", found)

    def set_timestamp(self, msg: Any) -> Any:
        """Stamp a message with the time now, if it has a header; return it."""
        if hasattr(msg, "header"):
            msg.header.stamp = self.now()
        return msg

    def to_sec(self, t: Any) -> float:
        """Return seconds of a time, a duration, or a message's stamp."""
        return self.get_timestamp(t).to_sec()

    def create_duration(self, d: float) -> Duration:
        """Return a length of time [s]."""
        return Duration(float(d))

    def create_rate(self, rate_hz: float) -> Rate:
        """Return what keeps a loop to a frequency [Hz]."""
        return self._node.rate(rate_hz)

    def create_time(self) -> Time:
        """Return time zero."""
        return Time()

    # ------------------------------------------------------------------ life

    def spin(self) -> None:
        """Do nothing: functions are called whenever the script waits."""

    def spin_and_execute(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call a function, and shut down when it returns."""
        self.spin()
        function(*arguments)
        self.shutdown()

    def shutdown(self) -> None:
        """End the node; functions given to `on_shutdown` are called."""
        self._node.shutdown()

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """Have a function called at the end."""
        self._node.on_shutdown(callback)

    def is_shutdown(self) -> bool:
        """Tell whether the node has ended."""
        return self._node.ended

    # ------------------------------------------------------------------ connections

    def publisher(
        self,
        topic: str,
        msg_type: Any,
        queue_size: int = 10,  # noqa: ARG002  nothing waits here
        latch: bool = False,  # noqa: ARG002  nobody comes late here
        *args: Any,  # noqa: ARG002  rospy's and rclpy's own
        **kwargs: Any,  # noqa: ARG002
    ) -> Any:
        """Return what publishes to a topic of this namespace."""
        made = self._node.publisher(self._named(topic), msg_type)
        self._publishers.append(made)
        return made

    def subscriber(
        self,
        topic: str,
        msg_type: Any,
        callback: Callable[[Any], None],
        queue_size: int = 10,
        latch: bool = False,  # noqa: ARG002  what is latched is told anyway
        *args: Any,  # noqa: ARG002
        **kwargs: Any,  # noqa: ARG002
    ) -> Any:
        """Have a function called with each message of a topic of this namespace."""
        made = self._node.subscriber(self._named(topic), msg_type, callback, queue_size)
        self._subscribers.append(made)
        return made

    def service_client(self, name: str, srv_type: Any) -> Any:
        """Return what calls a service of this namespace."""
        return self._node.service(self._named(name), srv_type)

    service_proxy = service_client

    def get_topic_name(self, pubsub: Any) -> str:
        """Return the whole name of a publisher's or subscriber's topic."""
        return pubsub.name

    def check_connections(self, timeout_seconds: float = 5.0, check_children: bool = True) -> None:
        """Wait until every publisher is listened to, and every subscriber is told something.

        Raises:
            TimeoutError: some are not; they are named
        """
        if timeout_seconds == 0.0:
            return
        ends = self._ends(check_children)
        pubs, subs = [p for own, _ in ends for p in own], [s for _, own in ends for s in own]
        every = [*pubs, *subs]
        self._node.wait(lambda: all(end.get_num_connections() for end in every), timeout_seconds)
        if all(end.get_num_connections() for end in every):
            return
        found = [
            self._told(word, own) for word, own in (("Publishers", pubs), ("Subscribers", subs))
        ]
        raise TimeoutError(
            "Timed out waiting for publisher/subscriber connections to establish\n"
            + "\n".join(found) + self._hint(every)
        )  # fmt: skip

    # ------------------------------------------------------------------ what clients build on

    def latest(self, topic: str, kind: str) -> Any:
        """Return what has the newest message of a topic; `kind` as "sensor_msgs/JointState"."""
        made = self._node.latest(self._named(topic), self.message(kind))
        self._subscribers.append(made)
        return made

    def listen(self, topic: str, kind: str, heard: Callable[[Any], None]) -> Any:
        """Have a function called with each message, at once, also before the script waits."""
        made = self._node.listener(self._named(topic), self.message(kind), heard)
        self._subscribers.append(made)
        return made

    def wait(self, ready: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Wait until something holds; return whether it does before the node ends."""
        return self._node.wait(ready, timeout_s)

    def look(self) -> None:
        """Note that the script looks at a reading."""
        self._node.flow.look()

    @staticmethod
    def message(kind: str) -> Any:
        """Return the class of a type of messages."""
        return message_class(kind)

    @staticmethod
    def service_type(kind: str) -> Any:
        """Return the class of a type of services."""
        return service_class(kind)

    def _named(self, name: str) -> str:
        return f"{self._namespace}/{name.strip('/')}".strip("/")

    def _ends(self, children: bool) -> list[tuple[list[Any], list[Any]]]:
        found = [(self._publishers, self._subscribers)]
        for child in self._children.values() if children else ():
            found += child._ends(children)
        return found

    def _told(self, word: str, ends: Sequence[Any]) -> str:
        lost = [end.name for end in ends if not end.get_num_connections()]
        return (
            f"    {word + ':':<12} {len(ends) - len(lost)} connected, {len(lost)} not connected\n"
            f"                 not connected: [{', '.join(lost)}]\n"
        )

    def _hint(self, ends: Sequence[Any]) -> str:
        """Say which arms there are, where one is missing."""
        arms = self._node.flow.core.prefixes.values()
        lost = {end.name.split("/")[1] for end in ends if not end.get_num_connections()}
        known = {name.split("/")[0] for name in arms}
        if lost <= known:
            return ""
        return f"    The rig has {', '.join(arms)}; --rig chooses another (trocar list rigs)\n"
