"""A client that is installed stands on our rospy: what it finds there is as in ROS.

The stand-in does what an installed client relies on, in our own words: it waits until every end is
connected, takes what it heard for true while that is younger than its patience, and else waits.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.scripts.playing import play
from trocar.scripts import Live, run_script
from trocar.simulation import World

CRTK = """
import os, threading, rospy
from crtk_msgs.msg import OperatingState
from sensor_msgs.msg import JointState
assert os.environ["ROS_VERSION"] == "1"
class ral:
    def __init__(self, name, namespace=""):
        rospy.init_node(name, anonymous=True)
        self.namespace, self.ends = namespace, []
    def subscriber(self, topic, kind, callback):
        name = f"{self.namespace}/{topic}"
        self.ends.append(rospy.Subscriber(name, kind, callback=callback, queue_size=10))
    def publisher(self, topic, kind):
        self.ends.append(rospy.Publisher(f"{self.namespace}/{topic}", kind, queue_size=10))
        return self.ends[-1]
    def check_connections(self):
        rate, start = rospy.Rate(100), rospy.Time.now()
        while not all(end.get_num_connections() for end in self.ends):
            assert rospy.Time.now() - start < rospy.Duration(2.0)
            rate.sleep()
class utils:
    def __init__(self, instance, ral, patience=5.0):
        self.patience = rospy.Duration(patience)
        self.state, self.told = OperatingState(), threading.Event()
        self.joints, self.came = JointState(), threading.Event()
        ral.subscriber("operating_state", OperatingState, self.heard)
        ral.subscriber("setpoint_js", JointState, self.felt)
        instance.wait_for_state = self.told.wait
        instance.operating_state = lambda: self.state.state
        instance.setpoint_jp = self.setpoint_jp
    def heard(self, message):
        self.state = message
        self.told.set()
    def felt(self, message):
        self.joints = message
        self.came.set()
    def setpoint_jp(self):
        self.came.clear()
        if rospy.Time.now() - self.joints.header.stamp > self.patience:
            assert self.came.wait(self.patience.to_sec())
        return self.joints.position, self.joints.header.stamp.to_sec()
"""
#: Reads what has come, and waits for nothing, as crtk_python_client 1.4 does.
AT_ONCE = """
import time, rospy
from geometry_msgs.msg import PoseStamped
times, stamps = [], []
def heard(message):
    times.append(time.time_ns())
    stamps.append(message.header.stamp.to_sec())
rospy.init_node("at_once")
rospy.Subscriber("PSM1/setpoint_cp", PoseStamped, heard)
assert times, "no data received yet"
assert time.time_ns() - times[-1] < 20e6, "last data received more than 0.02 s ago"
"""
DVRK = """
import crtk
class arm:
    def __init__(self, ral, patience=5.0):
        crtk.utils(self, ral, patience)
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install the stand-in, and return where."""
    place = tmp_path / "site"
    for name, text in {"crtk": CRTK, "dvrk": DVRK}.items():
        (place / name).mkdir(parents=True)
        (place / name / "__init__.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(place))
    return place


def test_an_installed_client_stands_on_our_rospy(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    text = """
    import crtk, dvrk
    arm = dvrk.arm(crtk.ral("client", "PSM1"))
    print(arm.wait_for_state(5.0), arm.operating_state(), crtk.__file__)
    """
    assert play(tmp_path, text).status == 0
    assert capsys.readouterr().out.startswith(f"True ENABLED {site}")
    assert "crtk" not in sys.modules


@pytest.mark.parametrize("patience", [0.5, 5.0, 60.0])
@pytest.mark.usefixtures("site")
def test_what_was_never_told_is_too_old_for_every_patience(tmp_path: Path, patience: float):
    text = f"""
    import crtk, dvrk
    position, when = dvrk.arm(crtk.ral("client", "PSM1"), {patience}).setpoint_jp()
    assert len(position) == 6 and when > 0.0, (position, when)
    """
    assert play(tmp_path, text).status == 0


@pytest.mark.usefixtures("site")
def test_once_connected_a_client_has_heard_what_is_latched(tmp_path: Path):
    text = """
    import crtk, dvrk
    from std_msgs.msg import Float64
    ral, scale = crtk.ral("client", ""), []
    ral.subscriber("console/teleop/scale", Float64, scale.append)
    ral.publisher("console/teleop/set_scale", Float64)
    ral.check_connections()
    assert [told.data for told in scale] == [0.2], scale
    """
    assert play(tmp_path, text, "full_cart_mtm").status == 0


def test_a_script_that_reads_at_once_has_data_and_time_has_passed(tmp_path: Path):
    assert (
        play(tmp_path, AT_ONCE + "assert rospy.get_time() == 1000.011, rospy.get_time()").status
        == 0
    )


@pytest.mark.slow
def test_a_script_that_reads_at_once_has_data_in_real_time_too(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(AT_ONCE, encoding="utf-8")
    assert run_script(script, (), Live(World("psm"))).status == 0


@pytest.mark.usefixtures("site")
def test_it_is_connected_in_real_time_too(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(
        "import crtk, dvrk\n"
        "ral = crtk.ral('client', 'PSM1')\n"
        "arm = dvrk.arm(ral)\n"
        "ral.check_connections()\n"
        "assert len(arm.setpoint_jp()[0]) == 6\n",
        encoding="utf-8",
    )
    assert run_script(script, (), Live(World("psm"))).status == 0
