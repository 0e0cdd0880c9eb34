"""rospy's Timer: a thread of the script that calls a function again and again.

Source of names and behaviour: rospy's public documentation (ROS 1 Noetic).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from trocar.interfaces.crtk.scripts.node import Node
from trocar.interfaces.crtk.scripts.times import SECOND, Duration, Time


@dataclass(frozen=True)
class TimerEvent:
    """What a timer tells the function that it calls.

    Attributes:
        last_expected: when the call before was due, None at the first
        last_real: when it came, None at the first
        current_expected: when this one is due
        current_real: when it comes
        last_duration: how long the call before took, None at the first [s]
    """

    last_expected: Time | None
    last_real: Time | None
    current_expected: Time
    current_real: Time
    last_duration: float | None


def timer_class(node: Node, thread: type[threading.Thread]) -> type:
    """Return rospy's Timer over a node.

    Args:
        node: tells the time and when it is over
        thread: the script's own `threading.Thread`
    """
    # rospy takes durations by the wall clock; a script whose time is stepped knows none
    clock_ns = node.flow.now_ns if node.flow.virtual else time.perf_counter_ns

    class Timer(thread):
        """Calls a function after each period, or once."""

        def __init__(
            self,
            period: Duration,
            callback: Callable[[TimerEvent], object],
            oneshot: bool = False,
            **_: Any,
        ) -> None:
            super().__init__(daemon=True)
            self._over, self._oneshot = False, oneshot
            self._period, self._callback = period, callback
            self._rate = node.rate(1.0 / period.to_sec())
            self._expected = Time.of(node.flow.now_ns()) + period
            self.start()

        def shutdown(self) -> None:
            """Call it no longer."""
            self._over = True

        def run(self) -> None:
            """Call it until that is over."""
            expected, last_expected, last_real, took_s = self._expected, None, None, None
            while not (self._over or node.ended):
                self._rate.sleep()
                if self._over or node.ended:
                    return
                real, begun_ns = Time.of(node.flow.now_ns()), clock_ns()
                self._callback(TimerEvent(last_expected, last_real, expected, real, took_s))
                took_s = (clock_ns() - begun_ns) / SECOND
                last_expected, last_real, expected = expected, real, expected + self._period
                self._over |= self._oneshot

    return Timer
