"""`crtk.joystick_button` and `crtk.measured_cp`: a pedal, and a device that only tells its pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trocar.interfaces.crtk.scripts.client.utils import utils


class joystick_button:  # noqa: N801  as scripts call it
    """One button of a sensor_msgs/Joy.

    Args:
        ral: the layer that the topic's name is inside
        button_name: of the topic, such as "footpedals/coag"
        index: which button of the message
    """

    def __init__(self, ral: Any, button_name: str, index: int = 0) -> None:
        self._ral, self._index = ral, index
        self._value: int | None = None
        self._count = 0
        self._callback: Callable[[int], None] | None = None
        ral.subscriber(button_name, ral.message("sensor_msgs/Joy"), self._heard)

    def _heard(self, message: Any) -> None:
        value: int = message.buttons[self._index]
        self._value, self._count = value, self._count + 1
        if self._callback is not None:
            self._callback(value)

    def set_callback(self, callback: Callable[[int], None] | None = None) -> None:
        """Have a function called with each value."""
        self._callback = callback

    def value(self) -> int | None:
        """Return the last value: 0 released, 1 pressed, 2 quick tap; None before the first."""
        self._ral.look()
        return self._value

    def wait(self, timeout: float | None = None, value: int | None = None) -> bool:
        """Wait for the next value, or for this one; return whether it came in time [s]."""
        before = self._count

        def came() -> bool:
            return self._count > before and (value is None or value == self._value)

        return self._ral.wait(came, timeout)


class measured_cp:  # noqa: N801  as scripts call it
    """A device that only tells its pose: the method `measured_cp()`."""

    measured_cp: Callable[..., Any]

    def __init__(self, ral: Any, expected_interval: float = 0.01) -> None:
        utils(self, ral, max(1.0, expected_interval)).add_measured_cp()
