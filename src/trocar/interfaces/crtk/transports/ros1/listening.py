"""Hear the topics of a robot on ROS 1."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trocar.errors import TrocarError
from trocar.interfaces.crtk.messages import MessageError, message_type, ros1_decode
from trocar.interfaces.crtk.transports.ros1 import library as ros
from trocar.interfaces.crtk.transports.ros1.classes import message_class
from trocar.interfaces.crtk.transports.ros1.master import find_master, settle_address

_log = logging.getLogger("trocar")

JOINT_STATE = "sensor_msgs/JointState"
NODE = "trocar_mirror"

Take = Callable[[str, Mapping[str, Any]], None]


class Ros1Listener:
    """Hears joint states by rospy. A process can have one such node, once."""

    def __init__(self, node: str = NODE) -> None:
        self._node = node
        self._ros: Any = None
        self._subscribers: list[Any] = []

    def start(self, topics: Sequence[str], take: Take) -> None:
        """Join the master, subscribe and hand over what comes.

        Raises:
            MissingRospyError: this Python has no rospy
            MasterError, InputError: no master
            TrocarError: rospy refuses
        """
        self._ros = ros.load()
        settle_address(find_master())
        rospy: Any = self._ros.rospy
        logging.getLogger("rospy").setLevel(logging.CRITICAL)
        rospy.core.configure_logging = lambda *_, **__: None
        options = {"disable_signals": True, "disable_rosout": True, "disable_rostime": True}
        try:
            rospy.init_node(self._node, argv=[], anonymous=True, **options)
        except (rospy.ROSException, ValueError, OSError) as error:
            raise TrocarError(f"--ros1: rospy cannot start its node: {error}") from error
        kind = message_type(JOINT_STATE)
        for topic in topics:
            made = rospy.Subscriber(
                f"/{topic}",
                message_class(self._ros, kind),
                _taker(topic, take),
                queue_size=1,
                tcp_nodelay=True,
            )
            self._subscribers.append(made)

    def close(self) -> None:
        """Listen no more."""
        for subscriber in self._subscribers:
            subscriber.unregister()
        if self._ros is not None:
            self._ros.rospy.signal_shutdown("the mirror is closed")


def _taker(topic: str, take: Take) -> Callable[[Any], None]:
    def taken(message: Any) -> None:
        try:
            take(topic, ros1_decode(JOINT_STATE, message.data))
        except MessageError as problem:
            _log.debug("/%s: a message that cannot be read: %s", topic, problem)

    return taken
