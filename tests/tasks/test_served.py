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
        now = served.state()
        assert (now["reason"], now["met"], now["goals"]) == ("done", 2, 2)
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
    assert f"{arm.name}: not the instrument of the scene" in served.state()["reason"]
    task.world.arm(arm.name).runtime.set_tool_type(tool)
    task.world.reset()
    loop.tick(loop.quiet_ticks())
    assert "instrument" not in served.state()["reason"]
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
    assert served.driver == "<own>"
    assert served.state()["reason"] == "<b>own.py</b>: line 3"


def test_a_person_takes_the_arms_and_gives_them_back(touch: Path) -> None:
    task = make_task(str(touch))
    served, loop = ServedTask(task, 2, script=scripted), Loop(task.world, tick_s=0.001, speed="max")
    served.watch(loop)
    for _ in range(100):
        loop.tick()
    served.take_control()
    for _ in range(50):  # what was under way ends
        loop.tick()
    arm = task.world.arm(task.arms[0])
    held = arm.joints.setpoints()
    for _ in range(100):
        loop.tick()
    assert np.array_equal(arm.joints.setpoints(), held)
    assert served.state()["taken"] and served.state()["by_hand"]
    arm.move_jp(held[:-1] + 0.01)
    for _ in range(500):
        loop.tick()
    served.give_back()
    before = arm.joints.setpoints()
    loop.tick(loop.quiet_ticks())
    assert np.abs(arm.joints.setpoints() - before).max() < 0.005  # no leap to where it was
    while not task.done:
        loop.tick(loop.quiet_ticks())
    assert served.state()["by_hand"] and not served.state()["taken"]


def test_the_next_seed_begins_by_itself_and_moves_as_an_episode_of_its_own(touch: Path) -> None:
    alone = run_episode(make_task(str(touch)), 4)
    task = make_task(str(touch))
    served, loop = ServedTask(task, 3, script=scripted), Loop(task.world, tick_s=0.001, speed="max")
    served.watch(loop)
    served.repeating = True
    while served.state()["seed"] == 3 or not task.done:
        loop.tick(loop.quiet_ticks())
        assert loop.state.ticks < 60_000
    assert task.result(4) == alone
    assert served.state()["seed"] == 4
