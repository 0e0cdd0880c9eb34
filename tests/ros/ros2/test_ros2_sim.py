"""A running simulator on ROS 2, and programs in other processes that meet it."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from tests.ros.ros2.ros2_side import Program, program, served
from trocar.messages import message_type, service_type
from trocar.ros import Core
from trocar.ros.transports.ros2 import Ros2Transport
from trocar.ros.transports.ros2.naming import type_hash

JOINTS = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]


def eventually(done, seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if done():
            return True
        time.sleep(0.02)
    return False


@pytest.fixture(scope="module")
def simulator():
    with served() as running:
        yield running


def test_a_late_subscriber_gets_states_in_order_and_the_operating_state(simulator) -> None:
    _, transport = simulator
    time.sleep(0.5)
    with program("listen", transport.where) as peer:
        told = peer.tell()
    assert np.all(np.diff(told["stamps"]) > 0)
    assert told["names"] == JOINTS
    assert np.all(np.isfinite(told["position"]))
    assert told["state"] in ("DISABLED", "ENABLED")


def test_a_service_answers_each_call_to_its_caller(simulator) -> None:
    _, transport = simulator
    with program("call", transport.where) as peer:
        told = peer.tell()
    assert told["answers"] == [[2**63 + 5, seq, True, "1.1.0"] for seq in (7, 8)]


def test_the_model_and_the_gains_are_parameters_of_the_node() -> None:
    with served() as (core, transport), program("parameters", transport.where) as peer:
        told = peer.tell()
        assert core.loop.world.arm("PSM1").joints.gains("yaw")[0] == 77.0
    assert {"robot_description", "use_sim_time", "PSM1.jaw_controller.d"} < set(told["names"])
    model, time, gain, nothing = told["values"]
    assert model[0] == 4 and "<robot" in model[3]
    assert time[:2] == [1, False]
    assert gain[0] == 3 and gain[2] > 0.0
    assert nothing[0] == 0
    assert told["results"] == [
        [True, ""],
        [False, "PSM1/yaw_controller/p: got 'much'; allowed: a number, 0 or more"],
        [False, "robot_description: read-only"],
    ]


def test_orders_in_one_burst_are_all_obeyed_in_their_order() -> None:
    with served() as (_, transport), program("drive", transport.where) as peer:
        told = peer.tell()
    seen = [tuple(state) for state in told["seen"]]
    stages = [("DISABLED", False), ("ENABLED", False), ("ENABLED", True)]
    first = [[state[:2] for state in seen].index(stage) for stage in stages]
    assert first == sorted(first)
    assert seen[-1] == ("ENABLED", True, False)


def test_bytes_that_are_no_message_are_refused_and_nothing_moves(simulator) -> None:
    core, transport = simulator
    before = core.refused
    with program("babble", transport.where):
        assert eventually(lambda: core.refused >= before + 80)
    time.sleep(0.1)
    assert core.loop.running


def test_programs_that_are_killed_hold_up_nobody(simulator) -> None:
    core, transport = simulator
    ticks = core.loop.now
    peers = [Program("linger", transport.where) for _ in range(4)]
    for peer in peers:
        os.kill(peer.process.pid, 9)
        peer.end()
    with program("listen", transport.where) as peer:
        assert len(peer.tell()["stamps"]) >= 100
    assert core.loop.now > ticks and core.loop.running
    assert transport.lost == 0


@pytest.mark.slow
def test_nothing_is_wanted_until_somebody_listens(simulator) -> None:
    _, transport = simulator
    with program("linger", transport.where):
        assert eventually(lambda: transport.wanted() == {"PSM1/measured_js"})
    # the one that was killed is missed after its lease
    assert eventually(lambda: not transport.wanted(), 30.0)


def test_it_can_be_closed_and_started_again() -> None:
    for _ in range(2):
        with served() as (core, transport):
            assert isinstance(core, Core) and isinstance(transport, Ros2Transport)


@pytest.mark.parametrize("distribution", ["humble", "jazzy"])
def test_a_client_of_any_distribution_reads_the_name_of_the_node(
    distribution: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    with served() as (_, transport):
        for _ in range(2):  # the second comes late
            with program(distribution, transport.where) as peer:
                ((rest, namespace, name, readers),) = peer.tell()["nodes"]
            assert (rest, namespace, name) == ([0] * len(rest), "/", "trocar")
            assert readers > 10


def test_every_row_of_the_table_is_there_with_its_type(simulator) -> None:
    core, transport = simulator
    with program("survey", transport.where) as peer:
        found = peer.tell()["found"]
    for topic in core.topics.values():
        entry = found.pop(f"{topic.direction} rt/{topic.name}", None)
        if topic.later:
            assert entry is None, topic.name
            continue
        kind = message_type(topic.type)
        latched = topic.latched and topic.direction == "pub"
        assert entry == [kind.dds_name, f"typehash={type_hash(kind)};", str(latched)], topic.name
    for row in core.services.values():
        kind = service_type(row.type)
        request, reply = (
            found.pop(f"sub rq/{row.name}Request"),
            found.pop(f"pub rr/{row.name}Reply"),
        )
        assert (request[0], reply[0]) == (kind.request.dds_name, kind.response.dds_name)
        assert request[1].split(";")[0] == reply[1].split(";")[0]
    for name in ("get_parameters", "list_parameters", "set_parameters_atomically"):
        assert found[f"sub rq/trocar/{name}Request"][0].startswith("rcl_interfaces::srv::dds_::")
    assert found.pop("pub ros_discovery_info")[2] == "True"
    assert not [name for name in found if "DCPS" not in name and "/trocar/" not in name]
