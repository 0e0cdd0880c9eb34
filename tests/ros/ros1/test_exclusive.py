"""Exclusive arms: a client that has ended commands none any longer."""

from __future__ import annotations

import pytest

from tests.ros.ros1.robot_os import ROOT, SYSTEM_PYTHON, Master, Simulator, need

SCRIPT = str(ROOT / "tests" / "clients" / "rospy" / "move.py")


@pytest.mark.slow
@pytest.mark.parametrize("signal", ["", "SIGKILL"])
def test_an_arm_is_free_for_the_next_script_once_one_has_ended(master: Master, signal: str) -> None:
    need(SYSTEM_PYTHON, "timeout")
    simulator = Simulator(master.env, "--rig", "psm", "--exclusive")
    try:
        first = ["timeout", "-s", signal, "1.5"] if signal else []
        master.run(*first, SYSTEM_PYTHON, SCRIPT, "PSM1", check=not signal)
        assert "at the goal" in master.run(SYSTEM_PYTHON, SCRIPT, "PSM1")
        assert not [line for line in simulator.said if "is commanded by" in line]
    finally:
        assert simulator.stop() == 0, "".join(simulator.said)
