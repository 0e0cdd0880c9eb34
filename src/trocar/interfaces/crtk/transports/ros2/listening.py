"""Hear the topics of a robot on ROS 2."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from trocar.interfaces.crtk.messages import MessageError, cdr_decode
from trocar.interfaces.crtk.transports.ros2 import library, names
from trocar.interfaces.crtk.transports.ros2.bus import Bus, Reader
from trocar.interfaces.crtk.transports.ros2.network import Network, network
from trocar.interfaces.crtk.transports.ros2.quality import Quality

_log = logging.getLogger("trocar")

JOINT_STATE = "sensor_msgs/JointState"
DDS_JOINT_STATE = "sensor_msgs::msg::dds_::JointState_"
WAIT_S = 0.2

Take = Callable[[str, Mapping[str, Any]], None]


class Ros2Listener:
    """Hears joint states over DDS, whoever promises them, reliably or not.

    Args:
        where: domain and network; default: as ROS 2's environment variables say

    Raises:
        MissingExtraError: the extra `ros2` is not installed
        InputError: a variable of ROS 2 that has no possible value
    """

    def __init__(self, where: Network | None = None) -> None:
        library.load()
        self._where = where or network(os.environ)
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None
        self._bus: Bus | None = None

    def start(self, topics: Sequence[str], take: Take) -> None:
        """Join the domain, subscribe and hand over what comes.

        Raises:
            DdsError: no such network, or too many participants
        """
        bus = Bus(self._where.domain, self._where.config, names.user_data(enclave="/"))
        self._bus = bus
        quality = Quality(1, best_effort=True)
        readers = {
            bus.reader(names.topic_name(topic), DDS_JOINT_STATE, quality).entity: topic
            for topic in topics
        }
        self._thread = threading.Thread(
            target=self._listen, args=(bus, readers, take), name="trocar-listen", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Listen no more."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join()
        if self._bus is not None:
            self._bus.close()

    def _listen(self, bus: Bus, readers: Mapping[int, str], take: Take) -> None:
        while not self._ends.is_set():
            for end in bus.wait(WAIT_S):
                if not isinstance(end, Reader):
                    continue
                for taken in end.take():
                    self._hand_over(readers[end.entity], taken.payload, take)

    def _hand_over(self, topic: str, payload: bytes, take: Take) -> None:
        try:
            message = cdr_decode(JOINT_STATE, payload)
        except MessageError as problem:
            _log.debug("/%s: a message that cannot be read: %s", topic, problem)
            return
        take(topic, message)
