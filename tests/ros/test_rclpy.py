"""The choice of ROS 2 by `trocar sim --ros2`, its errors, and a run over a real rclpy."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

import pytest

from tests.ros.served import running
from trocar.cli import main
from trocar.live.access import PageAccess
from trocar.ros.transports import ros2
from trocar.ros.transports.rclpy_node import RclpyTransport, reach

QUIET = ["sim", "--rig", "psm", "--no-page", "--no-websocket"]
HOME = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]


def chosen(kind: str | None) -> str:
    return type(ros2.open_transport({"ros2": kind}, PageAccess())).__name__


@pytest.fixture
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every module of rclpy that the transport imports an empty one."""
    names = ("context", "exceptions", "executors", "parameter", "qos", "serialization")
    for name in ("rclpy", *(f"rclpy.{n}" for n in names), "rcl_interfaces", "rcl_interfaces.msg"):
        module = ModuleType(name)
        module.__path__, module.__spec__ = [], ModuleSpec(name, None)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.mark.usefixtures("importable")
def test_rclpy_is_used_where_it_can_be_imported() -> None:
    assert chosen(None) == "NoneType"
    assert chosen("auto") == chosen("rclpy") == "RclpyTransport"


def test_cyclone_dds_is_used_elsewhere(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert chosen("auto") == chosen("dds") == "Ros2Transport"
    assert not caplog.records


def test_an_rclpy_of_another_python_is_reported(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    found = ModuleType("rclpy")  # no package, so it has no rclpy.context
    found.__spec__ = ModuleSpec("rclpy", None)
    monkeypatch.setitem(sys.modules, "rclpy", found)
    assert chosen("auto") == "Ros2Transport"
    assert "there is an rclpy, but" in caplog.text


def test_rclpy_without_rclpy_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert main([*QUIET, "--ros2", "rclpy"]) == 2
    said = capsys.readouterr().err
    assert f"--ros2 rclpy: {sys.executable} cannot import rclpy" in said
    assert "source /opt/ros/DISTRO/setup.bash" in said


def test_another_way_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*QUIET, "--ros2", "cyclone"]) == 2
    assert "--ros2: invalid choice: 'cyclone'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "", "with programs on this machine"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "with programs on this machine"),
        ("ROS_LOCALHOST_ONLY", "1", "with programs on this machine"),
        ("ROS_LOCALHOST_ONLY", "0", "with the whole network, without any password"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET", "with the whole network, without any password"),
        ("CYCLONEDDS_URI", "<General/>", "without any password, where CYCLONEDDS_URI says"),
    ],
)
def test_the_start_line_says_how_far_it_speaks(name: str, value: str, words: str) -> None:
    assert reach({name: value}) == words


def until(holds: Callable[[], object]) -> None:
    end = time.monotonic() + 30.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.mark.slow
def test_a_node_of_a_real_rclpy_commands_and_reads_an_arm() -> None:
    """Run under the Python of a sourced ROS 2, e.g. in a container of ros:jazzy."""
    reason = "no rclpy: source /opt/ros/DISTRO/setup.bash and use the Python of that ROS 2"
    rclpy: Any = pytest.importorskip("rclpy", reason=reason)
    from rcl_interfaces.srv import SetParameters  # pyright: ignore[reportMissingImports]
    from sensor_msgs.msg import JointState  # pyright: ignore[reportMissingImports]
    from std_srvs.srv import Trigger  # pyright: ignore[reportMissingImports]

    with running(RclpyTransport()) as (core, _):
        context = rclpy.context.Context()
        rclpy.init(args=[], context=context)
        node = rclpy.create_node("client", context=context)
        executor = rclpy.executors.SingleThreadedExecutor(context=context)
        executor.add_node(node)
        spinning = threading.Thread(target=executor.spin, daemon=True)
        spinning.start()
        heard: list[Any] = []
        node.create_subscription(JointState, "/PSM1/measured_js", heard.append, 10)
        servo = node.create_publisher(JointState, "/PSM1/servo_jp", 1)
        until(lambda: heard and servo.get_subscription_count())
        assert list(heard[-1].name[:3]) == ["yaw", "pitch", "insertion"]
        goal = [0.01, *HOME[1:]]
        servo.publish(JointState(position=goal))
        until(lambda: abs(heard[-1].position[0] - goal[0]) < 1e-3)
        version = node.create_client(Trigger, "/PSM1/crtk_version")
        assert version.wait_for_service(30.0)
        answer = version.call_async(Trigger.Request())
        until(answer.done)
        assert answer.result().success
        setter = node.create_client(SetParameters, "/trocar/set_parameters")
        gain = rclpy.parameter.Parameter("PSM1.yaw_controller.p", value=70.0)
        request = SetParameters.Request(parameters=[gain.to_parameter_msg()])
        answer = setter.call_async(request)
        until(answer.done)
        until(
            lambda: (
                core.loop.ask(lambda world: world.arm("PSM1").joints.gains("yaw")[0]).result(5.0)
                == 70.0
            )
        )
        assert core.loop.commanders.of("PSM1") == ["ROS 2"]
        executor.shutdown()
        node.destroy_node()
        until(lambda: not core.loop.commanders.of("PSM1"))
        context.try_shutdown()
        spinning.join(10.0)
