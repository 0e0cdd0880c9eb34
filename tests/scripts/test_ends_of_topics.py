"""Topics of a script that nobody publishes or reads, and images, which somebody does."""

from __future__ import annotations

import logging
from pathlib import Path
from textwrap import dedent

import pytest

from tests.live.fake_renderer import FakeRenderer
from tests.scripts.playing import RATE_HZ, play
from trocar.live.images import Pictures
from trocar.rendering.latest_only import InTurn
from trocar.scripts import Live, Stepped, rig_for, run_script
from trocar.simulation import World


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]


def test_commands_that_nobody_reads_are_reported_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    text = """
    import rospy
    from sensor_msgs.msg import JointState
    rospy.init_node("old")
    old = rospy.Publisher("/dvrk/PSM1/set_position_goal_joint", JointState, queue_size=1)
    mine = rospy.Publisher("/mine", JointState, queue_size=1)
    rospy.Subscriber("/mine", JointState, lambda message: None)
    for _ in range(5):
        old.publish(JointState())
        mine.publish(JointState())
        rospy.sleep(0.1)
    """
    assert play(tmp_path, text).status == 0
    assert warnings(caplog) == [
        "/dvrk/PSM1/set_position_goal_joint: nothing subscribes to this topic"
        " (did you mean /PSM1/move_jp?)"
    ]


@pytest.mark.parametrize("seconds", [0.1, 3.0])
def test_subscriptions_that_nobody_publishes_to_are_reported_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, seconds: float
):
    text = f"""
    import rospy
    from sensor_msgs.msg import Image, JointState
    rospy.init_node("deaf")
    for name in ("/PSM1/state_joint_current", "PSM1/measured_js", "late"):
        rospy.Subscriber(name, JointState, lambda message: None)
    rospy.Publisher("late", JointState, queue_size=1)
    rospy.sleep({seconds})
    """
    assert play(tmp_path, text).status == 0
    assert warnings(caplog) == [
        "/PSM1/state_joint_current: nothing publishes this topic (did you mean /PSM1/measured_js?)"
    ]


def test_positions_are_taken_by_order_with_one_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    text = """
    import rospy
    from sensor_msgs.msg import JointState
    rospy.init_node("sorted")
    names = rospy.wait_for_message("/PSM1/measured_js", JointState).name
    to = rospy.Publisher("/PSM1/servo_jp", JointState, queue_size=1)
    wanted = [0.03, 0.02, 0.12, 0.0, 0.0, 0.01]
    for _ in range(50):
        to.publish(JointState(name=names[::-1], position=wanted))
        rospy.sleep(0.01)
    there = rospy.wait_for_message("/PSM1/setpoint_js", JointState).position
    assert all(abs(a - b) < 1e-9 for a, b in zip(there, wanted)), there
    """
    assert play(tmp_path, text).status == 0
    (said,) = warnings(caplog)
    assert "names are ignored, numbers are for yaw, pitch" in said


IMAGES = """
    import rospy, numpy as np
    from cv_bridge import CvBridge
    from sensor_msgs.msg import CameraInfo, CompressedImage, Image
    rospy.init_node("looks")
    got = {}
    for name, kind in (
        ("image_raw", Image), ("image_raw/compressed", CompressedImage), ("camera_info", CameraInfo)
    ):
        hear = lambda message, name: got.setdefault(name, []).append(message)
        rospy.Subscriber(f"/endoscope/left/{name}", kind, hear, name)
    rospy.sleep(SECONDS)
    raw, info = got["image_raw"], got["camera_info"]
    assert len(raw) >= 3 and len(got["image_raw/compressed"]) >= 3, len(raw)
    assert raw[0].header.stamp == info[0].header.stamp
    pixels = CvBridge().imgmsg_to_cv2(raw[0], "bgr8")
    assert pixels.shape == (raw[0].height, raw[0].width, 3), pixels.shape
    print(len(raw), raw[-1].header.stamp.to_nsec())
"""


def script_of(folder: Path, seconds: float) -> Path:
    script = folder / "script.py"
    script.write_text(dedent(IMAGES.replace("SECONDS", str(seconds))), encoding="utf-8")
    return script


def test_images_come_in_simulated_time_the_same_each_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for _ in range(2):
        flow = Stepped(
            World("ecm"),
            60.0,
            draw=lambda loop: Pictures(loop, FakeRenderer, worker=InTurn),
            rate_hz=RATE_HZ,
            camera_rate_hz=20.0,
        )
        assert run_script(script_of(tmp_path, 1.0), (), flow, 60.0).status == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == second
    assert 19 <= int(first.split()[0]) <= 21


def test_images_come_beside_the_wall_clock(tmp_path: Path):
    flow = Live(World("ecm"), draw=lambda loop: Pictures(loop, FakeRenderer), camera_rate_hz=10.0)
    assert run_script(script_of(tmp_path, 2.0), (), flow, 60.0).status == 0


def test_images_change_no_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    move = """
    import crtk, dvrk, numpy as np
    from sensor_msgs.msg import Image
    ral = crtk.ral("moves"); arm = dvrk.ecm(ral, "ECM")
    if LOOK:
        ral.subscriber("endoscope/left/image_raw", Image, lambda message: None)
    else:
        ral.subscriber("endoscope/left/nothing", Image, lambda message: None)
    arm.move_jp(np.array([0.1, 0.05, 0.06, 0.0])).wait()
    print(arm.measured_jp()[0].tobytes().hex())
    """
    for look in ("True", "False"):
        script = tmp_path / "script.py"
        script.write_text(dedent(move).replace("LOOK", look), encoding="utf-8")
        flow = Stepped(
            World("ecm"), 60.0, draw=lambda loop: Pictures(loop, FakeRenderer, worker=InTurn)
        )
        assert run_script(script, (), flow, 60.0).status == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == second


def test_a_script_that_looks_gets_a_rig_with_a_camera():
    assert rig_for(b"x = '/PSM1/measured_js'", ()) == "psm"
    assert rig_for(b"x = '/PSM1/measured_js', 'left/image_raw'", ()) == "two_psm_ecm"
    assert rig_for(b"x = 'ECM'", ("image:=/stereo/left/image_rect_color",)) == "ecm"


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("dvrk.psm('PSM1').get_current_nonsense()", True),
        ("dvrk.psm(ral, 'PSM1').move_jp([0.0] * 6, blocking=True)", True),
        ("dvrk.psm(ral, 'PSM1').get_current_position()", True),
        ("dvrk.psm(ral, 'PSM1').measured_cp().p", True),
        ("dvrk.psm(ral, 'PSM1').measured_jp() + 1.0", True),
        ("int([])", False),
        ("ral.nothing.more", True),
        ("math.nothing", False),
    ],
)
def test_calls_of_older_versions_give_a_hint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, hint: bool
):
    head = "import crtk, dvrk, math\nral = crtk.ral('old')\n"
    assert play(tmp_path, head + text).status == 1
    assert ("put its dvrk_python and crtk on PYTHONPATH" in capsys.readouterr().err) == hint
