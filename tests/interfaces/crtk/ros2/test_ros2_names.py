"""What ROS 2 reads of us, held against rosbags' own types and against published values."""

from __future__ import annotations

import pytest

from trocar.errors import InputError
from trocar.interfaces.crtk.messages import message_names, message_type
from trocar.interfaces.crtk.transports.ros2 import graph, names, network
from trocar.interfaces.crtk.transports.ros2.hashes import type_hash


def test_the_hash_of_a_type_is_the_published_one() -> None:
    # Source: ROS 2 Jazzy, std_msgs/msg/String.json
    published = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert type_hash(message_type("std_msgs/String")) == published


def test_hashes_agree_with_rosbags_for_every_type_that_it_knows() -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kinds = [message_type(name) for name in message_names()]
    known = [kind for kind in kinds if kind.ros2_name in store.fielddefs]
    assert len(known) > 25
    for kind in known:
        assert type_hash(kind) == store.hash_rihs01(kind.ros2_name), kind.name


def test_hashes_agree_with_rosbags_for_types_that_it_reads_from_our_text() -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kinds = [message_type(f"crtk_msgs/{n}") for n in ("OperatingState", "StringStamped")]
    for kind in kinds:
        store.register(typesys.get_types_from_msg(kind.text_ros2, kind.ros2_name))
        assert type_hash(kind) == store.hash_rihs01(kind.ros2_name), kind.name


@pytest.mark.parametrize(("size", "distribution"), [(16, "ROS2_JAZZY"), (24, "ROS2_HUMBLE")])
def test_the_node_is_introduced_as_rosbags_reads_it(size: int, distribution: str) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores[distribution])
    own, reader, writer = (bytes([n]) * 16 for n in (1, 2, 3))
    data = graph.entities_info(own, "trocar", [reader, reader], [writer], size=size)
    message = store.deserialize_cdr(data, "rmw_dds_common/msg/ParticipantEntitiesInfo")
    (node,) = message.node_entities_info_seq
    assert bytes(message.gid.data) == own.ljust(size, b"\0")
    assert (node.node_namespace, node.node_name) == ("/", "trocar")
    assert [bytes(gid.data)[:16] for gid in node.reader_gid_seq] == [reader, reader]
    assert [bytes(gid.data)[:16] for gid in node.writer_gid_seq] == [writer]


def test_gids_are_as_long_as_the_distribution_has_them() -> None:
    assert network({"ROS_DISTRO": "humble"}).gid_size == 24
    assert network({"ROS_DISTRO": "jazzy"}).gid_size == network({}).gid_size == 16


def test_names_are_those_of_ros_2() -> None:
    assert names.topic_name("PSM1/measured_js") == "rt/PSM1/measured_js"
    assert names.request_name("PSM1/crtk_version") == "rq/PSM1/crtk_versionRequest"
    assert names.reply_name("PSM1/crtk_version") == "rr/PSM1/crtk_versionReply"


def test_user_data_is_read_back() -> None:
    data = names.user_data(serviceid="1.2", typehash="RIHS01_0")
    assert names.read_user_data(data, "typehash") == "RIHS01_0"
    assert names.read_user_data(data, "clientid") is None
    assert names.read_user_data(b"\xff;;=", "clientid") is None


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
