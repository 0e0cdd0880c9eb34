"""A scene that a person or a client drives keeps its score on a topic."""

import json
from contextlib import closing
from pathlib import Path

import numpy as np

from trocar.apps.tasks import make_task
from trocar.apps.tasks.topics import TOPIC, task_component
from trocar.geometry.se3 import transform
from trocar.interfaces import Loop
from trocar.interfaces.crtk import Core
from trocar.interfaces.crtk.transports.memory import MemoryTransport


def test_the_topic_has_time_goals_and_end(touch: Path) -> None:
    task = make_task(str(touch))
    loop = Loop(task.world, tick_s=0.02, speed="max")
    core, transport = Core(loop, components=(task_component(task),)), MemoryTransport([TOPIC])
    core.attach(transport)
    with closing(core):
        core.begin()
        for tick in range(80):
            loop.tick()
            if tick == 25:
                at = transform(np.eye(3), [0.03, 0.012, 0.00701])
                task.world.objects["cube"].set_cp(at)
        core.publish_waiting()
    found = [json.loads(message["data"]) for message in transport.received[TOPIC]]
    assert (found[0]["met"], found[-1]["met"]) == (0, 1)
    times = [one["time_s"] for one in found]
    assert times == sorted(times) and times[-1] > 1.5
    assert not found[-1]["done"]
