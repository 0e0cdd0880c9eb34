"""Definitions, checksums, and what is refused of a message."""

from __future__ import annotations

import json
import random
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

from tests.messages.content import ALL, each_type, plain, random_message
from trocar.errors import InputError, UnknownNameError
from trocar.messages import (
    MessageError,
    MessageType,
    blank,
    cdr_decode,
    cdr_encode,
    message_names,
    message_type,
    ros1_decode,
    ros1_encode,
    service_names,
    service_type,
)
from trocar.messages.types import read_fields

# Source: `_md5sum` of Debian 12's python3-std-msgs, -sensor-msgs, -geometry-msgs, -tf2-msgs,
# -rosgraph-msgs. OperatingState: published by several ROS 1 builds under its old name,
# crtk_msgs/operating_state. StringStamped: robotnik_msgs has the same definition.
PUBLISHED = """
crtk_msgs/OperatingState b1bd4021639d9d9c5fbfff78d6ff3158
crtk_msgs/StringStamped 5e3e46086181199270f1ac3a28a5977f
geometry_msgs/Point 4a842b65f413084dc2b10fb484ea7f17
geometry_msgs/PointStamped c63aecb41bfdfd6b7e1fac37c7cbe7bf
geometry_msgs/Pose e45d45a5a1ce597b249e23fb30fc871f
geometry_msgs/PoseArray 916c28c5764443f268b296bb671b9d97
geometry_msgs/PoseStamped d3812c3cbc69362b77dc0b19b345f8f5
geometry_msgs/Quaternion a779879fadf0160734f906b8c19c7004
geometry_msgs/QuaternionStamped e57f1e547e0e1fd13504588ffc8334e2
geometry_msgs/Transform ac9eff44abf714214112b05d54a3cf9b
geometry_msgs/TransformStamped b5764a33bfeb3588febc2682852579b0
geometry_msgs/Twist 9f195f881246fdfa2798d1d3eebca84a
geometry_msgs/TwistStamped 98d34b0043a2093cf9d9345ab6eef12e
geometry_msgs/Vector3 4a842b65f413084dc2b10fb484ea7f17
geometry_msgs/Vector3Stamped 7b324c7325e683bf02a9b14b01090ec7
geometry_msgs/Wrench 4f539cf138b23283b520fd271b567936
geometry_msgs/WrenchStamped d78d3cb249ce23087ade7e7d0c40cfa7
rosgraph_msgs/Clock a9c97c1d230cfc112e270351a944ee47
sensor_msgs/CameraInfo c9a58c1b0b154e0e6da7578cb991d214
sensor_msgs/CompressedImage 8f7a12909da2c9d3332d540a0977563f
sensor_msgs/Image 060021388200f6f0f447d0fcd9c64743
sensor_msgs/Imu 6a62c6daae103f4ff57a132d6f95cec2
sensor_msgs/JointState 3066dcd76a6cfaef579bd0f34173e9fd
sensor_msgs/Joy 5a9ea5f83505693b71e785041e67a8bb
sensor_msgs/RegionOfInterest bdb633039d588fcccb441a4d43ccfe09
std_msgs/Bool 8b94c1b53db61fb6aed406028ad6332a
std_msgs/Empty d41d8cd98f00b204e9800998ecf8427e
std_msgs/Float32 73fcbf46b49191e672908e50842a83d4
std_msgs/Float64 fdb28210bfa9d7c91146260178d9a584
std_msgs/Float64MultiArray 4b7d974086d4060e7db4613a7e6c3ba4
std_msgs/Header 2176decaecbce78abc3b96ef049fabed
std_msgs/Int32 da5909fbe378aeaf85e547e830cc1bb7
std_msgs/MultiArrayDimension 4cd0c83a8683deae40ecdac60e53bfa8
std_msgs/MultiArrayLayout 0fed2a11c13e11c5571b4e2a995a91a3
std_msgs/String 992ce8a1687cec8c8bd883ec73ca41d1
tf2_msgs/TFMessage 94810edda583a504dfda3829e70d7eec
"""
MD5 = {line.split()[0]: line.split()[1] for line in PUBLISHED.strip().splitlines()}
# Source: Debian 12's python3-std-srvs.
SERVICE_MD5 = {
    "std_srvs/Empty": "d41d8cd98f00b204e9800998ecf8427e",
    "std_srvs/SetBool": "09fb03525b03e7ea1fd3992bafd87e16",
    "std_srvs/Trigger": "937c9679a518e3a18d831e57125ea522",
}
OURS = ("trocar_msgs", "crtk_msgs", "cisst_msgs")

# What genpy, ROS 1's own generator, makes of a full text: checksum and bytes of an empty message.
GENPY = """
import io, json, sys
from genpy.dynamic import generate_dynamic
answers = {}
for name, text in json.load(sys.stdin).items():
    made = generate_dynamic(name, text)[name]
    buffer = io.BytesIO()
    made().serialize(buffer)
    answers[name] = made._md5sum, buffer.getvalue().hex()
print(json.dumps(answers))
"""


def test_checksums_are_the_published_ones() -> None:
    assert {name: message_type(name).md5 for name in MD5} == MD5
    assert {name: service_type(name).md5 for name in SERVICE_MD5} == SERVICE_MD5


def test_only_types_of_our_own_and_of_the_dvrk_have_no_published_checksum() -> None:
    left = set(message_names()) - set(MD5)
    assert {name.split("/")[0] for name in left} <= set(OURS)


