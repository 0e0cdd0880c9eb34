"""Virtual time: `time` and `threading` of a script whose simulation is stepped.

Threads take turns: one runs at a time, and time passes only while all of them wait. Which thread
runs next depends on the script and on simulated time alone, so a script with threads is as
repeatable as one without. Names that are not here are the real modules' own.
"""

from __future__ import annotations

import builtins
import itertools
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from trocar.interfaces.crtk.clock import SECOND

#: Looks at the clock or at readings in one moment before time passes by itself: a loop that only
#: looks would otherwise never end. Source: our own choice, more than a control loop makes.
LOOKS = 100


class EndedError(BaseException):
    """Ends a thread of a script whose run is over; no `except Exception` holds it back."""


@dataclass(eq=False)
class Waiter:
    """A thread that waits for its turn.

    Attributes:
        ready: returns whether it may go on
        until_ns: when it gives up; None: never
        go: set when the turn is its own
    """

    ready: Callable[[], bool]
    until_ns: int | None
    go: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))


class Scheduler:
    """Hand the turn from thread to thread, and let time pass when nobody else can go on.

    Args:
        now_ns: returns the time [ns]
        step: lets some time pass, no more than it is given [ns] (None: as it likes), in the thread
            whose turn it is
        tick_ns: the least that passes [ns]
    """

    def __init__(
        self, now_ns: Callable[[], int], step: Callable[[int | None], None], tick_ns: int
    ) -> None:
        self.now_ns, self._step, self._tick_ns = now_ns, step, tick_ns
        self._main = threading.get_ident()
        self._known = {self._main}
        self._waiting: list[Waiter] = []
        self._first: Waiter | None = None
        self._looks, self._looked_ns = 0, -1
        #: Why the run is over, to be raised in the script's own thread.
        self.failure: BaseException | None = None

    def wait(self, ready: Callable[[], bool], timeout_s: float | None) -> bool:
        """Give the turn away until something holds; return whether it does.

        Args:
            ready: the condition; is called often, and changes nothing
            timeout_s: how long at most [s]; None: for ever
        """
        if threading.get_ident() not in self._known:
            raise RuntimeError("only threads started by threading.Thread can wait in virtual time")
        end = None if timeout_s is None else self.now_ns() + max(0, round(timeout_s * SECOND))
        me = Waiter(ready, end)
        while True:
            if self.failure is not None:
                raise self.failure if self._in_main() else EndedError
            if ready():
                return True
            if end is not None and self.now_ns() >= end:
                return ready()
            other = self._next()
            if other is None:
                self._pass(me)
                continue
            if self._in_main():
                self._first = me
            self._waiting.remove(other)
            self._waiting.append(me)
            other.go.release()
            me.go.acquire()

    def sleep(self, seconds: float) -> None:
        """Let some time pass [s]."""
        self.wait(lambda: False, seconds)

    def look(self) -> None:
        """Count a look at the clock or a reading; time passes when a script does nothing else."""
        now = self.now_ns()
        if now != self._looked_ns:
            self._looks, self._looked_ns = 0, now
        self._looks += 1
        if self._looks > LOOKS:
            self.sleep(self._tick_ns / SECOND)

    def begin(self, body: Callable[[], None]) -> None:
        """Run a function in a thread of its own, when its turn comes."""
        me = Waiter(lambda: True, None)

        def run() -> None:
            self._known.add(threading.get_ident())
            me.go.acquire()
            try:
                body()
            except EndedError:
                pass
            finally:
                self._known.discard(threading.get_ident())
                self._leave()

        self._waiting.append(me)
        threading.Thread(target=run, name="trocar-script", daemon=True).start()

    def _in_main(self) -> bool:
        return threading.get_ident() == self._main

    def _most(self, *more: Waiter) -> int | None:
        """Return how much time may pass until somebody gives up waiting [ns]."""
        ends = [w.until_ns for w in (*self._waiting, *more) if w.until_ns is not None]
        return min(ends) - self.now_ns() if ends else None

    def _pass(self, me: Waiter) -> None:
        try:
            self._step(self._most(me))
        except BaseException as failure:
            if self._in_main() and isinstance(failure, KeyboardInterrupt):
                raise  # the script may still tidy up
            self.failure = failure
            if self._in_main():
                raise
            raise EndedError from None

    def _due(self, waiter: Waiter) -> bool:
        late = waiter.until_ns is not None and self.now_ns() >= waiter.until_ns
        return late or (self.failure is not None and waiter is self._first) or waiter.ready()

    def _next(self) -> Waiter | None:
        return next((waiter for waiter in self._waiting if self._due(waiter)), None)

    def _leave(self) -> None:
        """Hand the turn on for good; the script's own thread always waits for it."""
        while True:
            if self.failure is not None and self._first in self._waiting:
                other = self._first
            else:
                other = self._next()
            if other is not None:
                self._waiting.remove(other)
                other.go.release()
                return
            try:
                self._step(self._most())
            except BaseException as failure:  # noqa: BLE001  raised in the script's own thread
                self.failure = failure


def _patience(blocking: bool, timeout: float | None) -> float | None:
    """Return how long to wait [s] of the arguments of `acquire`; None: for ever."""
    if not blocking:
        return 0.0
    return None if timeout is None or timeout < 0 else timeout


