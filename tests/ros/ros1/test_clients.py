"""Programs made for the robot: a script with rospy, and a program in C++ with roscpp."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.ros.ros1.robot_os import ROOT, SYSTEM_PYTHON, Master, need

CLIENTS = ROOT / "tests" / "clients"
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("simulator")]


def test_a_script_with_rospy_moves_the_arm(master: Master) -> None:
    need(SYSTEM_PYTHON)
    said = master.run(SYSTEM_PYTHON, str(CLIENTS / "rospy" / "move.py"), "PSM1")
    assert "at the goal" in said


def test_a_program_in_cpp_moves_the_arm(master: Master, tmp_path: Path) -> None:
    need("g++", "pkg-config")
    packages = ["roscpp", "sensor_msgs"]
    if subprocess.run(["pkg-config", "--exists", *packages]).returncode:
        pytest.skip("roscpp is not installed: libroscpp-dev, libsensor-msgs-dev")
    source = CLIENTS / "roscpp" / "move.cpp"
    assert len(source.read_text(encoding="utf-8").splitlines()) < 40
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", *packages], capture_output=True, text=True, check=True
    ).stdout.split()
    program = tmp_path / "move"
    built = subprocess.run(
        ["g++", "-O0", "-o", str(program), str(source), *flags, "-lpthread"],
        capture_output=True, text=True,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    assert "at the goal" in master.run(str(program), "PSM1")