def test_genpy_makes_the_same_checksum_of_our_texts() -> None:
    python = shutil.which("python3", path="/usr/bin")
    if python is None or subprocess.run([python, "-c", "import genpy"], check=False).returncode:
        pytest.skip("needs genpy (Debian: python3-genpy) in /usr/bin/python3")
    texts = {kind.name: kind.text_ros1 for kind in ALL}
    told = subprocess.run(
        [python, "-c", GENPY],
        input=json.dumps(texts),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    theirs = json.loads(told.stdout)
    for kind in ALL:
        assert theirs[kind.name] == [kind.md5, ros1_encode(kind, blank(kind)).hex()], kind.name


def test_names_are_those_of_each_edition() -> None:
    kind = message_type("sensor_msgs/JointState")
    assert message_type("sensor_msgs/msg/JointState") is kind
    assert kind.ros2_name == "sensor_msgs/msg/JointState"
    assert kind.dds_name == "sensor_msgs::msg::dds_::JointState_"
    service = service_type("crtk_msgs/srv/QueryForwardKinematics")
    assert service is service_type("crtk_msgs/QueryForwardKinematics")
    assert service.request.name == "crtk_msgs/QueryForwardKinematicsRequest"
    assert service.request.dds_name == "crtk_msgs::srv::dds_::QueryForwardKinematics_Request_"


def test_an_unknown_type_is_told_with_its_neighbour() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'sensor_msgs/JointState'"):
        message_type("sensor_msgs/JointStates")
    with pytest.raises(UnknownNameError, match="std_srvs/Trigger"):
        service_type("std_srvs/Triger")


@pytest.mark.parametrize("line", ["float64", "double x", "Header header", "float64[] a b", "x"])
def test_a_line_that_is_no_field_is_refused(line: str) -> None:
    with pytest.raises(InputError, match="Thing"):
        read_fields(line, "Thing")


@each_type()
def test_random_messages_survive_both_wires(kind: MessageType) -> None:
    rng = random.Random(kind.name)
    for _ in range(20):
        message = random_message(kind, rng)
        assert plain(ros1_decode(kind, ros1_encode(kind, message))) == plain(message)
        assert plain(cdr_decode(kind, cdr_encode(kind, message))) == plain(message)


@each_type()
def test_a_blank_message_is_one_of_its_type(kind: MessageType) -> None:
    assert plain(cdr_decode(kind, cdr_encode(kind, blank(kind)))) == plain(blank(kind))
    names = [field.name for field in kind.fields if not field.only_ros1]
    assert list(blank(kind)) == names


def joint_state(**changes: Any) -> dict[str, Any]:
    return blank("sensor_msgs/JointState") | changes


HEADER = {"stamp": (1, 2), "frame_id": ""}


@pytest.mark.parametrize("encode", [ros1_encode, cdr_encode])
@pytest.mark.parametrize(
    ("changes", "path"),
    [
        ({"position": [1.0, "x"]}, "position"),
        ({"position": 3}, "position"),
        ({"position": [10**400]}, "position"),
        ({"name": ["\ud800"]}, "name"),
        ({"header": HEADER | {"stamp": 1.5}}, "header.stamp"),
        ({"header": HEADER | {"stamp": (1, 10**9)}}, "header.stamp"),
        ({"header": HEADER | {"stamp": (1, -1)}}, "header.stamp"),
        ({"header": {"stamp": (1, 2)}}, "header.frame_id"),
    ],
)
def test_encoders_say_which_field_they_cannot_write(
    encode: Any, changes: dict[str, Any], path: str
) -> None:
    with pytest.raises(MessageError, match="cannot be written") as caught:
        encode("sensor_msgs/JointState", joint_state(**changes))
    assert caught.value.kind == "sensor_msgs/JointState"
    assert caught.value.path == path
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("encode", [ros1_encode, cdr_encode])
def test_encoders_refuse_arrays_of_another_length(encode: Any) -> None:
    with pytest.raises(MessageError, match=r"k: .*got 8 values; allowed: 9"):
        encode("sensor_msgs/CameraInfo", blank("sensor_msgs/CameraInfo") | {"k": [0.0] * 8})
    short = blank("crtk_msgs/CartesianServo")
    short["axis_mode"].pop()
    with pytest.raises(MessageError, match=r"axis_mode: .*got 5 "):
        encode("crtk_msgs/CartesianServo", short)


def test_a_picture_may_be_an_array_of_any_shape() -> None:
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    message = blank("sensor_msgs/Image") | {"data": pixels}
    for data in (pixels.tobytes(), bytearray(pixels.tobytes()), list(pixels.tobytes())):
        same = message | {"data": data}
        assert cdr_encode("sensor_msgs/Image", same) == cdr_encode("sensor_msgs/Image", message)
        assert ros1_encode("sensor_msgs/Image", same) == ros1_encode("sensor_msgs/Image", message)
    flipped = message | {"data": pixels[:, ::-1]}
    again = ros1_decode("sensor_msgs/Image", ros1_encode("sensor_msgs/Image", flipped))
    assert again["data"] == pixels[:, ::-1].tobytes()


def test_arrays_given_out_are_the_receivers_own() -> None:
    data = bytearray(cdr_encode("sensor_msgs/JointState", joint_state(position=[1.0, 2.0])))
    message = cdr_decode("sensor_msgs/JointState", data)
    data[:] = bytes(len(data))
    assert message["position"].tolist() == [1.0, 2.0]
    message["position"][0] = 3.0


@pytest.mark.parametrize("name", service_names())
def test_halves_of_a_service_are_messages(name: str) -> None:
    kind = service_type(name)
    for half in (kind.request, kind.response):
        assert message_type(half.name) is half
