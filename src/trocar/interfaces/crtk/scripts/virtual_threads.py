"""Threads, locks and events for a script whose threads take turns."""

from __future__ import annotations

import itertools
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from trocar.interfaces.crtk.scripts.stepped import Stepped
from trocar.interfaces.crtk.scripts.turns import EndedError


def _patience(blocking: bool, timeout: float | None) -> float | None:
    """Return how long to wait [s] of the arguments of `acquire`; None: for ever."""
    if not blocking:
        return 0.0
    return None if timeout is None or timeout < 0 else timeout


class Lock:
    """A lock that one thread has at a time, and as often as it likes where it is its own again."""

    flow: Stepped
    again = False

    def __init__(self) -> None:
        self._owner: int | None = None
        self._count = 0

    def acquire(self, blocking: bool = True, timeout: float | None = -1) -> bool:
        """Take the lock; return whether it was to be had in time [s]."""
        me = threading.get_ident()
        if not (self.again and self._owner == me):
            free = self.flow.wait(lambda: self._owner is None, _patience(blocking, timeout))
            if not free:
                return False
        self._owner, self._count = me, self._count + 1
        return True

    def release(self) -> None:
        """Let go of the lock."""
        if self._owner is None:
            raise RuntimeError("release unlocked lock")
        self._count -= 1
        if self._count == 0:
            self._owner = None

    def locked(self) -> bool:
        """Tell whether somebody has it."""
        return self._owner is not None

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()

    def _is_owned(self) -> bool:
        return self._owner == threading.get_ident()

    def _release_save(self) -> tuple[int | None, int]:
        state = self._owner, self._count
        self._owner, self._count = None, 0
        return state

    def _acquire_restore(self, state: tuple[int | None, int]) -> None:
        self.flow.wait(lambda: self._owner is None, None)
        self._owner, self._count = state


class RLock(Lock):
    """A lock that its owner can take again."""

    again = True


class Condition:
    """A condition variable on a lock."""

    flow: Stepped
    lock_class: type[Lock]

    def __init__(self, lock: Any = None) -> None:
        self._lock = self.lock_class() if lock is None else lock
        self._tickets: list[list[bool]] = []
        self.acquire, self.release = self._lock.acquire, self._lock.release

    def __enter__(self) -> bool:
        return self._lock.__enter__()

    def __exit__(self, *details: object) -> None:
        self._lock.__exit__(*details)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait to be notified; return whether that came in time [s]."""
        if not self._lock._is_owned():
            raise RuntimeError("cannot wait on un-acquired lock")
        ticket = [False]
        self._tickets.append(ticket)
        state = self._lock._release_save()
        try:
            return self.flow.wait(lambda: ticket[0], timeout)
        finally:
            self._lock._acquire_restore(state)
            if ticket in self._tickets:
                self._tickets = [one for one in self._tickets if one is not ticket]

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        """Wait until something holds; return what it says [s]."""
        end = None if timeout is None else self.flow.simulated_s + timeout
        while not (found := predicate()):
            left = None if end is None else end - self.flow.simulated_s
            if left is not None and left <= 0.0:
                break
            self.wait(left)
        return found

    def notify(self, n: int = 1) -> None:
        """Wake some who wait."""
        if not self._lock._is_owned():
            raise RuntimeError("cannot notify on un-acquired lock")
        for ticket in self._tickets[:n]:
            ticket[0] = True
        del self._tickets[:n]

    def notify_all(self) -> None:
        """Wake all who wait."""
        self.notify(len(self._tickets))


class Semaphore:
    """A number of places that can be taken."""

    condition_class: type[Condition]

    def __init__(self, value: int = 1) -> None:
        if value < 0:
            raise ValueError("semaphore initial value must be >= 0")
        self._condition, self._value = self.condition_class(), value

    def acquire(self, blocking: bool = True, timeout: float | None = None) -> bool:
        """Take a place; return whether one was to be had in time [s]."""
        with self._condition:
            patience = _patience(blocking, timeout)
            found = bool(self._condition.wait_for(lambda: self._value > 0, patience))
            self._value -= found
        return found

    def release(self, n: int = 1) -> None:
        """Give places back."""
        with self._condition:
            self._value += n
            self._condition.notify(n)

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class Event:
    """A flag that can be waited for."""

    flow: Stepped

    def __init__(self) -> None:
        self._flag = False

    def is_set(self) -> bool:
        """Tell whether it is set."""
        self.flow.look()
        return self._flag

    def set(self) -> None:
        """Set it."""
        self._flag = True

    def clear(self) -> None:
        """Take it back."""
        self._flag = False

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is set; return whether it is within some time [s]."""
        return self.flow.wait(lambda: self._flag, timeout)


