"""Scripts for ROS 2: rclpy over the simulation, and an installed client that stands on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.scripts.playing import play
from trocar.errors import InputError
from trocar.messages import blank, cdr_encode, message_names
from trocar.scripts import Live, Stepped, run_script
from trocar.scripts.messages import fields_of, message_class, message_of
from trocar.scripts.run import edition_of
from trocar.simulation import World
from trocar.teleoperation import components

NODE = """
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    class Mover(Node):
        def __init__(self):
            super().__init__("mover")
            self.sent, self.heard = 0, []
            self.to = self.create_publisher(JointState, "PSM1/servo_jp", 10)
            self.create_subscription(JointState, "PSM1/setpoint_js", self.listen, 10)
            self.create_timer(0.01, self.beat)
        def listen(self, message):
            self.heard.append(message)
        def beat(self):
            self.sent += 1
            goal = JointState(position=[0.0005 * self.sent, 0.0, 0.12, 0.0, 0.0, 0.0])
            goal.header.stamp = self.get_clock().now().to_msg()
            self.to.publish(goal)
            if self.sent == 100:
                rclpy.shutdown()
"""


def test_a_node_publishes_subscribes_and_keeps_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    text = (
        NODE
        + """
    import hashlib, time
    rclpy.init()
    node, start = Mover(), time.time()
    rclpy.spin(node)
    assert not rclpy.ok() and abs(time.time() - start - 1.0) < 2e-3, time.time() - start
    assert 99 <= len(node.heard) <= 101, len(node.heard)
    last = node.heard[-1]
    assert abs(last.position[0] - 0.0005 * 99) < 1e-3, last.position
    assert type(last.position).__name__ == "array" and last.header.stamp.sec in (1000, 1001)
    print(hashlib.sha256(b"".join(m.position.tobytes() for m in node.heard)).hexdigest())
    """
    )
    for _ in range(2):
        assert play(tmp_path, text).status == 0
    first, second = capsys.readouterr().out.split()
    assert first == second


def test_beside_the_wall_clock_a_node_keeps_its_period(tmp_path: Path):
    script = tmp_path / "script.py"
    text = (
        NODE
        + """
    import time
    rclpy.init()
    node, start = Mover(), time.monotonic()
    rclpy.spin(node)
    assert 0.9 < time.monotonic() - start < 20.0 and node.heard
    """
    )
    script.write_text("\n".join(line[4:] for line in text.splitlines()), encoding="utf-8")
    assert run_script(script, (), Live(World("psm"), rate_hz=100.0), 60.0).status == 0


def test_without_spinning_no_callback_runs(tmp_path: Path):
    text = (
        NODE
        + """
    import time
    rclpy.init()
    node = Mover()
    time.sleep(1.0)
    assert not node.heard and not node.sent
    rclpy.spin_once(node, timeout_sec=0.0)
    assert node.sent == 1 and not node.heard
    rclpy.spin_once(node)
    assert len(node.heard) == 1
    """
    )
    assert play(tmp_path, text).status == 0


def test_executors_keep_to_callback_groups(tmp_path: Path):
    text = """
    import rclpy, threading, time
    from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
    from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
    def busy(executor, group, count):
        node, inside, most = rclpy.create_node("busy"), [], []
        def work():
            inside.append(1)
            most.append(len(inside))
            time.sleep(0.5)
            inside.pop()
        for _ in range(count):
            node.create_timer(0.1, work, group())
        executor.add_node(node)
        thread = threading.Thread(target=executor.spin, daemon=True)
        thread.start()
        time.sleep(2.0)
        executor.shutdown()
        node.destroy_node()
        return max(most)
    rclpy.init()
    one = MutuallyExclusiveCallbackGroup()
    assert busy(SingleThreadedExecutor(), ReentrantCallbackGroup, 3) == 1
    assert busy(MultiThreadedExecutor(num_threads=4), ReentrantCallbackGroup, 3) >= 3
    assert busy(MultiThreadedExecutor(num_threads=4), lambda: one, 3) == 1
    """
    assert play(tmp_path, text).status == 0


def test_services_futures_and_coroutines(tmp_path: Path):
    text = """
    import rclpy, threading
    from crtk_msgs.srv import QueryForwardKinematics
    from std_srvs.srv import SetBool
    rclpy.init()
    node = rclpy.create_node("asks")
    client = node.create_client(QueryForwardKinematics, "/PSM1/local/forward_kinematics")
    assert client.wait_for_service(timeout_sec=1.0)
    request = QueryForwardKinematics.Request()
    request.jp = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=1.0)
    assert future.done() and abs(future.result().cp.position.z + 0.1135) < 1e-3
    assert not node.create_client(SetBool, "nowhere").wait_for_service(timeout_sec=0.1)
    def switch(request, response):
        response.success, response.message = request.data, "switched"
        return response
    node.create_service(SetBool, "switch", switch)
    mine, told = node.create_client(SetBool, "switch"), []
    async def ask():
        answer = await mine.call_async(SetBool.Request(data=True))
        told.append(answer.message)
        rclpy.shutdown()
    node.create_timer(0.1, ask)
    rclpy.spin(node)
    assert told == ["switched"], told
    """
    assert play(tmp_path, text).status == 0


def test_a_rate_and_a_call_need_a_thread_that_spins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    text = """
    import rclpy, threading, time
    rclpy.init()
    node = rclpy.create_node("slow")
    rate = node.create_rate(10.0)
    def alone():
        rate.sleep()
    waiting = threading.Thread(target=alone)
    waiting.start()
    waiting.join(5.0)
    assert waiting.is_alive()
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    waiting.join(1.0)
    assert not waiting.is_alive()
    start = time.time()
    for _ in range(10):
        rate.sleep()
    assert abs(time.time() - start - 1.0) < 0.11, time.time() - start
    rclpy.shutdown()
    """
    assert play(tmp_path, text).status == 0
    said = capsys.readouterr().err
    assert said.count("rate.sleep() waits for ever unless another thread spins node 'slow'") == 1


def test_parameters_names_and_words_of_the_command_line(tmp_path: Path):
    text = """
    import rclpy, sys
    from rclpy.parameter import Parameter
    from rcl_interfaces.msg import SetParametersResult
    from std_msgs.msg import Float64
    rclpy.init(args=sys.argv)
    assert rclpy.utilities.remove_ros_args(sys.argv)[1:] == ["plain"]
    node = rclpy.create_node("first", namespace="lab")
    assert node.get_fully_qualified_name() == "/lab/second"
    node.declare_parameters("", [("gain", 1.0), ("names", ["a"]), ("on", False)])
    assert node.get_parameter("gain").value == 2.5
    assert node.get_parameter("on").get_parameter_value().bool_value is True
    assert node.get_parameter("names").type_ == Parameter.Type.STRING_ARRAY
    try:
        node.get_parameter("other")
    except rclpy.exceptions.ParameterNotDeclaredException:
        pass
    node.add_on_set_parameters_callback(
        lambda given: SetParametersResult(successful=given[0].value < 9.0)
    )
    values = [Parameter("gain", value=3.0), Parameter("gain", value=9.5)]
    assert [result.successful for result in node.set_parameters(values)] == [True, False]
    assert node.get_parameter("gain").value == 3.0
    topic = node.create_publisher(Float64, "~/scale", 1).topic_name
    assert topic == "/lab/second/scale", topic
    assert node.create_publisher(Float64, "/old", 1).topic_name == "/new"
    try:
        node.create_publisher(Float64, "/2nd//x", 1)
    except rclpy.exceptions.InvalidTopicNameException:
        pass
    else:
        raise AssertionError
    """
    given = ("-p", "gain:=2.5", "-p", "on:=true", "-r", "__node:=second", "-r", "/old:=/new")
    assert play(tmp_path, text, arguments=("plain", "--ros-args", *given)).status == 0


def test_qualities_that_do_not_fit_carry_no_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    text = """
    import rclpy, time
    from rclpy.qos import QoSProfile, DurabilityPolicy, qos_profile_sensor_data
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64
    rclpy.init()
    node, heard = rclpy.create_node("fussy"), {}
    late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for name, kind, profile in (
        ("measured_js", JointState, late), ("setpoint_js", JointState, qos_profile_sensor_data),
        ("trajectory_j/ratio", Float64, late), ("trajectory_j/ratio", Float64, 1),
    ):
        box = heard.setdefault((name, profile is late), [])
        node.create_subscription(kind, f"PSM1/{name}", box.append, profile)
    weak = node.create_publisher(JointState, "PSM1/servo_jp", qos_profile_sensor_data)
    assert weak.get_subscription_count() == 0
    end = time.time() + 0.2
    while time.time() < end:
        rclpy.spin_once(node, timeout_sec=0.01)
    count = {key: len(box) for key, box in heard.items()}
    assert count["measured_js", True] == 0 and count["setpoint_js", False] > 5, count
    assert count["trajectory_j/ratio", True] == 1 and count["trajectory_j/ratio", False] == 0
    """
    assert play(tmp_path, text).status == 0
    said = capsys.readouterr().err
    assert "'/PSM1/measured_js' offers or requests incompatible QoS" in said
    assert "incompatible policy: RELIABILITY" in said


def test_times_of_different_clocks_do_not_mix(tmp_path: Path):
    text = """
    import rclpy
    from rclpy.clock import Clock, ClockType
    from rclpy.duration import Duration
    from rclpy.time import Time
    rclpy.init()
    node = rclpy.create_node("times")
    now = node.get_clock().now()
    assert Time.from_msg(now.to_msg()) == now
    assert (now + Duration(seconds=1.5)) - now == Duration(nanoseconds=1_500_000_000)
    assert now.seconds_nanoseconds()[0] == 1000 and now > now - Duration(seconds=1)
    try:
        now < Clock().now()
    except TypeError as problem:
        assert "different clock types" in str(problem)
    node.get_clock().sleep_for(Duration(seconds=0.5))
    assert abs((node.get_clock().now() - now).nanoseconds - 5e8) < 2e6
    """
    assert play(tmp_path, text).status == 0


def test_every_message_of_ros_2_has_the_bytes_of_that_of_ros_1():
    for name in message_names():
        kind = message_class(name, 2)
        assert cdr_encode(name, fields_of(kind())) == cdr_encode(name, blank(name))
        assert message_of(kind, fields_of(kind())) == kind()
        assert list(kind.get_fields_and_field_types()) == list(kind.__slots__)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "values", "wrong"),
    [
        ("std_msgs/Float64", {"data": 1}, "got int; allowed: float"),
        ("std_msgs/Bool", {"data": 1}, "got int; allowed: bool"),
        ("sensor_msgs/JointState", {"position": "0.1"}, "position"),
        ("sensor_msgs/JointState", {"positions": []}, "has no field 'positions'"),
        ("geometry_msgs/PoseStamped", {"pose": None}, "allowed: Pose"),
    ],
)
def test_a_field_of_another_type_is_refused_as_by_ros_2(name: str, values: dict, wrong: str):
    with pytest.raises(AssertionError, match=wrong):
        message_class(name, 2)(**values)


def test_our_crtk_and_dvrk_have_messages_and_times_of_ros_2(tmp_path: Path):
    text = """
    import crtk, dvrk, rclpy, numpy as np
    from rclpy.time import Time
    from geometry_msgs.msg import PoseStamped
    ral = crtk.ral("own")
    arm = dvrk.psm(ral, "PSM1")
    heard = []
    ral.subscriber("PSM1/measured_cp", PoseStamped, heard.append)
    ral.spin()
    ral.check_connections()
    assert ral.ros_version() == 2
    before = ral.now()
    assert arm.move_jp(np.array([0.1, 0.0, 0.12, 0.0, 0.0, 0.0])).wait()
    assert arm.jaw.open(0.5).wait() and arm.move_cp(arm.setpoint_cp()[0]).wait()
    assert ral.now() > before and ral.to_sec(ral.now() - before) > 0.1
    assert isinstance(Time.from_msg(heard[-1].header.stamp), Time)
    assert abs(ral.to_sec(heard[-1]) - ral.to_sec(ral.now())) < 0.05
    pose = crtk.msg_conversions.FrameToPoseMsg(arm.measured_cp()[0])
    assert type(pose) is type(PoseStamped().pose)
    frame = arm.forward_kinematics(np.zeros(6)) if hasattr(arm, "forward_kinematics") else None
    ral.shutdown()
    assert ral.is_shutdown()
    """
    assert play(tmp_path, text).status == 0


#: Does what an installed client for ROS 2 does, in our own words.
CLIENT = """
    import os, threading
    import rclpy, rclpy.publisher, rclpy.qos, rclpy.subscription, rclpy.time, rclpy.utilities
    from crtk_msgs.msg import OperatingState, StringStamped
    from sensor_msgs.msg import JointState
    assert os.environ["ROS_VERSION"] == "2"
    rclpy.init()
    node = rclpy.create_node("client")
    came, state, joints = threading.Event(), [OperatingState()], []
    def heard(message):
        old = rclpy.time.Time.from_msg(state[0].header.stamp)
        if rclpy.time.Time.from_msg(message.header.stamp) > old:
            state[0] = message
        came.set()
    ends = [
        node.create_subscription(OperatingState, "/PSM1/operating_state", heard, 10),
        node.create_subscription(JointState, "/PSM1/measured_js", joints.append, 10),
        node.create_publisher(JointState, "/PSM1/move_jp", 10),
    ]
    def spin():
        try:
            executor = rclpy.executors.SingleThreadedExecutor()
            executor.add_node(node)
            executor.spin()
        except rclpy.executors.ExternalShutdownException:
            pass
    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    rate = node.create_rate(frequency=100, clock=node.get_clock())
    def connected(end):
        if isinstance(end, rclpy.publisher.Publisher):
            return end.get_subscription_count()
        assert isinstance(end, rclpy.subscription.Subscription)
        return end.get_publisher_count()
    while not all(map(connected, ends)):
        rate.sleep()
    goal = JointState()
    goal.position = [0.2, 0.0, 0.12, 0.0, 0.0, 0.0]
    ends[2].publish(goal)
    while not state[0].is_busy:
        came.clear()
        assert came.wait(2.0)
    while state[0].is_busy:
        came.clear()
        assert came.wait(5.0)
    assert abs(joints[-1].position[0] - 0.2) < 5e-3
    told = []
    rclpy.get_default_context().on_shutdown(lambda: told.append("bye"))
    rclpy.shutdown()
    thread.join()
    assert told == ["bye"] and not rclpy.ok()
