"""The same script over ROS 1 in real time, and without ROS on simulated time: the same motion."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.ros.ros1.robot_os import ROOT, Master, Simulator, need, python_with_rospy
from trocar.cli import main

Array = NDArray[np.float64]
CLIENTS = ROOT / "tests" / "clients" / "scripts"
#: How long each of the three loops lasts [s].
LOOP_S = 5.0
#: Source: the project's own goal. [rad or m]
MOST = 1e-3
#: A turn of a loop that is this much late or early leaves its mark on the motion. Source: our own
#: choice: a turn takes 10 ms. [s]
LATE_S = 0.01
#: ... for so many turns. Source: our own choice, longer than a servo takes to settle.
MARKED = 30

pytestmark = [pytest.mark.slow]


def read(path: Path) -> dict[str, Array]:
    return {name: np.array(rows) for name, rows in json.loads(path.read_text("utf-8")).items()}


def apart(a: Array, b: Array) -> float:
    """The largest distance of a point of one path from the other path, joint by joint.

    When a point is passed is left to the scheduler of the machine; where the arm is, is not.
    """
    worst, b = 0.0, np.vstack([b, b[-1:]])
    start, step = b[:-1], np.diff(b, axis=0)
    length = np.maximum(np.sum(step**2, axis=1), 1e-300)
    for point in a:
        along = np.clip(np.sum((point - start) * step, axis=1) / length, 0.0, 1.0)
        away = np.abs(start + along[:, None] * step - point).max(axis=1)
        worst = max(worst, float(away.min()))
    return worst


def undisturbed(times: Array) -> NDArray[np.bool_]:
    """Which rows of a loop had no turn before them that a busy machine brought late, (n,)."""
    gaps = np.diff(times, axis=0)
    late = np.any(np.abs(gaps - 0.01) > LATE_S, axis=1)
    found = np.ones(len(times), dtype=bool)
    for k in np.flatnonzero(late):
        found[max(0, k - 1) : k + 1 + MARKED] = False
    return found


def test_paths_are_told_apart_by_their_distance() -> None:
    path = np.linspace([0.0, 0.0], [1.0, 2.0], 11)
    late = np.linspace([0.01, 0.02], [0.99, 1.98], 7)
    assert apart(late, path) < 1e-12
    assert apart(np.add(late, [0.0, 0.03]), path) == pytest.approx(0.012, abs=0.004)
    assert apart(path[:1] + 0.5, path[:1]) == 0.5


def test_the_same_script_makes_the_same_motion_over_ros_1_and_without(
    master: Master, tmp_path: Path
) -> None:
    need("rosmaster")
    python, prelude = python_with_rospy() or ("", "")
    script, live, fast = str(CLIENTS / "minute.py"), tmp_path / "live.json", tmp_path / "fast.json"
    simulator = Simulator(master.env, "--rig", "psm", "--pose", "start")  # where scripts start
    try:
        env = {**master.env, "PYTHONPATH": f"{ROOT / 'src'}:{master.env['PYTHONPATH']}"}
        runner = str(CLIENTS / "over_ros1.py")
        words = f"sys.argv = {[runner, script, str(live), str(LOOP_S)]!r}"
        code = f"{prelude} import runpy; {words}; runpy.run_path({runner!r}, run_name='__main__')"
        said = run(python, code, env)
    finally:
        assert simulator.stop() == 0
    assert live.exists(), said
    assert main(["run", "--speed", "max", "--rig", "psm", script, str(fast), str(LOOP_S)]) == 0
    ours, theirs = read(fast), read(live)
    assert list(ours) == list(theirs)
    for name, rows in ours.items():
        told = theirs[name]
        assert len(rows) == len(told)
        fair = undisturbed(told[:, -2:])
        if fair.mean() < 0.3:
            pytest.skip("the machine is too busy for real time")
        far = apart(told[fair, :-2], rows[:, :-2])
        sys.stdout.write(f"{name}: {1e3 * far:.3f} mrad or mm, {100 * fair.mean():.0f} %\n")
        assert far < MOST, name


def run(python: str, code: str, env: dict[str, str]) -> str:
    done = subprocess.run(
        [python, "-c", code], env=env, capture_output=True, text=True, timeout=20 * LOOP_S + 60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr
