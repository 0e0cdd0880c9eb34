"""Topics against another make of DDS, eProsima's Fast DDS (Debian: libfastrtps-dev, g++)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from tests.ros.ros2.ros2_side import served
from trocar.messages import cdr_decode, cdr_encode
from trocar.ros.transports.ros2 import network

SOURCE = Path(__file__).parent / "fast_peer.cpp"
HEADER = "fastdds/dds/domain/DomainParticipant.hpp"
JOINTS = "sensor_msgs/JointState"
GOAL = [0.2, -0.1, 0.11, 0.3, 0.0, 0.0]


def has_fast_dds() -> bool:
    compiler = shutil.which("g++")
    if compiler is None:
        return False
    look = [compiler, "-std=c++17", "-E", "-include", HEADER, "-x", "c++", os.devnull]
    return subprocess.run(look, capture_output=True, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not has_fast_dds(), reason="Fast DDS or g++ is not installed")
def test_a_program_on_fast_dds_hears_the_arm_and_moves_it(tmp_path: Path) -> None:
    program = tmp_path / "fast_peer"
    build = ["g++", "-std=c++17", str(SOURCE), "-o", str(program), "-lfastrtps", "-lfastcdr"]
    subprocess.run(build, check=True, capture_output=True)
    order = cdr_encode(
        JOINTS,
        {
            "header": {"stamp": (0, 0), "frame_id": ""},
            "name": [],
            "position": GOAL,
            "velocity": [],
            "effort": [],
        },
    )
    # Fast DDS knows nothing of tags, so the domain alone keeps others out.
    where = replace(network({}), domain=60 + os.getpid() % 40)
    with served(where=where) as (core, _):
        time.sleep(0.5)
        run = [str(program), str(where.domain), "15", order.hex()]
        told = subprocess.run(run, check=True, capture_output=True, text=True).stdout.splitlines()
        assert core.refused == 0
    heard = json.loads(told[-1])
    assert heard["sent"]
    assert heard["states"] > 0
    assert heard["joints"] > 100
    first, last = (cdr_decode(JOINTS, bytes.fromhex(heard[key])) for key in ("first", "last"))
    assert first["header"]["stamp"] < last["header"]["stamp"]
    np.testing.assert_allclose(last["position"], GOAL, atol=0.01)
