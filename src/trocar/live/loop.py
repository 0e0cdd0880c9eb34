"""The real-time loop: the one place where simulation time meets the wall clock.

    post(command) -> inbox -> tick: apply what is due -> World.step(n) -> state for all readers

Commands are applied at tick boundaries only, so the motion depends on which command met which
tick and on nothing else: not on the machine's speed, nor on who watches.
"""

from __future__ import annotations

import atexit
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import AbstractContextManager, ExitStack, nullcontext
from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar

from trocar.errors import DivergedError, InputError, TrocarError, UnknownNameError
from trocar.live.commanders import Commanders
from trocar.live.inbox import Command, Inbox
from trocar.live.pace import Clock, Pace, Wakeup, WallClock, nearest_tick, whole_steps
from trocar.live.state import Elapsed, LoopState, StatePublisher, Watcher
from trocar.simulation.journal import WORLD
from trocar.simulation.rate_limit import RateLimit, burst, suffix

if TYPE_CHECKING:
    from trocar.simulation import World
    from trocar.simulation.moves import Motion
    from trocar.simulation.records import Snapshot

_log = logging.getLogger("trocar")
T = TypeVar("T")

TICK_S = 0.005
"""Simulated time between two tick boundaries [s]. Source: our own choice, as in headless runs."""

SERVER_TICK_S = 0.001
"""The same where programs talk to the arms [s]: a command waits no longer. Source: our own choice,
the period of the dVRK's own control loop, half of which it takes on average."""

MOST_STEPS = 10_000
"""Physics periods that one command may step. Source: our own choice: 10 s at 1 ms, for which no
other command is applied."""

ASK = "ask"
LOOP_VERBS = ("pause", "resume", "step", "reset", "set_speed")

Speed: TypeAlias = "Literal['realtime', 'max'] | float"

PATIENCE_S = 0.005
"""Simulated time between two checks of commands and clock without watchers [s]: ticks in
between follow each other at once. Source: our own choice, as TICK_S."""


