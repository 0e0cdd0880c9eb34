"""`dvrk.console`, `dvrk.system` and `dvrk.teleop_psm`: what is no arm."""

from __future__ import annotations

from typing import Any

from trocar.interfaces.crtk.scripts.client.arms import publisher

BOOL, FLOAT, EMPTY, STRING = (f"std_msgs/{name}" for name in ("Bool", "Float64", "Empty", "String"))
COMMAND = "crtk_msgs/StringStamped"


class console:  # noqa: N801  as scripts call it
    """The surgeon's console: teleoperation of the whole system."""

    def __init__(self, ral: Any, console_name: str = "console") -> None:
        self._ral = ral.create_child(console_name)
        self._enable = publisher(self._ral, "teleop/enable", BOOL)
        self._set_scale = publisher(self._ral, "teleop/set_scale", FLOAT)
        self._scale = _Value(self._ral, "teleop/scale")

    def teleop_start(self) -> None:
        """Switch teleoperation on."""
        self._enable(True)

    def teleop_stop(self) -> None:
        """Switch teleoperation off."""
        self._enable(False)

    def teleop_set_scale(self, scale: float) -> None:
        """Set how far instruments move for the masters' motion."""
        self._set_scale(float(scale))

    def teleop_get_scale(self) -> float:
        """Return how far instruments move for the masters' motion; 0 before it is told."""
        return self._scale.value()


class system:  # noqa: N801  as scripts call it
    """The whole robot: power, homing, sounds."""

    def __init__(self, ral: Any, system_namespace: str = "system") -> None:
        self._ral = ral.create_child(system_namespace)
        self._power_off = publisher(self._ral, "power_off", EMPTY)
        self._power_on = publisher(self._ral, "power_on", EMPTY)
        self._home = publisher(self._ral, "home", EMPTY)
        self._set_volume = publisher(self._ral, "set_volume", FLOAT)
        self._speak = publisher(self._ral, "string_to_speech", STRING)
        self._matrix = self._ral.message("std_msgs/Float64MultiArray")
        self._beep = self._ral.publisher("beep", self._matrix, queue_size=1)

    def power_off(self) -> None:
        """Take every arm's power."""
        self._power_off()

    def power_on(self) -> None:
        """Give every arm power."""
        self._power_on()

    def home(self) -> None:
        """Bring every arm home."""
        self._home()

    def set_volume(self, volume: float) -> None:
        """Set the volume of sounds, 0 to 1."""
        self._set_volume(float(volume))

    def beep(self, duration: float, frequency: float, volume: float = 1.0) -> None:
        """Sound for some time [s] at a frequency [Hz] and a volume, 0 to 1."""
        message = self._matrix()
        message.data = [float(duration), float(frequency), float(volume)]
        shape = self._ral.message("std_msgs/MultiArrayDimension")()
        shape.label, shape.size, shape.stride = "values", len(message.data), 1
        message.layout.dim.append(shape)
        self._beep.publish(message)

    def string_to_speech(self, string: str) -> None:
        """Say something."""
        self._speak(string)


class teleop_psm:  # noqa: N801  as scripts call it
    """A component that lets an instrument follow a master."""

    def __init__(self, ral: Any, teleop_name: str) -> None:
        self._ral = ral.create_child(teleop_name)
        self._set_scale = publisher(self._ral, "set_scale", FLOAT)
        self._command = self._ral.publisher(
            "state_command", self._ral.message(COMMAND), queue_size=1
        )
        self._scale = _Value(self._ral, "scale")

    def set_scale(self, scale: float) -> None:
        """Set how far the instrument moves for the master's motion."""
        self._set_scale(float(scale))

    def get_scale(self) -> float:
        """Return how far the instrument moves for the master's motion; 0 before it is told."""
        return self._scale.value()

    def enable(self) -> None:
        """Switch the component on."""
        self._tell("enable")

    def disable(self) -> None:
        """Switch the component off."""
        self._tell("disable")

    def _tell(self, word: str) -> None:
        message = self._ral.message(COMMAND)()
        message.string = word
        self._command.publish(message)


class _Value:
    """The newest number of a topic."""

    def __init__(self, ral: Any, topic: str) -> None:
        self._ral, self._newest = ral, 0.0
        ral.listen(topic, FLOAT, self._heard)

    def _heard(self, message: Any) -> None:
        self._newest = message.data

    def value(self) -> float:
        """Return it; 0 before the first."""
        self._ral.look()
        return self._newest
