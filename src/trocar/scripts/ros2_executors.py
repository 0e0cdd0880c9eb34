"""Executors, callback groups and futures of rclpy: callbacks run where a script spins its nodes.

Source of names and behaviour: rclpy's public documentation (ROS 2 Humble and Jazzy).
"""

from __future__ import annotations

import inspect
import threading
from collections import deque
from collections.abc import Callable, Coroutine, Generator, Iterable, Iterator, Sequence
from typing import Any, ClassVar, Protocol

from trocar.scripts.simulation import Flow

#: Threads of a MultiThreadedExecutor that is given no number. Source: our own choice; rclpy takes
#: the number of processors, on which the order of callbacks must not depend.
THREADS = 4


class ExternalShutdownException(Exception):  # noqa: N818  as scripts call it
    """The context was shut down while an executor waited."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(args or ("the context is not valid",)))


class ShutdownException(Exception):  # noqa: N818  as scripts call it
    """The executor was shut down while it waited."""


class TimeoutException(Exception):  # noqa: N818  as scripts call it
    """Nothing was ready in time; never leaves an executor."""


class CallbackGroup:
    """Callbacks of a node that run together, or one after the other."""

    def __init__(self) -> None:
        self.active = 0

    def can_execute(self, entity: Any) -> bool:  # noqa: ARG002  as rclpy's
        """Return whether a callback of the group may begin."""
        return True

    def has_entity(self, entity: Any) -> bool:
        """Return whether a timer, a subscription, ... is in the group."""
        return entity.callback_group is self


class ReentrantCallbackGroup(CallbackGroup):
    """Callbacks that may run beside each other."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Callbacks of which one runs at a time."""

    def can_execute(self, entity: Any) -> bool:  # noqa: ARG002  as rclpy's
        """Return whether no callback of the group runs."""
        return not self.active


class Entity(Protocol):
    """Work of an executor: a timer, a subscription, a client, a service, a task."""

    callback_group: CallbackGroup

    def ready(self) -> bool:
        """Return whether there is something to do."""
        ...

    def take(self) -> Callable[[], Any]:
        """Return the next call, and count it as begun."""
        ...


class RclFuture:
    """A result that is there later.

    Attributes:
        finished: whether it is there, or cancelled
    """

    flow: ClassVar[Flow]

    def __init__(self, *, executor: Any = None) -> None:
        self.finished = self._cancelled = False
        self._result: Any = None
        self._exception: BaseException | None = None
        self._callbacks: list[Callable[[Any], object]] = []
        self._executor = executor

    def __await__(self) -> Generator[Any, None, Any]:
        while not self.finished:
            yield self
        return self.result()

    def done(self) -> bool:
        """Return whether it is there, or cancelled."""
        self.flow.look()
        return self.finished

    def cancelled(self) -> bool:
        """Return whether it was cancelled."""
        return self._cancelled

    def cancel(self) -> None:
        """Give it up."""
        if not self.finished:
            self._cancelled = True
            self._finish()

    def result(self) -> Any:
        """Return it, None before it is there; raise the error that came instead."""
        if self._exception is not None:
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        """Return the error that came instead of a result, None without one."""
        return self._exception

    def set_result(self, result: Any) -> None:
        """Set the result."""
        self._result = result
        self._finish()

    def set_exception(self, exception: BaseException) -> None:
        """Set the error."""
        self._exception = exception
        self._finish()

    def add_done_callback(self, callback: Callable[[Any], object]) -> None:
        """Have a function called with the future once it is there."""
        if self.finished:
            callback(self)
        else:
            self._callbacks.append(callback)

    def _finish(self) -> None:
        self.finished = True
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback(self)


class RclTask(RclFuture):
    """A function or coroutine that an executor runs; the future of what it returns."""

    def __init__(self, work: Any, group: CallbackGroup, arguments: Sequence[Any] = ()) -> None:
        super().__init__()
        self.callback_group = group
        self._work, self._arguments = work, arguments
        self._coroutine: Coroutine[Any, Any, Any] | None = None
        self._awaited: Any = None
        self._running = False

    def ready(self) -> bool:
        """Return whether it can go on."""
        awaited = getattr(self._awaited, "finished", True)
        return not self.finished and not self._running and awaited

    def take(self) -> Callable[[], Any]:
        """Return its next part."""
        self._running = True
        return self._go_on

    def _go_on(self) -> None:
        try:
            if self._coroutine is None:
                made = self._work
                made = made(*self._arguments) if callable(made) else made
                if not inspect.iscoroutine(made):
                    self.set_result(made)
                    return
                self._coroutine = made
            self._awaited = self._coroutine.send(None)
        except StopIteration as end:
            self.set_result(end.value)
        except Exception as problem:
            self.set_exception(problem)
            raise
        finally:
            self._running = False


