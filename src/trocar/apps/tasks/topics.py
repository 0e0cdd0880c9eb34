"""The topic of a task that a person or a client drives: what counts, as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from trocar.apps.task import PERIOD_S, Task
from trocar.interfaces.crtk import Component, Core
from trocar.interfaces.crtk.topic import STRING, Topic, served

TOPIC = "task/state"
#: A message is sent when anything but the time changed, and this often. Source: our own choice. [s]
REPORT_S = 1.0
#: What changes with time alone.
PASSING = ("time_s", "score")

ROW = Topic(
    TOPIC,
    STRING,
    "pub",
    latched=True,
    help="score, time, goals met, drops and end of the scene's episode, as JSON",
)


def task_component(task: Task) -> Component:
    """Return what a core serves of a task, which keeps count while the world is stepped."""
    last: dict[str, Any] = {}

    def begin(core: Core) -> Callable[[], None]:
        def look() -> None:
            task.look()
            for name, content in task.messages().items():
                core.emit(name, {"data": json.dumps(content)})
            found = task.state()
            same = all(found[key] == last.get(key) for key in found if key not in PASSING)
            if same and 0.0 <= found["time_s"] - last["time_s"] < REPORT_S:
                return
            last.clear()
            last.update(found)
            core.emit(TOPIC, {"data": json.dumps(found)})

        return task.world.observe(look, every=round(PERIOD_S / task.world.timestep))

    rows = [Topic(name, STRING, "pub", depth=1, help=text) for name, text in task.topics.items()]
    return Component(served([ROW, *rows]), begin)
