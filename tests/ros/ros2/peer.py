"""A ROS 2 program in a process of its own, on the wheel's ordinary typed classes: no code of ours.

`python peer.py ACTION DOMAIN CONFIG`: prints lines of JSON; the first is "ready".
"""

# pyright: reportArgumentType=false, reportCallIssue=false
# The wheel's `sequence` says nothing of being a list, which its values are.

import json
import random
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cyclonedds.idl.annotations as mark
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE_S = 30.0


@dataclass
@mark.final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@mark.final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
@mark.final
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
@mark.final
class OperatingState(IdlStruct, typename="crtk_msgs::msg::dds_::OperatingState_"):
    header: Header
    state: str
    is_homed: bool
    is_busy: bool


@dataclass
@mark.final
class StringStamped(IdlStruct, typename="crtk_msgs::msg::dds_::StringStamped_"):
    header: Header
    string: str


@dataclass
@mark.final
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: uint64
    seq: int64
    structure_needs_at_least_one_member: uint8


@dataclass
@mark.final
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


@dataclass
@mark.final
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: uint8
    bool_value: bool
    integer_value: int64
    double_value: float64
    string_value: str
    byte_array_value: sequence[uint8]
    bool_array_value: sequence[bool]
    integer_array_value: sequence[int64]
    double_array_value: sequence[float64]
    string_array_value: sequence[str]


@dataclass
@mark.final
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
@mark.final
class SetParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
@mark.final
class GetRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Request_"):
    guid: uint64
    seq: int64
    names: sequence[str]


@dataclass
@mark.final
class GetResponse(IdlStruct, typename="rcl_interfaces::srv::dds_::GetParameters_Response_"):
    guid: uint64
    seq: int64
    values: sequence[ParameterValue]


@dataclass
@mark.final
class ListRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::ListParameters_Request_"):
    guid: uint64
    seq: int64
    prefixes: sequence[str]
    depth: uint64


@dataclass
@mark.final
class ListResponse(IdlStruct, typename="rcl_interfaces::srv::dds_::ListParameters_Response_"):
    guid: uint64
    seq: int64
    names: sequence[str]
    prefixes: sequence[str]


