"""`trocar sim --ros2` as a person starts it."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import trocar

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from tests.ros.ros2.ros2_side import private_network, program

TROCAR = "import sys; from trocar.cli import main; sys.exit(main())"
QUIET = ["--no-page", "--no-websocket", "--duration", "30"]


def start(*options: str, code: str = TROCAR, **variables: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, "sim", "--rig", "psm", *QUIET, *options],
        env={**os.environ, "PYTHONPATH": str(Path(trocar.__file__).parents[1]), **variables},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_it_says_where_it_speaks_and_what_to_set_and_is_heard() -> None:
    where = private_network()
    domain = str(where.domain)
    simulator = start("--ros2", "dds", CYCLONEDDS_URI=str(where.config), ROS_DOMAIN_ID=domain)
    try:
        assert simulator.stdout is not None
        told = [simulator.stdout.readline() for _ in range(3)]
        assert "ports on all interfaces" in told[0]
        assert f"RMW_IMPLEMENTATION=rmw_cyclonedds_cpp ROS_DOMAIN_ID={domain}" in told[1]
        assert "services work with rmw_cyclonedds_cpp only" in told[2]
        with program("listen", where) as peer:
            assert len(peer.tell()["stamps"]) >= 100
    finally:
        simulator.kill()
        simulator.communicate()


@pytest.mark.parametrize("library", ["cyclonedds", "rosbags"])
def test_without_the_extra_one_line_names_it(library: str) -> None:
    hidden = f"import sys; sys.modules[{library!r}] = None; {TROCAR}"
    simulator = start("--ros2", "dds", code=hidden)
    _, said = simulator.communicate(timeout=60)
    assert simulator.returncode == 1
    assert said.strip().endswith(
        f"ROS 2 needs {library}, which is not installed: pip install 'trocar[ros2]'"
    )


def test_an_impossible_domain_is_named() -> None:
    simulator = start("--ros2", "dds", ROS_DOMAIN_ID="1000")
    _, said = simulator.communicate(timeout=60)
    assert simulator.returncode == 2
    assert "ROS_DOMAIN_ID: got '1000'; allowed: 0 to 232" in said


def test_a_network_that_is_none_is_told_in_one_line() -> None:
    where = replace(private_network(), config="<General><Interfaces><NetworkInterface/>")
    simulator = start("--ros2", "dds", CYCLONEDDS_URI=str(where.config))
    _, said = simulator.communicate(timeout=60)
    assert simulator.returncode == 1
    assert "ROS 2: a participant of domain 0: Cyclone DDS" in said
    assert "Traceback" not in said
