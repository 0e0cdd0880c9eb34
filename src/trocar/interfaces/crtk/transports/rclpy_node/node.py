"""A node of rclpy, and the thread in which its callbacks run."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trocar.interfaces.crtk.transports.rclpy_node.library import Library

_log = logging.getLogger("trocar")

PAUSE_S = 0.1
"""Before going on after rclpy has failed [s]. Source: our own choice."""

CLOSING_S = 5.0
"""How long callbacks may take to end [s]. Source: our own choice, as long as a call may take."""


class NoAnswerError(Exception):
    """Raised by a service's callback so that rclpy answers nothing; the reason was told."""


class Node:
    """A node; its executor has one thread, since rclpy's for several costs much more.

    Args:
        library: rclpy
        context: initialised
        name: of the node

    Attributes:
        own: rclpy's node
    """

    def __init__(self, library: Library, context: Any, name: str) -> None:
        self._library, self._context = library, context
        self.own = library.rclpy.create_node(
            name,
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = library.executors.SingleThreadedExecutor(context=context)
        self._executor.add_node(self.own)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._spin, name=f"trocar-ros2-{name}", daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """End after the callback that runs, and leave."""
        self._over.set()
        self._executor.shutdown(timeout_sec=CLOSING_S)
        if self._thread.is_alive():
            self._thread.join(CLOSING_S)
        self.own.destroy_node()

    def _spin(self) -> None:
        while not self._over.is_set() and self._context.ok():
            try:
                self._executor.spin_once()
            except NoAnswerError:
                continue
            except Exception:  # noqa: BLE001  rclpy passes on whatever went wrong within
                if self._over.is_set() or not self._context.ok():
                    break
                _log.exception("ROS 2: rclpy has failed, and goes on")
                self._over.wait(PAUSE_S)
        if not self._over.is_set():
            _log.warning("ROS 2 has ended: something has shut rclpy down; the simulation goes on")
