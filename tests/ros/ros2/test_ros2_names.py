"""What ROS 2 reads of us, held against rosbags' own types and against published values."""

from __future__ import annotations

import pytest

from trocar.errors import InputError
from trocar.messages import message_names, message_type, service_type
from trocar.ros.transports.ros2 import naming, network
from trocar.ros.transports.ros2.naming import type_hash


def test_the_hash_of_a_type_is_the_published_one() -> None:
    # Source: ROS 2 Jazzy, std_msgs/msg/String.json
    published = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert type_hash(message_type("std_msgs/String")) == published


def test_hashes_are_those_that_rosbags_has_for_its_own_definitions() -> None:
    store = naming.typestore("ROS2_JAZZY")
    kinds = [message_type(name) for name in message_names()]
    known = [kind for kind in kinds if kind.ros2_name in store.fielddefs]
    assert len(known) > 25
    for kind in known:
        assert type_hash(kind) == store.hash_rihs01(kind.ros2_name), kind.name


@pytest.mark.parametrize(
    ("service", "half", "start"),
    [
        ("crtk_msgs/QueryForwardKinematics", "request", "2819ed79e134df1b3e6f9345894ef3cf"),
        ("crtk_msgs/QueryForwardKinematics", "response", "27a16a13341247258c839f8f0924e81a"),
        ("cisst_msgs/ConvertFloat64Array", "request", "6c7f3f6a9678654e22f6da888b0c10c3"),
    ],
)
def test_hashes_of_services_and_of_types_that_ros_does_not_have(
    service: str, half: str, start: str
) -> None:
    """Source: REP-2016, written out by hand before rosbags computed them."""
    assert type_hash(getattr(service_type(service), half)).startswith(f"RIHS01_{start}")


@pytest.mark.parametrize(("older", "distribution"), [(False, "ROS2_JAZZY"), (True, "ROS2_HUMBLE")])
def test_the_node_is_described_with_the_gids_of_a_distribution(
    older: bool, distribution: str
) -> None:
    store, size = naming.typestore(distribution), 24 if older else 16
    own, reader, writer = (bytes([n]) * 16 for n in (1, 2, 3))
    data = naming.entities_info(own, "trocar", [reader, reader], [writer], older=older)
    message = store.deserialize_cdr(data, "rmw_dds_common/msg/ParticipantEntitiesInfo")
    (node,) = message.node_entities_info_seq
    assert bytes(message.gid.data) == own.ljust(size, b"\0")
    assert (node.node_namespace, node.node_name) == ("/", "trocar")
    assert [bytes(gid.data)[:16] for gid in node.reader_gid_seq] == [reader, reader]
    assert [bytes(gid.data)[:16] for gid in node.writer_gid_seq] == [writer]
    # The bytes that were written by hand before rosbags did: gid, one node, "/", its name, Gids.
    fixed = b"\0\1\0\0" + own.ljust(size, b"\0") + b"\1\0\0\0" + b"\2\0\0\0/\0\0\0"
    assert data.startswith(fixed + b"\7\0\0\0trocar\0\0\2\0\0\0" + reader)


def test_names_are_those_of_ros_2() -> None:
    assert naming.topic_name("PSM1/measured_js") == "rt/PSM1/measured_js"
    assert naming.request_name("PSM1/crtk_version") == "rq/PSM1/crtk_versionRequest"
    assert naming.reply_name("PSM1/crtk_version") == "rr/PSM1/crtk_versionReply"


def test_user_data_is_read_back() -> None:
    data = naming.user_data(serviceid="1.2", typehash="RIHS01_0")
    assert naming.read_user_data(data, "typehash") == "RIHS01_0"
    assert naming.read_user_data(data, "clientid") is None
    assert naming.read_user_data(b"\xff;;=", "clientid") is None


def test_it_stays_on_the_loopback_unless_told_otherwise() -> None:
    assert '"127.0.0.1"' in str(network({}).config)
    assert '"127.0.0.1"' in str(network({"ROS_LOCALHOST_ONLY": "1"}).config)
    both = {"ROS_LOCALHOST_ONLY": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    assert '"127.0.0.1"' in str(network(both).config)
    assert "Interfaces" not in str(network({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}).config)
    assert network({"CYCLONEDDS_URI": "file:x"}).config is None


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("ROS_DOMAIN_ID", "-1"),
        ("ROS_DOMAIN_ID", "233"),
        ("ROS_DOMAIN_ID", "²"),
        ("ROS_LOCALHOST_ONLY", "yes"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"),
    ],
)
def test_a_variable_with_an_impossible_value_is_named(variable: str, value: str) -> None:
    with pytest.raises(InputError, match=rf"{variable}: got '{value}'; allowed"):
        network({variable: value})