class SpinExecutor:
    """Runs what is ready of its nodes, in the thread that spins.

    Args:
        context: ends waiting when it is shut down
    """

    run: ClassVar[Any]
    flow: ClassVar[Flow]

    def __init__(self, *, context: Any = None) -> None:
        self.context = context or self.run.default_context
        self._nodes: list[Any] = []
        self._tasks: list[RclTask] = []
        self._pass: Iterator[Entity] = iter(())
        self._over = False
        self._free = ReentrantCallbackGroup()
        self.spinning = 0

    def __enter__(self) -> SpinExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()

    def add_node(self, node: Any) -> bool:
        """Add a node; return whether it is new here."""
        if node in self._nodes:
            return False
        if node.executor is not None:
            node.executor.remove_node(node)
        self._nodes.append(node)
        node.executor = self
        return True

    def remove_node(self, node: Any) -> None:
        """Remove a node."""
        if node in self._nodes:
            self._nodes.remove(node)
            node.executor = None

    def get_nodes(self) -> list[Any]:
        """Return its nodes."""
        return list(self._nodes)

    def create_task(self, callback: Any, *args: Any, **_: Any) -> RclTask:
        """Have a function or coroutine run; return the future of what it returns."""
        task = self.run.Task(callback, self._free, args)
        self._tasks.append(task)
        return task

    def wake(self) -> None:
        """Do nothing: waiting ends by itself when something is ready."""

    def shutdown(self, timeout_sec: float | None = None) -> bool:  # noqa: ARG002
        """End waiting, and let its nodes go."""
        self._over = True
        for node in self.get_nodes():
            self.remove_node(node)
        return True

    def spin(self) -> None:
        """Run callbacks until the context or the executor is shut down."""
        while self.context.ok() and not self._over:
            self.spin_once()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run one callback, waiting for it some time [s]; None: for ever."""
        self._spin_once(timeout_sec, lambda: False)

    def spin_until_future_complete(self, future: RclFuture, timeout_sec: Any = None) -> None:
        """Run callbacks until a future is there, or some time has passed [s]."""
        end = self._end(timeout_sec)
        while self.context.ok() and not self._over and not future.finished:
            left = self._left(end)
            if left is not None and left <= 0.0:
                return
            self._spin_once(left, lambda: future.finished)

    def spin_once_until_future_complete(self, future: RclFuture, timeout_sec: Any = None) -> None:
        """Run one callback, unless a future is there first."""
        self._spin_once(timeout_sec, lambda: future.finished)

    def _spin_once(self, timeout_s: float | None, enough: Callable[[], bool]) -> None:
        self.spinning += 1
        try:
            work = self._wait(timeout_s, enough)
            if work is not None:
                self._execute(*work)
        finally:
            self.spinning -= 1

    def _execute(self, entity: Entity, handler: Callable[[], Any]) -> None:
        try:
            made = handler()
            if inspect.iscoroutine(made):
                self._tasks.append(self.run.Task(made, self._free))
        finally:
            entity.callback_group.active -= 1

    def _wait(
        self, timeout_s: float | None, enough: Callable[[], bool]
    ) -> tuple[Entity, Callable[[], Any]] | None:
        """Wait for work, and begin it; return None if nothing is ready in time.

        Raises:
            ExternalShutdownException: the context was shut down meanwhile
        """
        end = self._end(None if timeout_s is None or timeout_s < 0.0 else timeout_s)
        while True:
            self.flow.look()
            entity = self._next()
            if entity is not None:
                entity.callback_group.active += 1
                return entity, entity.take()
            if enough() or self._over:
                return None
            left = self._left(end)
            if left is not None and left <= 0.0:
                return None
            if not self.context.ok():
                raise ExternalShutdownException

            def over() -> bool:
                ended = self._over or not self.context.valid or enough()
                return ended or any(map(_can_begin, self._entities()))

            due = [s for node in self._nodes for s in node.due_s()]
            waits = [s for s in (left, *due) if s is not None]
            self.flow.wait(over, max(0.0, min(waits)) if waits else None)

    def _next(self) -> Entity | None:
        """Return the next ready entity: each once, before the first comes again."""
        for entity in self._pass:
            if _can_begin(entity):
                return entity
        self._tasks = [task for task in self._tasks if not task.finished]
        self._pass = iter(tuple(self._entities()))
        return next(filter(_can_begin, self._pass), None)

    def _entities(self) -> Iterable[Entity]:
        for node in tuple(self._nodes):
            yield from node.entities()
        yield from tuple(self._tasks)

    def _end(self, timeout_s: float | None) -> int | None:
        return None if timeout_s is None else self.flow.now_ns() + round(timeout_s * 1e9)

    def _left(self, end: int | None) -> float | None:
        return None if end is None else (end - self.flow.now_ns()) / 1e9


def _can_begin(entity: Entity) -> bool:
    return entity.ready() and entity.callback_group.can_execute(entity)


class PoolExecutor(SpinExecutor):
    """Runs what is ready in threads beside the one that spins.

    Args:
        num_threads: how many
        context: as of a `SpinExecutor`
    """

    thread: ClassVar[type[threading.Thread]]

    def __init__(self, num_threads: int | None = None, *, context: Any = None) -> None:
        super().__init__(context=context)
        self._size = num_threads or THREADS
        self._work: deque[tuple[Entity, Callable[[], Any]]] = deque()
        self._workers = self._idle = 0
        self._failures: list[BaseException] = []

    def _execute(self, entity: Entity, handler: Callable[[], Any]) -> None:
        if self._failures:
            raise self._failures.pop(0)
        self._work.append((entity, handler))
        if self._idle < len(self._work) and self._workers < self._size:
            self._workers += 1
            self.thread(target=self._labour, daemon=True).start()

    def _labour(self) -> None:
        while self.context.ok() and not self._over:
            self._idle += 1
            self.flow.wait(lambda: bool(self._work) or self._over or not self.context.valid, None)
            self._idle -= 1
            if self._work:
                try:
                    super()._execute(*self._work.popleft())
                except Exception as problem:  # noqa: BLE001  raised where the script spins
                    self._failures.append(problem)

    def _wait(
        self, timeout_s: float | None, enough: Callable[[], bool]
    ) -> tuple[Entity, Callable[[], Any]] | None:
        found = super()._wait(timeout_s, lambda: enough() or bool(self._failures))
        if self._failures:
            raise self._failures.pop(0)
        return found
