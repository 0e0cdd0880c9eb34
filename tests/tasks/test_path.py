"""How short the way is from an action of a policy to 20 ms of motion and its count."""

from __future__ import annotations

import numpy as np
import pytest

from tests.calls import calls_of, changes_of_file
from trocar.tasks import make_task

#: Python calls of 20 ms, files, and changes of file from call to call: in all, and in `tasks`.
#: Source: measured on needle-pick, CPython 3.11: 32, 10, 21, and 14, 3. The simulation's part
#: (inverse kinematics, two rows of set-points, two steps, one reading) is the rest.
MOST_CALLS, MOST_FILES, MOST_CHANGES = 32, 10, 21
MOST_OWN_CALLS, MOST_OWN_FILES = 14, 3
#: Python calls of the observation after it: what was read already is not read again.
MOST_OBSERVING = 4
#: Python calls of a second `make_task`, two thirds of which read the scene. Source: measured: 4,867
#: and 7,587; 5,595 and 14,726 when every pair of shapes was looked at for softness in two calls.
MOST_MAKING = {"needle-pick": 5000, "peg-board": 7800}


@pytest.mark.parametrize("scene", ["needle-reach", "needle-pick"])
def test_a_command_of_a_policy_takes_few_calls(scene: str) -> None:
    task = make_task(scene)
    script = task.policy()
    for _ in range(10):
        task.command(next(script))
    action = next(script)
    calls = calls_of(lambda: task.command(action))
    assert len(calls) <= MOST_CALLS, calls
    assert len({call.file for call in calls}) <= MOST_FILES, calls
    assert changes_of_file(calls) <= MOST_CHANGES, calls
    assert len(calls_of(task.observation)) <= MOST_OBSERVING
    # set-points make no arm begin or end a move: the world need not look them over
    assert "_attend" not in {call.function for call in calls}
    own = [call for call in calls if call.file.startswith("tasks/")]
    assert len(own) <= MOST_OWN_CALLS, own
    assert len({call.file for call in own}) <= MOST_OWN_FILES, own


@pytest.mark.parametrize("scene", MOST_MAKING)
def test_a_task_is_made_without_a_call_for_each_pair_of_shapes(scene: str) -> None:
    make_task(scene)  # arms are read once
    assert len(calls_of(lambda: make_task(scene))) <= MOST_MAKING[scene]


def test_what_keeps_an_arm_from_a_pose_is_found_out_when_it_is_read() -> None:
    task = make_task("needle-reach")
    away = np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.5])
    for _ in range(25):
        task.command(away)
    controller = task.controller
    q = controller.setpoints(away)[0]["PSM1"][0]
    calls = calls_of(lambda: task.command(away))
    assert "inverse_rcm_arm" not in {call.function for call in calls}
    assert controller.stays("PSM1")
    reason = controller.stalls()["PSM1"]
    assert reason.startswith("pose out of reach: ")
    task.command(away)
    calls = calls_of(controller.stalls)
    assert "inverse_rcm_arm" not in {call.function for call in calls}  # as before
    assert controller.stalls()["PSM1"] == reason
    np.testing.assert_array_equal(controller.setpoints(away)[0]["PSM1"][0], q)
    task.command(-away)
    assert not controller.stays("PSM1")
    assert not controller.stalls()["PSM1"]


def test_a_reason_is_that_of_the_action_though_the_tool_was_exchanged_since() -> None:
    reasons: list[str] = []
    for exchanged in (False, True):
        task = make_task("needle-reach")
        for _ in range(25):
            task.command(np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.5]))
        if exchanged:
            task.world.exchange_tool("PSM1", "none")
        reasons.append(task.controller.stalls()["PSM1"])
    assert reasons[0].startswith("pose out of reach: ") and reasons[1] == reasons[0]
