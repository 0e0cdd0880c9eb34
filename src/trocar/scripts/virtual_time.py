"""Virtual time: `time` and `threading` of a script whose simulation is stepped.

Threads take turns: one runs at a time, and time passes only while all of them wait. Which thread
runs next depends on the script and on simulated time alone, so a script with threads is as
repeatable as one without. Names that are not here are the real modules' own.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import itertools
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from trocar.ros.clock import SECOND

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
    """Run one thread at a time, and advance time when none can continue.

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
        #: The error that ended the run, to be raised in the script's own thread.
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
        """Count a reading of clock or topic; time advances when a script does nothing else."""
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
        """Return the time until the first wait times out [ns]."""
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


class Lock:
    """A lock that one thread holds at a time."""

    scheduler: Scheduler

    def __init__(self) -> None:
        self._held = False

    def acquire(self, blocking: bool = True, timeout: float | None = -1) -> bool:
        """Take the lock; return whether it was to be had in time [s]."""
        patience = 0.0 if not blocking else None if timeout is None or timeout < 0 else timeout
        free = self.scheduler.wait(lambda: not self._held, patience)
        self._held = True
        return free

    def release(self) -> None:
        """Release the lock."""
        if not self._held and self.scheduler.failure is None:  # else the run is over
            raise RuntimeError("release unlocked lock")
        self._held = False

    def locked(self) -> bool:
        """Return whether it is held."""
        return self._held

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class VirtualThread:
    """A thread that runs while the others wait."""

    scheduler: Scheduler
    started: list[VirtualThread]
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


#: Classes of `threading` that stand on locks alone.
ON_LOCKS = {"_RLock", "Condition", "Semaphore", "BoundedSemaphore", "Event", "Barrier", "Timer"}


def thread_classes(scheduler: Scheduler) -> dict[str, Any]:
    """Return the stand-ins for the classes of `threading`, over one simulation.

    Threads and locks are ours; what the standard library builds of locks is its own code, on ours.
    """
    lock = type("Lock", (Lock,), {"scheduler": scheduler})
    thread = type(
        "Thread",
        (VirtualThread,),
        {"scheduler": scheduler, "started": [], "numbers": itertools.count(1)},
    )
    names: dict[str, Any] = {
        **vars(threading),
        "Lock": lock,
        "_allocate_lock": lock,
        "Thread": thread,
        "_time": lambda: scheduler.now_ns() / SECOND,
        "RLock": lambda: names["_RLock"](),
    }
    library = ast.parse(inspect.getsource(threading))
    chosen: list[ast.stmt] = [
        node for node in library.body if isinstance(node, ast.ClassDef) and node.name in ON_LOCKS
    ]
    exec(compile(ast.Module(chosen, []), str(threading.__file__), "exec"), names)

    class VirtualEvent(names["Event"]):
        """An event; reading it may advance time."""

        def is_set(self) -> bool:
            scheduler.look()
            return super().is_set()  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]  compiled above

    names["Event"] = VirtualEvent
    own = ("Lock", "RLock", "Thread", *(name for name in ON_LOCKS if not name.startswith("_")))
    return {name: names[name] for name in own}


#: Simulated time that an answer to `input` takes. Source: our own choice. [s]
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
def answering(scheduler: Scheduler) -> Generator[None]:
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