"""


def test_a_client_whose_thread_spins_waits_for_moves(tmp_path: Path):
    assert play(tmp_path, CLIENT).status == 0


@pytest.mark.parametrize(
    ("text", "variable", "edition"),
    [
        ("import rclpy", None, 2),
        ("from rclpy.node import Node", "1", 2),
        ("import rospy", "2", 1),
        ("import crtk", None, 1),
        ("import crtk", "2", 2),
        ("try:\n    import rclpy\nexcept ImportError:\n    import rospy", None, 1),
        ("import beside", None, 2),
    ],
)
def test_imports_choose_the_edition_of_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, variable: str | None, edition: int
):
    monkeypatch.delenv("ROS_VERSION", raising=False)
    if variable is not None:
        monkeypatch.setenv("ROS_VERSION", variable)
    script = tmp_path / "script.py"
    script.write_text(text, encoding="utf-8")
    (tmp_path / "beside.py").write_text("import rclpy.qos, script", encoding="utf-8")
    assert edition_of(script) == edition


def test_a_script_for_ros_2_has_no_rospy(tmp_path: Path):
    with pytest.raises(InputError, match=r"line 2: needs the ROS package 'tf2_ros'.*rclpy"):
        play(tmp_path, "import rclpy\nimport tf2_ros\n")


def test_the_example_of_the_page_says_what_the_page_says(capsys: pytest.CaptureFixture[str]):
    root = Path(__file__).parents[2]
    script = root / "examples" / "scripts" / "follow.py"
    words = ("--ros-args", "-p", "radius:=0.02")
    flow = Stepped(World("psm"), 60.0, components, rate_hz=100.0)
    assert run_script(script, words, flow, 60.0).status == 0
    said = capsys.readouterr().out.splitlines()[-1]
    assert said.startswith("two turns of 20 mm, at most 3.")
    assert "two turns of 20 mm, at most 3." in (root / "docs" / "scripts.md").read_text("utf-8")
