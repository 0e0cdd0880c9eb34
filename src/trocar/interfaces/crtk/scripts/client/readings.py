"""Readings of a topic: the newest message, waited for where there is none yet or it is too old."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Reading:
    """Reads a topic.

    Args:
        ral: the layer of the device's namespace
        name: of the topic
        kind: of its messages
        timeout_s: how old a message may be, and how long to wait for one [s]
    """

    def __init__(self, ral: Any, name: str, kind: str, timeout_s: float) -> None:
        self._ral, self._name, self._timeout = ral, name, timeout_s
        self._latest = ral.latest(name, kind)

    def message(self, age: float | None = None, wait: float | None = None) -> Any:
        """Return the newest message.

        Args:
            age: how old it may be [s]; 0: any that came; as the object was made, when omitted
            wait: how long to wait for a newer one [s]; as the object was made, when omitted

        Raises:
            TimeoutError: none came
        """
        self._ral.look()
        newest = self._latest.get()
        most = self._timeout if age is None else age
        if newest is not None and (self._latest.fresh or self._young(newest, most)):
            return newest
        patience = self._timeout if wait is None else wait
        if patience > 0.0 and self._ral.wait(lambda: self._latest.get() is not newest, patience):
            found = self._latest.get()
            if found is not None:
                return found
        raise TimeoutError(
            f"unable to get {self._name} ({self._latest.name}): no message within {patience:g} s"
        )

    def getter(self, value: Callable[[Any], Any]) -> Callable[..., Any]:
        """Return a method that returns (value, time [s]) of the newest message."""

        def get(
            age: float | None = None,
            wait: float | None = None,
            extra: Any = None,  # noqa: ARG001  before 1.4 it asked for the time
            wait_timeout: float | None = None,
        ) -> tuple[Any, float]:
            message = self.message(age, wait if wait_timeout is None else wait_timeout)
            return value(message), self._ral.to_sec(message)

        get.__name__ = self._name
        return get

    def whole(self, *values: Callable[[Any], Any]) -> Callable[..., Any]:
        """Return a method that returns several values of the newest message, and its time [s]."""

        def get(
            age: float | None = None,
            wait: float | None = None,
            wait_timeout: float | None = None,
        ) -> tuple[Any, ...]:
            message = self.message(age, wait if wait_timeout is None else wait_timeout)
            return (*(value(message) for value in values), self._ral.to_sec(message))

        get.__name__ = self._name
        return get

    def _young(self, message: Any, age: float) -> bool:
        if age == 0.0 or not hasattr(message, "header"):
            return True
        return self._ral.to_sec(self._ral.now() - self._ral.get_timestamp(message)) <= age