class Thread:
    """A thread that runs while the others wait."""

    flow: Stepped
    started: list[Thread]
    numbers: Iterable[int]

    def __init__(
        self,
        group: None = None,  # noqa: ARG002  as the real one
        target: Callable[..., object] | None = None,
        name: str | None = None,
        args: Iterable[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
        *,
        daemon: bool | None = None,
    ) -> None:
        self._target, self._args, self._kwargs = target, tuple(args), dict(kwargs or {})
        self.name = name or f"Thread-{next(iter(self.numbers))}"
        self.daemon = bool(daemon)
        self.ident: int | None = None
        self._alive = self._begun = False

    def start(self) -> None:
        """Let it run when its turn comes."""
        if self._begun:
            raise RuntimeError("threads can only be started once")
        self._begun = self._alive = True
        self.started.append(self)
        self.flow.turns.begin(self._work)

    def run(self) -> None:
        """Call the target."""
        if self._target is not None:
            self._target(*self._args, **self._kwargs)

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended [s]."""
        self.flow.wait(lambda: not self._alive, timeout)

    def is_alive(self) -> bool:
        """Tell whether it runs."""
        self.flow.look()
        return self._alive

    def _work(self) -> None:
        self.ident = threading.get_ident()
        try:
            self.run()
        except (SystemExit, EndedError):
            pass
        except BaseException:  # noqa: BLE001  as the real one: said, and the others go on
            sys.stderr.write(f"Exception in thread {self.name}:\n")
            traceback.print_exc()
        finally:
            self._alive = False

    def setDaemon(self, daemonic: bool) -> None:
        """Say whether the script may end before it."""
        self.daemon = bool(daemonic)


class Timer(Thread):
    """Calls a function after some time [s], unless it is cancelled before."""

    event_class: type[Event]

    def __init__(
        self,
        interval: float,
        function: Callable[..., object],
        args: Iterable[Any] | None = None,
        kwargs: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(target=function, args=args or (), kwargs=kwargs)
        self._interval, self._over = interval, self.event_class()

    def cancel(self) -> None:
        """Call nothing."""
        self._over.set()

    def run(self) -> None:
        """Wait, and call."""
        if not self._over.wait(self._interval):
            super().run()


def thread_classes(flow: Stepped, monotonic: Callable[[], float]) -> dict[str, Any]:
    """Return what stands in for the classes of `threading`, over one simulation."""
    shared = {"flow": flow}
    lock, rlock = (type(kind.__name__, (kind,), shared) for kind in (Lock, RLock))
    event = type("Event", (Event,), shared)
    condition = type("Condition", (Condition,), {**shared, "lock_class": rlock})
    semaphore = type("Semaphore", (Semaphore,), {"condition_class": condition})
    own = {**shared, "started": [], "numbers": itertools.count(1)}
    thread = type("Thread", (Thread,), own)
    timer = type("Timer", (Timer,), {**own, "event_class": event})
    return {
        "Lock": lock,
        "RLock": rlock,
        "Condition": condition,
        "Semaphore": semaphore,
        "BoundedSemaphore": semaphore,
        "Event": event,
        "Thread": thread,
        "Timer": timer,
        "monotonic": monotonic,
    }
