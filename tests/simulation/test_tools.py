"""Every built-in tool in time, in the rigs of PSMs."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from trocar.descriptions import load_rig, names, rig_with_tool
from trocar.simulation import World

#: What an arm with its own PID is behind its set-point at rest. Source: issue 3. [rad or m]
AT_REST_RAD, AT_REST_M = 2e-3, 1e-4


@pytest.mark.parametrize("rig", ["psm", "three_psm"])
@pytest.mark.parametrize("tool", names("tools"))
def test_a_tool_moves_for_a_second_without_a_warning(
    tool: str, rig: str, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        world = World(rig_with_tool(load_rig(rig), "PSM1", tool), dynamics="cad")
        arm = world.arm("PSM1")
        goal = np.array([0.1, -0.1, 0.14, 0.5, 0.4, -0.4])
        assert arm.move_jp(goal).wait(timeout_s=2.0)
        assert arm.jaw is not None
        assert arm.jaw.open().wait(timeout_s=2.0)
        world.step(1000)
    assert not caplog.records
    q = arm.joints.readings()[0]
    assert np.abs(q[:6] - goal)[[0, 1, 3, 4, 5]].max() < AT_REST_RAD
    assert abs(q[2] - goal[2]) < AT_REST_M
    assert abs(q[6] - np.deg2rad(60)) < AT_REST_RAD
    assert world.health().rcm_error_m < 1e-5
    arm.jaw.close().wait(timeout_s=2.0)
    world.step(500)
    assert abs(arm.joints.readings()[0][6]) < 1e-3  # shut on its stop
