"""trocar mirror --ros1 follows what a node of ROS 1 tells, here another simulator."""

from __future__ import annotations

import json
import subprocess

import pytest

from tests.ros.ros1.robot_os import MAIN, PATIENCE_S, ROOT, Master, Simulator, python_with_rospy


@pytest.mark.slow
def test_the_arms_follow_a_robot_on_ros_1(master: Master, simulator: Simulator) -> None:  # noqa: ARG001
    python, prelude = python_with_rospy() or ("", "")
    words = ["mirror", "--ros1", "--rig", "psm", "--no-page", "--json", "--duration", "1.5"]
    done = subprocess.run(
        [python, "-c", f"{prelude} {MAIN}", *words],
        env={**master.env, "PYTHONPATH": str(ROOT / "src"), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)["arms"]["PSM1"]
    assert told["heard"] > 100
    assert told["refused"] == 0