class Lock:
    """A lock that one thread holds at a time; an `RLock` is reentrant."""

    scheduler: Scheduler
    again = False

    def __init__(self) -> None:
        self._owner: int | None = None
        self._count = 0

    def acquire(self, blocking: bool = True, timeout: float | None = -1) -> bool:
        """Take the lock; return whether it was to be had in time [s]."""
        me = threading.get_ident()
        if not (self.again and self._owner == me):
            free = self.scheduler.wait(lambda: self._owner is None, _patience(blocking, timeout))
            if not free:
                return False
        self._owner, self._count = me, self._count + 1
        return True

    def release(self) -> None:
        """Release the lock."""
        if self._owner is None:
            raise RuntimeError("release unlocked lock")
        self._count -= 1
        if self._count == 0:
            self._owner = None

    def locked(self) -> bool:
        """Return whether it is held."""
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
        self.scheduler.wait(lambda: self._owner is None, None)
        self._owner, self._count = state


class RLock(Lock):
    """A lock that its owner can take again."""

    again = True


class Condition:
    """A condition variable on a lock."""

    scheduler: Scheduler
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
            return self.scheduler.wait(lambda: ticket[0], timeout)
        finally:
            self._lock._acquire_restore(state)
            if ticket in self._tickets:
                self._tickets = [one for one in self._tickets if one is not ticket]

    def wait_for(self, predicate: Callable[[], Any], timeout: float | None = None) -> Any:
        """Wait until a predicate holds; return its value [s]."""
        end = None if timeout is None else self.scheduler.now_ns() + timeout * SECOND
        while not (found := predicate()):
            left = None if end is None else (end - self.scheduler.now_ns()) / SECOND
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

    scheduler: Scheduler

    def __init__(self) -> None:
        self._flag = False

    def is_set(self) -> bool:
        """Return whether it is set."""
        self.scheduler.look()
        return self._flag

    def set(self) -> None:
        """Set it."""
        self._flag = True

    def clear(self) -> None:
        """Take it back."""
        self._flag = False

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it is set; return whether it is within some time [s]."""
        return self.scheduler.wait(lambda: self._flag, timeout)


class Thread:
    """A thread that runs while the others wait."""

    scheduler: Scheduler
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
        self.scheduler.begin(self._work)

    def run(self) -> None:
        """Call the target."""
        if self._target is not None:
            self._target(*self._args, **self._kwargs)

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended [s]."""
        self.scheduler.wait(lambda: not self._alive, timeout)

    def is_alive(self) -> bool:
        """Return whether it runs."""
        self.scheduler.look()
        return self._alive

    def _work(self) -> None:
        self.ident = threading.get_ident()
        try:
            self.run()
        except (SystemExit, EndedError):
            pass
        except BaseException:  # noqa: BLE001  as the real one: printed, and the others go on
            sys.stderr.write(f"Exception in thread {self.name}:\n")
            traceback.print_exc()
        finally:
            self._alive = False

    def setDaemon(self, daemonic: bool) -> None:
        """Set whether the script may end before it."""
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


def thread_classes(scheduler: Scheduler) -> dict[str, Any]:
    """Return the stand-ins for the classes of `threading`, over one simulation."""
    shared: dict[str, Any] = {"scheduler": scheduler}
    lock, rlock = (type(kind.__name__, (kind,), shared) for kind in (Lock, RLock))
    event = type("Event", (Event,), shared)
    condition = type("Condition", (Condition,), {**shared, "lock_class": rlock})
    semaphore = type("Semaphore", (Semaphore,), {"condition_class": condition})
    own = {**shared, "started": [], "numbers": itertools.count(1)}
    return {
        "Lock": lock,
        "RLock": rlock,
        "Condition": condition,
        "Semaphore": semaphore,
        "BoundedSemaphore": semaphore,
        "Event": event,
        "Thread": type("Thread", (Thread,), own),
        "Timer": type("Timer", (Timer,), {**own, "event_class": event}),
    }


#: How long a person takes to answer `input`, in simulated time; our own choice. [s]
ANSWER_S = 1.0


class Standing(ModuleType):
    """A module that has some names of its own; the others are a real module's.

    Args:
        real: that module
        own: {name: value}
    """

    def __init__(self, real: ModuleType, own: Mapping[str, Any]) -> None:
        super().__init__(real.__name__, real.__doc__)
        self.__dict__.update(own)
        self.__dict__["_real"] = real
        self.__dict__["__spec__"] = real.__spec__

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_real"], name)

    def __dir__(self) -> list[str]:
        return sorted({*dir(self.__dict__["_real"]), *self.__dict__})


def virtual_modules(scheduler: Scheduler) -> dict[str, ModuleType]:
    """Return stand-ins for `time` and `threading`, whose time is that of stamps."""

    def now_ns() -> int:
        scheduler.look()
        return scheduler.now_ns()

    def now() -> float:
        return now_ns() / SECOND

    def sleep(seconds: float) -> None:
        if seconds < 0:
            raise ValueError("sleep length must be non-negative")
        scheduler.sleep(seconds)

    names = ("time", "monotonic", "perf_counter")
    clock: dict[str, Any] = {"sleep": sleep, **dict.fromkeys(names, now)}
    clock |= dict.fromkeys((f"{name}_ns" for name in names), now_ns)
    threads = {**thread_classes(scheduler), "monotonic": now}
    return {"time": Standing(time, clock), "threading": Standing(threading, threads)}


@contextmanager
def answering(scheduler: Scheduler) -> Iterator[None]:
    """Let time pass whenever the script waits for a line, until the block ends."""
    read = builtins.input

    def answer(prompt: object = "", /) -> str:
        line = read(prompt)
        scheduler.sleep(ANSWER_S)
        return line

    builtins.input = answer
    try:
        yield
    finally:
        builtins.input = read
