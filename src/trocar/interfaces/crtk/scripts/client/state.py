"""The operating state of an arm as its client knows it, and waiting for it."""

from __future__ import annotations

from typing import Any

STATE = "crtk_msgs/OperatingState"
COMMAND = "crtk_msgs/StringStamped"
#: How long a move may take. Source: crtk_python_client, wait_move_handle. [s]
MOVE_S = 30.0


class OperatingState:
    """Listens to `operating_state`, and sends `state_command`.

    Args:
        ral: the layer of the arm's namespace
    """

    #: What an arm's object gets of it, by these names.
    METHODS = (
        "operating_state", "wait_for_operating_state", "state_command", "is_enabled", "enable",
        "is_disabled", "disable", "home", "unhome", "is_homed", "is_busy", "wait_for_busy",
        "pause", "resume",
    )  # fmt: skip

    def __init__(self, ral: Any) -> None:
        self._ral = ral
        self._data = ral.message(STATE)()
        self._last_busy = ral.now()
        self._count = 0
        self._commander = ral.publisher("state_command", ral.message(COMMAND), latch=True)
        ral.listen("operating_state", STATE, self._heard)

    def _heard(self, message: Any) -> None:
        when = self._ral.get_timestamp(message)
        if message.is_busy and when > self._last_busy:
            self._last_busy = when
        if when > self._ral.get_timestamp(self._data):
            self._data = message
        self._count += 1

    def _told(self, value: Any, extra: Any) -> Any:
        self._ral.look()
        return (value, self._ral.to_sec(self._data)) if extra else value

    def operating_state(self, extra: Any = None) -> Any:
        """Return the state, such as "ENABLED"; with `extra`, its time as well [s]."""
        return self._told(self._data.state, extra)

    def is_homed(self, extra: Any = None) -> Any:
        """Tell whether the arm is home; with `extra`, when it said so as well [s]."""
        return self._told(self._data.is_homed, extra)

    def is_enabled(self) -> bool:
        """Tell whether the arm is ENABLED."""
        return self._told(self._data.state, None) == "ENABLED"

    def is_disabled(self) -> bool:
        """Tell whether the arm is DISABLED."""
        return self._told(self._data.state, None) == "DISABLED"

    def is_busy(self, start_time: Any = None, extra: Any = None) -> Any:
        """Tell whether the arm is busy; it counts as busy until it said otherwise since a time."""
        self._ral.look()
        start = self._ral.now() if start_time is None else start_time
        later = self._ral.get_timestamp(self._data) > start
        return self._told(self._data.is_busy if later else True, extra)

    def state_command(self, state: str) -> None:
        """Send a command: enable, disable, home, unhome, pause, resume."""
        message = self._ral.message(COMMAND)()
        message.string = state
        self._commander.publish(message)

    def wait_for_operating_state(self, expected_state: str, timeout: float) -> bool:
        """Wait for a state; return whether it came in time [s]."""
        if timeout < 0.0:
            return False
        return self._ral.wait(lambda: self._data.state == expected_state, timeout)

    def enable(self, timeout: float = 0) -> bool:
        """Enable the arm; return whether it is within some time [s]."""
        return self._reach("enable", "ENABLED", timeout)

    def disable(self, timeout: float = 0) -> bool:
        """Disable the arm; return whether it is within some time [s]."""
        return self._reach("disable", "DISABLED", timeout)

    def pause(self, timeout: float = 0) -> bool:
        """Pause the arm; return whether it is within some time [s]."""
        return self._reach("pause", "PAUSED", timeout)

    def resume(self, timeout: float = 0) -> bool:
        """Let a paused arm go on; return whether it does within some time [s]."""
        return self._reach("resume", "ENABLED", timeout)

    def home(self, timeout: float = 0) -> bool:
        """Bring the arm home; return whether it is within some time [s]."""
        return self._settle("home", True, timeout)

    def unhome(self, timeout: float = 0) -> bool:
        """Forget that the arm is home; return whether it has within some time [s]."""
        return self._settle("unhome", False, timeout)

    def wait_for_busy(
        self, is_busy: bool = False, start_time: Any = None, timeout: float = MOVE_S
    ) -> bool:
        """Wait until the arm is busy, or until it was since a time and is no longer.

        Args:
            is_busy: which
            start_time: as `ral.now()` gives it; now, when omitted
            timeout: how long since then at most [s]
        """
        start = self._ral.now() if start_time is None else start_time
        left = timeout - self._ral.to_sec(self._ral.now() - start)

        def over() -> bool:
            return self._last_busy > start and (is_busy or not self._data.is_busy)

        return left >= 0.0 and self._ral.wait(over, left)

    def _reach(self, command: str, state: str, timeout: float) -> bool:
        there = self._data.state == state
        self.state_command(command)
        return there or self.wait_for_operating_state(state, timeout)

    def _settle(self, command: str, homed: bool, timeout: float) -> bool:
        there, before = self._data.is_homed == homed, self._count
        self.state_command(command)

        def over() -> bool:
            data = self._data
            return self._count > before and data.is_homed == homed and not data.is_busy

        return there or (timeout >= 0.0 and self._ral.wait(over, timeout))


class wait_move_handle:  # noqa: N801  as scripts call it
    """Waits for a move that was just sent.

    Args:
        class_instance: the arm's object, which knows its operating state
        ral: the layer of its namespace
    """

    def __init__(self, class_instance: Any, ral: Any) -> None:
        self._instance, self._ral = class_instance, ral
        self._start = ral.now()

    def wait(self, is_busy: bool = False, timeout: float = MOVE_S) -> bool:
        """Wait until the move has begun (`is_busy`), or until it is over; return whether it is."""
        if self._ral.is_shutdown():
            return False
        return self._known().wait_for_busy(is_busy=is_busy, start_time=self._start, timeout=timeout)

    def is_busy(self, timeout: float = MOVE_S) -> bool:
        """Tell whether the move goes on.

        Raises:
            RuntimeWarning: it was sent longer ago than `timeout` [s]
        """
        if self._ral.now() - self._start > self._ral.create_duration(timeout):
            raise RuntimeWarning("is_busy() called after timeout")
        return self._known().is_busy(start_time=self._start)

    def _known(self) -> Any:
        if not self._instance:
            raise RuntimeWarning("can't wait, class doesn't support CRTK operating state")
        return self._instance
