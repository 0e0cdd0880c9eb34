"""A policy drives a served scene over its topics, in simulated time."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conformance.stand_in import ServedClient
from trocar.errors import InputError, TrocarError
from trocar.learning.policies import PolicyFile
from trocar.learning.policy_node import PolicyNode
from trocar.tasks import make_task
from trocar.tasks.play import scripted
from trocar.tasks.served import ServedTask

REACH = Path(__file__).parents[2] / "examples" / "policies" / "reach.py"


class SceneClient(ServedClient):
    """A client of a served scene that nobody else drives."""

    def __init__(self, scene: str, seed: int) -> None:
        self.task = make_task(scene)
        super().__init__(self.task.world)
        self.counted = ServedTask(self.task, seed, script=None)
        self.counted.watch(self.served.loop)
        self.start()


@pytest.mark.parametrize(
    ("scene", "policy"),
    [
        ("needle-reach", "reach.py"),
        ("needle-pick", "scripted"),
        ("needle-pick", "needle-pick.toml"),
    ],
)
def test_a_policy_node_succeeds_in_a_served_scene(scene: str, policy: str) -> None:
    if policy.endswith(".toml"):
        pytest.importorskip("safetensors", reason="safetensors is not installed (extra learn)")
    client = SceneClient(scene, 3)
    of = scripted if policy == "scripted" else PolicyFile(REACH.with_name(policy)).script
    found = PolicyNode(client, make_task(scene), of, seed=3).run()
    assert found.success, found.reason
    client.sleep(0.3)  # settled there, too
    there = client.task.state()
    assert (there["reason"], there["met"]) == ("done", 1)
    assert there["time_s"] == pytest.approx(found.time_s, abs=0.3)
    client.close()


def test_the_copy_stands_where_the_robot_and_its_objects_do() -> None:
    client, task = SceneClient("needle-pick", 3), make_task("needle-pick")
    robot = client.task.world
    q = robot.arms["PSM1"].joints.positions()
    robot.set_state("PSM1", q + np.array([0.05, -0.05, -0.01, 0.2, 0.1, 0.1, 0.2]))
    needle = client.task.object_pose("needle")
    needle[:2, 3] += [0.01, -0.01]
    robot.objects["needle"].set_cp(needle)
    client.sleep(0.1)
    before = robot.arms["PSM1"].measured_cp("world").matrix[:3, 3]
    PolicyNode(client, task, lambda _: iter(()), seed=3).run(0.2)  # stays
    after = robot.arms["PSM1"].measured_cp("world").matrix[:3, 3]
    assert np.linalg.norm(after - before) < 1e-4
    PolicyNode(client, task, scripted, seed=3).run(0.3)
    copy = task.world
    ours, theirs = (w.arms["PSM1"].measured_cp("world").matrix[:3, 3] for w in (robot, copy))
    assert np.linalg.norm(ours - theirs) < 1e-3  # 5 ms at 0.2 m/s
    ours, theirs = (w.arms["PSM1"].joints.setpoints() for w in (robot, copy))
    np.testing.assert_allclose(ours, theirs, atol=1e-12)
    np.testing.assert_allclose(task.object_pose("needle"), client.task.object_pose("needle"),
                               atol=1e-4)  # it settles  # fmt: skip
    client.close()


def test_an_arm_that_is_not_enabled_stops_the_node() -> None:
    client = SceneClient("needle-reach", 3)
    client.task.world.arms["PSM1"].disable()
    client.sleep(0.05)
    node = PolicyNode(client, make_task("needle-reach"), scripted, seed=3)
    with pytest.raises(TrocarError, match=r"PSM1 is DISABLED; allowed: ENABLED"):
        node.run()
    client.close()


class SilentClient(SceneClient):
    """A client of a robot whose joints fall silent after a time, or whose messages break."""

    def __init__(self, scene: str, seed: int, quiet_after_s: float, broken: bool) -> None:
        self._quiet_after_s, self._broken, self._begun = quiet_after_s, broken, float("inf")
        super().__init__(scene, seed)
        self._begun = self.now()

    def hand(self, topic: str, message: Mapping[str, Any], take: Any) -> None:
        if topic == "PSM1/measured_js":
            if self._broken:
                message = {**message, "position": message["position"][:3]}
            elif self.now() > self._begun + self._quiet_after_s:
                return
        super().hand(topic, message, take)


@pytest.mark.parametrize(
    ("quiet_after_s", "broken", "message"),
    [
        (0.2, False, r"/PSM1/measured_js: no message for 0\.5 s; allowed: 0\.5 s; PSM1 holds"),
        (-1.0, False, r"no message within 3 s on /PSM1/measured_js; allowed: the arms and objects"),
        (0.2, True, r"/PSM1/measured_js: got 3 numbers in position; allowed: 6"),
    ],
)
def test_missing_or_broken_messages_stop_the_node(
    quiet_after_s: float, broken: bool, message: str
) -> None:
    client = SilentClient("needle-reach", 3, quiet_after_s, broken)
    node = PolicyNode(client, make_task("needle-reach"), scripted, seed=3)
    with pytest.raises(TrocarError, match=message):
        node.run()
    client.close()


@pytest.mark.parametrize(
    ("scene", "prop"),
    [("thread-handover", "thread"), ("dynamic-pendulum", "pendulum"), ("suturing", "pad")],
)
def test_a_scene_whose_state_no_pose_has_is_one_error(scene: str, prop: str) -> None:
    client = ServedClient()
    with pytest.raises(
        InputError, match=rf"{scene}: \w*{prop}\w* is on .* allowed: scenes of free"
    ):
        PolicyNode(client, make_task(scene), scripted)
    client.close()
