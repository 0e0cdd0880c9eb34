"""A task in a running loop: its count and its policy, on a topic and in the viewer."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.live import Loop
from trocar.live.images import Overlay
from trocar.live.inbox import Command
from trocar.live.state import Elapsed
from trocar.ros import Component, Core
from trocar.ros.topic import STRING, Topic, served
from trocar.simulation.journal import WORLD
from trocar.tasks.controller import EVERY, PERIOD_S, Row
from trocar.tasks.play import Script
from trocar.tasks.task import Task

Array = NDArray[np.float64]

TOPIC = "task/state"
#: Interval of messages while nothing but the time changes. Source: our own choice. [s]
REPORT_S = 1.0
#: Time between the end of an episode and the next one that begins by itself. Source: our own
#: choice, long enough to see the end. [s]
REST_S = 2.0
#: Entries of a state that change with time alone.
PASSING = ("time_s", "score")

ROW = Topic(
    TOPIC,
    STRING,
    "pub",
    latched=True,
    help="score, time, goals met, drops and end of the scene's episode, as JSON",
)


class ServedTask:
    """Runs an episode in a loop: counts, and drives by a script if it has one.

    The policy's motion is that of an episode without a loop, to the last bit. When the world
    is reset, the episode begins anew.

    Args:
        task: whose world the loop steps; reset here
        seed: of the episode
        script: returns the actions of an episode; None: a person or a client drives
        driver: label of the script in the web viewer

    Attributes:
        driver: as given; "" without a script
        repeating: whether the episode of the next seed begins after the end of one
    """

    def __init__(
        self, task: Task, seed: int, *, script: Script | None, driver: str = "scripted policy"
    ) -> None:
        self.task, self._seed, self._script = task, seed, script
        self.driver = "" if script is None else driver
        self.repeating = False
        self._taken = self._by_hand = self._astray = False
        self._ended_s = 0.0
        self._loop: Loop | None = None
        self._core: Core | None = None
        self._sent: dict[str, Any] = {}
        self._every = EVERY if script else round(PERIOD_S / task.world.timestep)
        self._substeps = 1
        self._tools = {name: task.world.arms[name].description.tool for name in task.arms}
        self._ended = ""
        self._reset()

    def watch(self, loop: Loop) -> None:
        """Count, and drive, while a loop runs."""
        self._substeps = round(loop.tick_s / self.task.world.timestep)
        self._loop = loop
        loop.watch(self)

    def component(self) -> Component:
        """Return the topics that a core serves."""

        def begin(core: Core) -> Callable[[], None]:
            self._core = core
            return lambda: setattr(self, "_core", None)

        more = self.task.topics.items()
        rows = [Topic(name, STRING, "pub", depth=1, help=text) for name, text in more]
        return Component(served([ROW, *rows]), begin)

    @property
    def overlay(self) -> Overlay | None:
        """The function that draws into the cameras' images, None for a scene that draws nothing."""
        return self.task.overlay

    def state(self) -> dict[str, Any]:
        """Return the newest count, the seed, and who drives; from any thread.

        Returns:
            the entries of `task/state`, and seed, "taken" (a person has the arms of the policy) and
            "by_hand" (a person had them at some time in this episode)
        """
        more = {"seed": self._begun, "taken": self._taken, "by_hand": self._by_hand}
        return {**self._state, **more}

    def take_control(self) -> None:
        """Stop the policy, whose arms then belong to a person or a client; from any thread."""
        self._taken = bool(self._script)

    def give_back(self) -> None:
        """Let the policy go on from where the arms are; from any thread."""
        self._taken = False

    def begin(self, seed: int) -> None:
        """Begin the episode of a seed, by a reset of the world; from any thread."""
        self._seed = seed
        if self._loop is not None:
            self._loop.post(Command(WORLD, "reset"))

    # ------------------------------------------------------------------ a watcher of the loop

    def ticked(self, elapsed: Elapsed) -> None:
        """Count and drive when a period is over."""
        periods = self.task.world.periods
        again = periods < self._periods
        if again or not self._ended:
            self._ended = self._exchanged()
            try:
                if again and not self._ended:
                    self._reset()
                elif periods > self._periods and periods % self._every == 0 and not self._ended:
                    self._drive()
            except TrocarError as problem:  # what others command may leave nothing to count
                self._ended = str(problem)
            if self._ended:
                self._rows.clear()
                self._state = {**self._state, "done": True, "reason": self._ended}
        self._periods = self.task.world.periods
        if not self._state["done"]:
            self._ended_s = elapsed.simulated_s
        elif self.repeating and not self._ended and elapsed.simulated_s - self._ended_s > REST_S:
            self._ended_s = elapsed.simulated_s
            self.begin(self._begun + 1)
        self._report()

    def _exchanged(self) -> str:
        """Name arms that lack the instrument of the scene, which then stops; "" for none."""
        arms = self.task.world.arms
        off = [name for name, tool in self._tools.items() if arms[name].description.tool != tool]
        names = ", ".join(off)
        return f"{names}: not the instrument of the scene; put it on and reset" if off else ""

    def patience(self) -> int:
        """Return the number of ticks until it counts or drives next."""
        left = self._every - self.task.world.periods % self._every
        return max(1, -(-left // self._substeps))

    def refused(self, command: Command, reason: str) -> None:
        """Ignore rejected commands."""

    # ------------------------------------------------------------------ inside

    def _reset(self) -> None:
        self.task.reset(self._seed)
        self._begun = self._seed
        self._rows: list[Row] = []
        self._by_hand, self._astray = self._taken, False
        self._actions: Iterator[Array] = self._script(self.task) if self._script else iter(())
        self._periods = self.task.world.periods
        self._state = self.task.state()
        if self._script:
            self._drive()

    def _drive(self) -> None:
        task = self.task
        if not self._rows:
            if task.world.periods:
                task.look()
            for name, content in task.messages().items():
                if self._core is not None:
                    self._core.emit(name, {"data": json.dumps(content)})
            self._state = task.state()
            if self._taken:
                self._by_hand = self._astray = True
            elif self._script and not task.done:
                if self._astray:
                    self._astray = False
                    task.controller.resume()
                action = next(self._actions, None)
                self._rows = task.controller.setpoints(task.stay() if action is None else action)
        if self._rows:
            task.controller.drive(self._rows.pop(0))

    def _report(self) -> None:
        found, sent = self._state, self._sent
        same = sent and all(found[key] == sent[key] for key in found if key not in PASSING)
        if self._core is None or (same and 0.0 <= found["time_s"] - sent["time_s"] < REPORT_S):
            return
        self._sent = found
        self._core.emit(TOPIC, {"data": json.dumps(found)})
