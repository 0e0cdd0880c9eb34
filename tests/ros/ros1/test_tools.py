"""ROS 1's own tools and a rosmaster, neither of which we wrote, with a simulator."""

from __future__ import annotations

import re
import subprocess
from contextlib import closing
from pathlib import Path
from typing import Any, cast
from xmlrpc.client import ServerProxy

import numpy as np
import pytest

from tests.ros.ros1.robot_os import SYSTEM_PYTHON, Ear, Master, Simulator, need, until
from trocar.descriptions import load_rig
from trocar.kinematics.forward import pose
from trocar.messages import message_names, message_type, ros1_decode, service_names, service_type
from trocar.ros.core import service_table, topic_table
from trocar.ros.transports.ros1.transport import SEQUENCE

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("simulator")]
RIG = load_rig("psm")


def warned(ear: Ear, words: str, most: int = 5) -> str:
    """Return the warning with these words; the first one is the last before the ear came."""
    for _ in range(most):
        said = str(ros1_decode(message_type("std_msgs/String"), ear.packet())["data"])
        if words in said:
            return said
    raise AssertionError(f"{most} warnings without {words!r}")


def test_the_master_knows_every_row_of_the_table(master: Master) -> None:
    _, _, (out, inward, services) = master.ask("getSystemState")
    rows = [topic for topic in topic_table(RIG) if not topic.later]
    for direction, found in (("pub", out), ("sub", inward)):
        ours = {name for name, nodes in found if "/trocar" in nodes}
        own = {f"/{topic.name}" for topic in rows if topic.direction == direction}
        assert ours == own | ({"/rosout"} if direction == "pub" else set())
    ours = {name for name, nodes in services if "/trocar" in nodes}
    assert ours >= {f"/{service.name}" for service in service_table(RIG)}
    types = dict(master.ask("getTopicTypes")[2])
    assert {f"/{t.name}": t.type for t in rows}.items() <= types.items()


def test_rostopic_lists_and_names_the_topics(master: Master) -> None:
    need("rostopic")
    assert "/PSM1/measured_js" in master.run("rostopic", "list").split()
    assert master.run("rostopic", "type", "/PSM1/move_cp").strip() == "geometry_msgs/PoseStamped"


def test_rostopic_hz_measures_a_stream(master: Master) -> None:
    need("rostopic")
    said = master.run_for(4.0, "rostopic", "hz", "/PSM1/measured_js")
    rates = re.findall(r"average rate: ([\d.]+)", said)
    assert rates and float(rates[-1]) > 20.0, said  # 220 Hz on a machine that has the time


def test_rostopic_echo_prints_a_state_of_generated_messages(master: Master) -> None:
    need("rostopic")
    said = master.run("rostopic", "echo", "-n1", "/PSM1/operating_state")
    assert 'state: "ENABLED"' in said and "is_homed: True" in said


def test_rosservice_calls_a_service(master: Master) -> None:
    need("rosservice")
    assert "success: True" in master.run("rosservice", "call", "/PSM1/crtk_version")
    q = [0.1, -0.2, 0.12, 0.3, 0.2, -0.1]
    said = master.run("rosservice", "call", "/PSM1/forward_kinematics", f"{{jp: {q}}}")
    numbers = [float(n) for n in re.findall(r"[xyz]: ([-\d.e]+)", said)[:3]]
    expected = pose(RIG.arm("PSM1").arm.mechanism, [*q, 0.0])[:3, 3]
    np.testing.assert_allclose(numbers, expected, atol=1e-9)


def test_a_service_says_what_is_wrong_with_a_request(master: Master) -> None:
    need("rosservice")
    said = master.run(
        "rosservice", "call", "/PSM1/forward_kinematics", "{jp: [.nan, 0, 0, 0, 0, 0]}", check=False
    )
    assert "result: False" in said and "jp[0]" in said


def test_gains_are_on_the_parameter_server_and_bad_ones_refused(master: Master) -> None:
    until(lambda: master.ask("hasParam", "/robot_description")[2], "the model is there")
    gains = master.ask("getParam", "/PSM1/yaw_controller")[2]
    assert set(gains) == {"p", "i", "d"}
    with closing(Ear(master, "/PSM1/warning")) as ear:
        master.ask("setParam", "/PSM1/yaw_controller/p", "much")
        assert warned(ear, "yaw_controller/p: got 'much'")
    master.ask("setParam", "/PSM1/yaw_controller/p", gains["p"])
    ear.close()


def test_the_model_is_another_after_a_tool_was_exchanged(master: Master) -> None:
    need("rostopic")
    until(lambda: master.ask("hasParam", "/robot_description")[2], "the model is there")

    def model() -> str:
        text = master.ask("getParam", "/robot_description")[2]
        return re.sub(r"trocar-meshes-\w+", "", text)

    def mount(tool: str) -> None:
        master.run("rostopic", "pub", "-1", "/PSM1/set_tool_type", "std_msgs/String", tool)

    driver = model()
    mount("PROGRASP_FORCEPS:400093")
    until(lambda: model() != driver, "the model has the other tool")
    mount("LARGE_NEEDLE_DRIVER:400006")
    until(lambda: model() == driver, "the model has the tool of before")


