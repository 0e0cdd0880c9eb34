"""A scene in a running loop: its score on a topic and on the page, its policy as without a loop."""

import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from trocar.errors import TrocarError
from trocar.geometry.se3 import transform
from trocar.live import Loop
from trocar.ros import Core
from trocar.ros.transports.memory import MemoryTransport
from trocar.tasks import Task, make_task, run_episode
from trocar.tasks.play import scripted
from trocar.tasks.served import TOPIC, ServedTask


def test_the_topic_has_time_goals_and_end(touch: Path) -> None:
    task = make_task(str(touch))
    loop = Loop(task.world, tick_s=0.02, speed="max")
    served = ServedTask(task, 0, script=None)
    served.watch(loop)
    core, transport = Core(loop, components=(served.component(),)), MemoryTransport([TOPIC])
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


def test_the_policy_moves_as_without_a_loop_to_the_last_bit_and_again_after_a_reset(
    touch: Path,
) -> None:
    alone = run_episode(make_task(str(touch)), 2)
    task = make_task(str(touch))
    served, loop = ServedTask(task, 2, script=scripted), Loop(task.world, tick_s=0.001, speed="max")
    served.watch(loop)
    for _ in range(2):
        while not task.done:
            loop.tick(loop.quiet_ticks())
        assert task.result(2) == alone
        assert "scripted policy: done" in served.note() and "2 of 2" in served.note()
        task.world.reset()  # as somebody on the page does
        loop.tick(loop.quiet_ticks())
        assert not task.done and task.world.time < 0.01


def test_an_instrument_taken_away_ends_the_episode_and_not_the_loop(touch: Path) -> None:
    task = make_task(str(touch))
    served, loop = ServedTask(task, 2, script=scripted), Loop(task.world, tick_s=0.001, speed="max")
    served.watch(loop)
    arm = task.world.arm(task.arms[0])
    tool = arm.description.tool
    arm.runtime.set_tool_type("none")
    for _ in range(50):
        loop.tick(loop.quiet_ticks())
    assert f"{arm.name}: not the instrument of the scene" in served.note()
    task.world.arm(arm.name).runtime.set_tool_type(tool)
    task.world.reset()
    loop.tick(loop.quiet_ticks())
    assert "instrument" not in served.note()
    assert not task.done


def test_what_a_policy_raises_is_shown_as_text(touch: Path) -> None:
    task = make_task(str(touch))

    def script(_: Task) -> Iterator[np.ndarray]:
        yield task.stay()
        raise TrocarError("<b>own.py</b>: line 3")

    served = ServedTask(task, 0, script=script, driver="<own>")
    loop = Loop(task.world, tick_s=0.001, speed="max")
    served.watch(loop)
    for _ in range(50):
        loop.tick()
    assert "&lt;own&gt;: &lt;b&gt;own.py&lt;/b&gt;: line 3" in served.note()