class Loop:
    """Step a world tick by tick and let other threads talk to it.

    Args:
        world: is stepped; used by the loop alone while it runs
        speed: "realtime" keeps to the wall clock, "max" runs as fast as it goes; a number is a
            factor of real time: 0.2 is slow motion
        tick_s: simulated time between two tick boundaries [s], a whole multiple of the timestep;
            when omitted, the one nearest to TICK_S
        clock: the wall clock; tests bring their own
        on_apply: called with (tick, command) for every command that is applied, e.g. to record them

    Attributes:
        commanders: which clients command each arm
        while_running: makes the context that `start` enters before the first tick, and that is left
            after the last; a recording is opened here, when every port is bound
        filter_command: returns what is applied in place of a command
    """

    def __init__(
        self,
        world: World,
        *,
        speed: Speed = "realtime",
        tick_s: float | None = None,
        clock: Clock | None = None,
        on_apply: Callable[[int, Command], None] | None = None,
    ) -> None:
        self._world = world
        if tick_s is None:
            tick_s = nearest_tick(TICK_S, world.timestep)
        self._known = {*world.arms, *world.objects, WORLD}
        self._substeps = whole_steps(tick_s, world.timestep)
        self._tick_s = tick_s
        self._factor = _factor(speed)
        self._let_go_s = 0.0
        self._clock = clock or WallClock()
        self._on_apply = on_apply
        self._inbox = Inbox(self._clock.now)
        self._inbox.drop = self._drop
        self._pace = Pace(self._clock, tick_s / (self._factor or 1.0))
        self._longest = max(1, round(PATIENCE_S / tick_s))
        self._posted = Wakeup()
        self._stopping = threading.Event()
        self._outcome: Future[None] | None = None
        self._paused = False
        self._refused = 0
        self._ticks = self._stepped = 0
        self._publisher = StatePublisher(world, self._clock)
        self._watchers: tuple[Watcher, ...] = ()
        self._rate_limit = RateLimit()
        self.commanders = Commanders(self._clock.now)
        self.while_running: Callable[[], AbstractContextManager[object]] = nullcontext
        self.filter_command: Callable[[Command], Command] = lambda command: command

    # What other threads may call.

    @property
    def world(self) -> World:
        """The world; what changes in it may be looked at in the loop's thread only."""
        return self._world

    @property
    def tick_s(self) -> float:
        """Simulated time between two tick boundaries [s]."""
        return self._tick_s

    @property
    def speed(self) -> float | None:
        """Simulated over wall time that it keeps to; None: as fast as it goes."""
        return self._factor

    @property
    def now(self) -> float:
        """Wall time since some fixed moment [s]."""
        return self._clock.now()

    @property
    def state(self) -> LoopState:
        """The newest state; a frozen record that never changes afterwards."""
        return self._publisher.read()

    @property
    def latest(self) -> Snapshot:
        """The newest snapshot."""
        return self.state.snapshot

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per second over the last two seconds."""
        return self._publisher.real_time_factor

    @property
    def running(self) -> bool:
        """Whether the loop's thread is at work."""
        return self._outcome is not None and not self._outcome.done()

    def watch(self, watcher: Watcher) -> Callable[[], None]:
        """Call a watcher at ticks and rejections, in the loop's thread; call the result to stop."""
        self._watchers += (watcher,)

        def stop() -> None:
            self._watchers = tuple(w for w in self._watchers if w is not watcher)

        return stop

    def post(self, command: Command) -> bool:
        """Queue a command for the next tick boundary; return False when it was rejected.

        Raises:
            UnknownNameError: the command names an arm or object that the rig has not
        """
        if command.arm not in self._known:
            raise UnknownNameError("arm", command.arm, sorted(self._known - {WORLD}))
        accepted = self._inbox.post(command)
        self._posted.set()
        return accepted

    @property
    def restless(self) -> bool:
        """Whether commands wait for the next tick."""
        return self._inbox.restless

    @property
    def pending(self) -> int:
        """Number of commands that wait for the next tick."""
        return len(self._inbox)

    @property
    def held(self) -> frozenset[str]:
        """Arms for which commands wait; in the loop's thread."""
        return self._inbox.held

    def ask(self, question: Callable[[World], T]) -> Future[T]:
        """Let the loop answer a question about the world at the next tick boundary.

        Args:
            question: a function that only reads

        Returns:
            what the function will have returned; cancelled when the loop ends before
        """
        answer: Future[T] = Future()

        def act(world: World) -> None:
            if not answer.set_running_or_notify_cancel():
                return
            try:
                found = question(world)
            except Exception as error:  # noqa: BLE001  raised where the answer is read
                answer.set_exception(error)
            else:
                answer.set_result(found)

        if self._outcome is not None and self._outcome.done():
            answer.cancel()
        elif not self._inbox.post(Command(WORLD, ASK, {"answer": answer}, act=act)):
            answer.set_exception(InputError("too many pending requests; try again"))
        self._posted.set()
        return answer

    def start(self, duration_s: float | None = None) -> None:
        """Run in a thread of its own, for a simulated time or until stopped [s].

        A program that ends stops it first: a thread that Python ends within MuJoCo takes the
        process down.
        """
        if self.running:
            raise InputError("the loop is already running")
        self._stopping.clear()
        context = ExitStack()
        context.enter_context(self.while_running())
        self._outcome = Future()
        thread = threading.Thread(
            target=self._main,
            args=(duration_s, context, self._outcome),
            name="trocar-loop",
            daemon=True,
        )
        atexit.register(self.close)
        thread.start()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the loop to end; return whether it has.

        Raises:
            TrocarError: what stopped the loop, for instance a DivergedError
        """
        if self._outcome is None:
            return True
        try:
            self._outcome.result(timeout_s)
        except FutureTimeoutError:
            return False
        return True

    def stop(self) -> None:
        """End the loop and wait for it; raise what had stopped it before."""
        self._stopping.set()
        self.wait()

    def wait_for(self, motion: Motion, timeout_s: float | None = None) -> bool:
        """Wait for a move from another thread; return whether it arrived.

        Args:
            motion: the move
            timeout_s: simulated time after which to give up [s]; None: never
        """
        end = float("inf") if timeout_s is None else self._ticks + timeout_s / self._tick_s
        while not motion.done and self.running and self._ticks < end:
            self._clock.sleep(self._tick_s)
        return motion.goal_reached

    def close(self) -> None:
        """End the loop and wait for it, whatever had stopped it before."""
        self._stopping.set()
        if self._outcome is not None:
            self._outcome.exception()

    # What the loop's own thread does.

    def run(self, duration_s: float | None = None) -> None:
        """Run in the calling thread, for a simulated time or until stopped [s]."""
        last = None if duration_s is None else self._ticks + round(duration_s / self._tick_s)
        self._restart()
        self._publisher.begin()
        self._world.waiter = self.wait_for
        try:
            while not self._stopping.is_set() and (last is None or self._ticks < last):
                due = 1
                if self._factor or self._paused:
                    due = self._pace.wait(self._patience(last), self._posted)
                self.tick(due)
                self._publisher.publish_if_due(
                    self._ticks, self._ticks * self._tick_s, self._paused, self._all_refused()
                )
        finally:
            self._world.waiter = None
            for command in self._inbox.drain():
                if command.verb == ASK:
                    command.kwargs["answer"].cancel()
            self._publisher.end()
        self._publisher.publish(self._ticks, self._paused, self._all_refused())

    def tick(self, due: int = 1) -> None:
        """Step as many ticks as are due unless paused, and apply what waits before the last."""
        self._step(due - 1)
        self._posted.clear()
        for command in self._inbox.due(self._world):
            self._apply(command)
        self._step(1)
        for watcher in self._watchers:
            watcher.ticked(self._elapsed())

    def quiet_ticks(self) -> int:
        """Return the number of ticks that may be stepped together before a watcher is due."""
        return self._patience(None)

    def _step(self, ticks: int) -> None:
        if ticks and not self._paused:
            self._world.step(ticks * self._substeps)
            self._ticks += ticks

    def _patience(self, last: int | None) -> int:
        """Return the number of ticks that may be stepped together without reading the inbox."""
        most = 1 if self._posted.is_set() or self._inbox.restless else self._longest
        ends = most if last is None else last - self._ticks
        return min(most, ends, *(w.patience() for w in self._watchers))

    def _main(self, duration_s: float | None, context: ExitStack, outcome: Future[None]) -> None:
        try:
            with context:
                self.run(duration_s)
        except Exception as error:  # noqa: BLE001  handed over whole to whoever waits
            outcome.set_exception(error)
        else:
            outcome.set_result(None)
        finally:
            atexit.unregister(self.close)

    def _apply(self, command: Command) -> None:
        if self._on_apply is not None and command.verb != ASK:
            self._on_apply(self._ticks, command)
        try:
            if command.arm == WORLD and command.act is None and command.verb in LOOP_VERBS:
                self._obey(command)
            else:
                self.filter_command(command).apply(self._world)
        except DivergedError:
            raise
        except TrocarError as error:
            self._refuse(command, str(error))
        except Exception as error:  # noqa: BLE001  one command must not end the simulation
            self._refuse(command, f"{type(error).__name__}: {error}", error)

    def _obey(self, command: Command) -> None:
        """Apply a verb of the world that changes how time passes."""
        if command.verb == "reset":
            command.apply(self._world)
        if command.verb == "set_speed":
            self._set_speed(command.kwargs["speed"])
            return
        if command.verb != "step":
            self._paused = command.verb == "pause" or (self._paused and command.verb == "reset")
            self._restart()
            return
        periods = command.kwargs["periods"]
        if not self._paused:
            raise InputError("step: the simulation is running; allowed: while paused")
        if not 1 <= periods <= MOST_STEPS:
            raise InputError(f"step: got {periods} steps; allowed: 1 to {MOST_STEPS}")
        self._world.step(periods)
        self._stepped += periods

    def _set_speed(self, speed: Speed) -> None:
        factor = _factor(speed)
        self._let_go_s = self._skipped_s()
        self._factor = factor
        self._pace = Pace(self._clock, self._tick_s / (factor or 1.0))
        self._publisher.restart()

    def _skipped_s(self) -> float:
        """Return the simulated time that was given up catching up [s]."""
        return self._let_go_s + (self._factor or 1.0) * self._pace.let_go_s

    def _drop(self, first: Command, count: int) -> None:
        self._refuse(first, f"{count} commands waited as the world was reset: dropped")

    def _refuse(self, command: Command, reason: str, defect: Exception | None = None) -> None:
        """Count and log a rejected command, with a traceback of what trocar did not expect."""
        self._refused += 1
        unsaid = self._rate_limit.due(
            reason, self._clock.now(), 1 if defect else burst(command.verb)
        )
        if unsaid is not None and not command.topic:  # whoever serves the topic logs it
            _log.warning("rejected: %s%s", reason, suffix(unsaid), exc_info=defect)
        for watcher in self._watchers:
            watcher.refused(command, reason)

    def _elapsed(self) -> Elapsed:
        simulated = self._ticks * self._tick_s + self._stepped * self._world.timestep
        due_s = self._pace.due_s if self._factor or self._paused else None
        return Elapsed(simulated, self._skipped_s(), self._paused, self._stepped, due_s)

    def _restart(self) -> None:
        self._pace.restart()
        self._publisher.restart()

    def _all_refused(self) -> int:
        return self._refused + self._inbox.rejected


def _factor(speed: Speed) -> float | None:
    """Return simulated over wall time of a speed; None for "max"."""
    if speed == "max":
        return None
    if isinstance(speed, str):
        if speed != "realtime":
            raise UnknownNameError("speed", speed, ("realtime", "max"))
        return 1.0
    if not 0.0 < speed < float("inf"):
        raise InputError(f"speed: got {speed:g}; allowed: above 0, realtime or max")
    return speed