MD5 = """
import importlib, sys
for name in sys.stdin.read().split():
    package, own = name.split("/")
    for kind in ("msg", "srv"):
        try:
            found = getattr(importlib.import_module(f"{package}.{kind}"), own, None)
        except ImportError:
            continue
        if found is not None:
            print(name, found._md5sum)
"""


def test_md5_sums_are_those_of_debian_and_of_genpy(master: Master) -> None:
    need(SYSTEM_PYTHON)
    names = "\n".join((*message_names(), *service_names()))
    asked = [SYSTEM_PYTHON, "-c", MD5]
    done = subprocess.run(asked, env=master.env, input=names, text=True, capture_output=True)
    found = dict(line.split() for line in done.stdout.splitlines())
    assert len(found) > 10, done.stderr
    for name, md5 in found.items():
        kind = service_type(name) if name in service_names() else message_type(name)
        assert kind.md5 == md5, name


def test_who_does_not_read_keeps_nobody_waiting(master: Master) -> None:
    stuck = Ear(master, "/PSM1/measured_js")  # never reads again
    ear = Ear(master, "/PSM1/measured_js")
    kind = message_type("sensor_msgs/JointState")
    messages = [ros1_decode(kind, ear.packet()) for _ in range(300)]
    stamps = [message["header"]["stamp"] for message in messages]
    # the first is the newest state, which may be the one that is published at that moment
    assert stamps[1:] == sorted(set(stamps[1:])) and stamps[1] >= stamps[0] > (0, 0)
    assert list(messages[-1]["name"]) == list(RIG.arm("PSM1").arm.mechanism.joint_names[:6])
    for end in (stuck, ear):
        end.close()


HUGE = """
import rospy, time
from sensor_msgs.msg import JointState
rospy.init_node("huge")
out = rospy.Publisher("/PSM1/servo_jp", JointState, queue_size=1)
while not out.get_num_connections():
    time.sleep(0.01)
message = JointState(name=["x" * 3_000_000])
while True:
    out.publish(message)
    time.sleep(0.2)
"""


def test_a_message_that_is_too_large_is_refused(master: Master) -> None:
    need(SYSTEM_PYTHON)
    with closing(Ear(master, "/PSM1/warning")) as ear:
        with subprocess.Popen([SYSTEM_PYTHON, "-c", HUGE], env=master.env) as process:
            found = warned(ear, "servo_jp: got 30000")
            process.kill()
        assert "allowed" in found


def test_the_simulation_goes_on_without_its_master_and_joins_a_new_one(tmp_path: Path) -> None:
    need("rosmaster")
    with closing(Master(tmp_path)) as master, closing(Simulator(master.env, "--rig", "psm")) as sim:
        ear = Ear(master, "/PSM1/measured_js")
        master.close()
        sim.hears("is unreachable")
        for _ in range(50):
            ear.packet()
        ear.close()
        master.start()
        sim.hears("with the new master")
        until(lambda: master.ask("hasParam", "/PSM1/pitch_controller")[2], "the gains are there")
        Ear(master, "/PSM1/measured_cp").close()
        assert sum("is unreachable" in line for line in sim.said) == 1
        assert sim.stop() == 0, "".join(sim.said)
        _, _, (out, _, _) = master.ask("getSystemState")
        assert not [nodes for _, nodes in out if "/trocar" in nodes]
        assert not [name for name in master.ask("getParamNames")[2] if name.startswith("/PSM1")]


def test_what_a_master_lost_is_registered_again(master: Master) -> None:
    def registered() -> bool:
        return "/PSM1/measured_js" in dict(master.ask("getPublishedTopics", "")[2])

    until(registered, "the topic is there")
    with ServerProxy(master.uri) as proxy:
        node = cast(Any, proxy.lookupNode("/test", "/trocar"))[2]
        proxy.unregisterPublisher("/trocar", "/PSM1/measured_js", node)
    assert not registered()
    until(registered, "the topic is there again")


def test_headers_are_numbered_for_each_publisher(master: Master) -> None:
    for topic in ("measured_js", "measured_cp"):
        with closing(Ear(master, f"/PSM1/{topic}")) as ear:
            numbers = [SEQUENCE.unpack_from(ear.packet())[0] for _ in range(3)]
        assert np.diff(numbers).tolist() == [1, 1], topic


def test_a_late_subscriber_gets_the_last_goal_and_the_last_warning(master: Master) -> None:
    need("rostopic")
    publish = ("rostopic", "pub", "-1")
    goal, kind = "position: [0.01, 0, 0, 0, 0, 0]", "sensor_msgs/JointState"
    master.run(*publish, "/PSM1/move_jr", kind, f"{{{goal}}}")
    master.run(*publish, "/PSM1/servo_jp", kind, "{position: [0.1]}")
    with closing(Ear(master, "/PSM1/goal_reached")) as ear:
        assert ros1_decode(message_type("std_msgs/Bool"), ear.packet())["data"] is True
    with closing(Ear(master, "/PSM1/warning")) as ear:
        assert warned(ear, "got 1 numbers in position", 1)