@dataclass
@mark.final
class SetRequest(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Request_"):
    guid: uint64
    seq: int64
    parameters: sequence[Parameter]


@dataclass
@mark.final
class SetResponse(IdlStruct, typename="rcl_interfaces::srv::dds_::SetParameters_Response_"):
    guid: uint64
    seq: int64
    results: sequence[SetParametersResult]


@dataclass
@mark.final
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
@mark.final
class RegionOfInterest(IdlStruct, typename="sensor_msgs::msg::dds_::RegionOfInterest_"):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@dataclass
@mark.final
class CameraInfo(IdlStruct, typename="sensor_msgs::msg::dds_::CameraInfo_"):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
@mark.final
class Noise(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    octets: sequence[uint8]


def graph_type(size: int) -> type:
    """Return ParticipantEntitiesInfo with Gids of so many octets."""

    @dataclass
    @mark.final
    class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
        data: array[uint8, size]  # pyright: ignore[reportInvalidTypeForm]

    @dataclass
    @mark.final
    class Node(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
        node_namespace: str
        node_name: str
        reader_gid_seq: sequence[Gid]
        writer_gid_seq: sequence[Gid]

    @dataclass
    @mark.final
    class Info(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
        gid: Gid
        node_entities_info_seq: sequence[Node]

    return Info


VOLATILE = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.History.KeepLast(1000),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
LATCHED = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


def say(**values: Any) -> None:
    sys.stdout.write(f"{json.dumps(values)}\n")
    sys.stdout.flush()


def until(done: Callable[[], bool]) -> None:
    """Wait for a condition; raise TimeoutError where it does not come."""
    end = time.monotonic() + PATIENCE_S
    while not done():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.01)


def header() -> Header:
    now = time.time_ns()
    return Header(Time(now // 1_000_000_000, now % 1_000_000_000), "")


def listen(participant: DomainParticipant) -> None:
    """Tell of a hundred joint states, and of the latched state that was there before us."""
    joints = DataReader(
        participant, Topic(participant, "rt/PSM1/measured_js", JointState), VOLATILE
    )
    topic = Topic(participant, "rt/PSM1/operating_state", OperatingState)
    state = DataReader(participant, topic, LATCHED)
    say(ready=True)
    got: list[JointState] = []
    states: list[OperatingState] = []

    def enough() -> bool:
        got.extend(joints.take(100))
        states.extend(state.take(100))
        return len(got) >= 100 and bool(states)

    until(enough)
    stamps = [s.header.stamp.sec * 1_000_000_000 + s.header.stamp.nanosec for s in got]
    say(
        stamps=stamps,
        names=list(got[0].name),
        position=list(got[-1].position),
        state=states[0].state,
        homed=states[0].is_homed,
    )


def drive(participant: DomainParticipant) -> None:
    """Switch off and on, home and move in one burst; tell how the state of the arm changed."""
    topic = Topic(participant, "rt/PSM1/operating_state", OperatingState)
    state = DataReader(participant, topic, LATCHED)
    topic = Topic(participant, "rt/PSM1/state_command", StringStamped)
    orders = DataWriter(participant, topic, LATCHED)
    moves = DataWriter(participant, Topic(participant, "rt/PSM1/move_jp", JointState), VOLATILE)
    joints = DataReader(
        participant, Topic(participant, "rt/PSM1/measured_js", JointState), VOLATILE
    )
    say(ready=True)
    until(lambda: bool(orders.get_matched_subscriptions() and moves.get_matched_subscriptions()))
    until(lambda: bool(joints.take(100)))  # the simulator has matched the last of our ends
    until(lambda: bool(state.take(100)))  # the state before the orders
    goal = [0.2, -0.1, 0.11, 0.3, 0.0, 0.0]
    for order in ("disable", "unhome", "enable", "home"):
        orders.write(StringStamped(header(), order))
    moves.write(JointState(header(), [], goal, [], []))
    seen: list[tuple[str, bool, bool]] = []
    last: list[float] = []

    def arrived() -> bool:
        seen.extend((s.state, s.is_homed, s.is_busy) for s in state.take(100))
        for sample in joints.take(100):
            last[:] = sample.position
        near = last and max(abs(a - b) for a, b in zip(last, goal, strict=True)) < 0.01
        return bool(near and seen) and not seen[-1][2]

    until(arrived)
    say(seen=seen)


def calls(
    participant: DomainParticipant, name: str, request: type, response: type, *given: Any
) -> list[Any]:
    """Return the answers to calls of a service, as rmw_cyclonedds_cpp makes them."""
    asked = Topic(participant, f"rq/{name}Request", request)
    answered = Topic(participant, f"rr/{name}Reply", response)
    own = Policy.Userdata(b"clientid=1.2.3;")
    requests = DataWriter(participant, asked, VOLATILE + Qos(own))
    replies = DataReader(participant, answered, VOLATILE + Qos(own))
    until(lambda: bool(requests.get_matched_subscriptions() and replies.get_matched_publications()))
    got: list[Any] = []

    def complete() -> bool:
        got.extend(replies.take(10))
        return len(got) == len(given)

    for one in given:
        requests.write(one)
    until(complete)
    return sorted(got, key=lambda answer: answer.seq)


def call(participant: DomainParticipant) -> None:
    """Call a service twice."""
    say(ready=True)
    given = [TriggerRequest(2**63 + 5, seq, 0) for seq in (7, 8)]
    got = calls(participant, "PSM1/crtk_version", TriggerRequest, TriggerResponse, *given)
    say(answers=[(a.guid, a.seq, a.success, a.message) for a in got])


def parameters(participant: DomainParticipant) -> None:
    """List, get and set parameters of the node."""
    say(ready=True)
    request = ListRequest(1, 1, [], 0)
    (listed,) = calls(participant, "trocar/list_parameters", ListRequest, ListResponse, request)
    get = "trocar/get_parameters", GetRequest, GetResponse
    names = ["robot_description", "use_sim_time", "PSM1.yaw_controller.p", "nothing"]
    (got,) = calls(participant, *get, GetRequest(1, 2, names))
    number = ParameterValue(3, False, 0, 77.0, "", [], [], [], [], [])
    text = ParameterValue(4, False, 0, 0.0, "much", [], [], [], [], [])
    given = [Parameter(names[2], number), Parameter(names[2], text), Parameter(names[0], text)]
    request = SetRequest(1, 3, given)
    (done,) = calls(participant, "trocar/set_parameters", SetRequest, SetResponse, request)
    until(
        lambda: (
            calls(participant, *get, GetRequest(1, 4, names[2:3]))[0].values[0].double_value == 77.0
        )
    )
    say(
        names=listed.names,
        values=[(v.type, v.bool_value, v.double_value, v.string_value) for v in got.values],
        results=[(r.successful, r.reason) for r in done.results],
    )


def survey(participant: DomainParticipant) -> None:
    """Tell of every topic that others write or read, and of who they say they are."""
    found: dict[str, list[str]] = {}
    say(ready=True)
    kinds = {"pub": BuiltinTopicDcpsPublication, "sub": BuiltinTopicDcpsSubscription}
    readers = {way: BuiltinDataReader(participant, kind) for way, kind in kinds.items()}
    last = time.monotonic()
    while time.monotonic() - last < 2.0:
        for way, reader in readers.items():
            for end in reader.take(100):
                last = time.monotonic()
                told = end.qos[Policy.Userdata]
                data = told.data.decode() if told else ""
                latched = Policy.Durability.TransientLocal in end.qos
                found[f"{way} {end.topic_name}"] = [end.type_name, data, str(latched)]
        time.sleep(0.05)
    say(found=found)


def look(participant: DomainParticipant) -> None:
    """Tell of five images."""
    topic = Topic(participant, "rt/stereo/left/image_raw", Image)
    reader = DataReader(participant, topic, VOLATILE)
    say(ready=True)
    got: list[Image] = []

    def enough() -> bool:
        got.extend(reader.take(1))
        return len(got) == 5

    until(enough)
    whole = all(bytes(i.data) == bytes([i.header.stamp.nanosec]) * 921_600 for i in got)
    say(stamps=[i.header.stamp.nanosec for i in got], whole=whole)


def watch(participant: DomainParticipant) -> None:
    """Tell of ten images of the right eye and of what is said of its lens."""
    image = Topic(participant, "rt/endoscope/right/image_raw", Image)
    info = Topic(participant, "rt/endoscope/right/camera_info", CameraInfo)
    images, infos = (
        DataReader(participant, image, VOLATILE),
        DataReader(participant, info, VOLATILE),
    )
    say(ready=True)
    seen: list[Image] = []
    told: list[CameraInfo] = []

    def enough() -> bool:
        seen.extend(images.take(1))
        told.extend(infos.take(1))
        return len(seen) >= 10 and len(told) >= 10

    until(enough)

    def stamps(messages: list[Any]) -> list[list[int]]:
        return [[m.header.stamp.sec, m.header.stamp.nanosec] for m in messages]

    say(
        images=stamps(seen),
        infos=stamps(told),
        sizes=[[i.height, i.width, i.step, len(i.data)] for i in seen],
        frame=seen[0].header.frame_id,
        p=list(told[0].p),
        size=[told[0].height, told[0].width],
    )


def babble(participant: DomainParticipant) -> None:
    """Publish octets by chance under the name of a type."""
    writer = DataWriter(participant, Topic(participant, "rt/PSM1/move_jp", Noise), VOLATILE)
    say(ready=True)
    until(lambda: bool(writer.get_matched_subscriptions()))
    chance = random.Random(7)
    for size in range(80):
        writer.write(Noise(list(chance.randbytes(size))))
    time.sleep(PATIENCE_S)


def nodes(participant: DomainParticipant, size: int, *own: Policy.Userdata) -> None:
    """Tell of every node of the graph, as a client of one distribution reads them."""
    topic = Topic(participant, "ros_discovery_info", graph_type(size))
    reader = DataReader(participant, topic, LATCHED + Qos(*own))
    say(ready=True)
    got: list[Any] = []

    def some() -> bool:
        got.extend(reader.take(10))
        return bool(got)

    until(some)
    time.sleep(0.5)
    some()
    found = [
        [list(info.gid.data[16:]), node.node_namespace, node.node_name, len(node.reader_gid_seq)]
        for info in got
        for node in info.node_entities_info_seq
    ]
    say(nodes=found)


def humble(participant: DomainParticipant) -> None:
    """Read the graph as ROS 2 Humble does: Gids of 24 octets, and no hashes of types."""
    nodes(participant, 24)


def jazzy(participant: DomainParticipant) -> None:
    """Read the graph as ROS 2 since Iron does: Gids of 16 octets, and hashes of types."""
    # Source: REP-2016's hash of rmw_dds_common/msg/ParticipantEntitiesInfo in Jazzy.
    kind = "RIHS01_e725f4a506958c79f95dd693b965722c57b19cd18e7eff984f49561b93dc985d"
    nodes(participant, 16, Policy.Userdata(f"typehash={kind};".encode()))


def linger(participant: DomainParticipant) -> None:
    """Listen without ever reading, until killed."""
    topic = Topic(participant, "rt/PSM1/measured_js", JointState)
    reader = DataReader(participant, topic, VOLATILE)
    until(lambda: bool(reader.get_matched_publications()))
    say(ready=True)
    time.sleep(PATIENCE_S)


if __name__ == "__main__":
    number = int(sys.argv[2])
    domain = Domain(number, sys.argv[3])
    actions = {
        action.__name__: action
        for action in (
            listen,
            drive,
            call,
            survey,
            look,
            watch,
            babble,
            linger,
            humble,
            jazzy,
            parameters,
        )
    }
    actions[sys.argv[1]](DomainParticipant(number))
